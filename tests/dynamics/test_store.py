"""What is made of a plant's equations, and where it is kept: a folder of its own for every test."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.plants import Box, Lag, Motor
from tests.support.processes import Process, Processes
from twinmatch.dynamics import store
from twinmatch.dynamics.equations import derive
from twinmatch.dynamics.prepare import prepare
from twinmatch.plants import PLANTS

SOURCE = Path(__file__).resolve().parents[2] / "src" / "twinmatch"
Start = Callable[..., Process]

PLANT = """
from twinmatch.dynamics import Drive, Equations, Output, Parameter, Plant, State, Structure

class Tank(Plant, name="tank"):
    level = Output(unit="m", noise=0.01, span=(0.0, 10.0))
    inflow = Drive(unit="m3/s", limits=(0.0, 5.0), noise=0.1)
    height = State(unit="m", span=(0.0, 10.0))
    area = Parameter(unit="m2", default=2.0, bounds=(0.5, 8.0), positive=True)
    structures = {"open": Structure(free=("area",))}

    def equations(self, parts):
        return Equations(rates={self.height: self.inflow / self.area}, output=self.height,
                         start={self.height: self.level})
"""
RUN = """
import sys
sys.path.insert(0, "")
from twinmatch.dynamics import advance, begin
from tank import Tank

tank = Tank.model().parameters()
print(advance(tank, begin(tank, 1.0), 1.0, 1.0)[0])
"""


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a program beside the plant file, with an empty cache that nobody else has."""
    (tmp_path / "tank.py").write_text(PLANT)
    (tmp_path / "run.py").write_text(RUN)
    environment = {
        **os.environ,
        "TWINMATCH_CACHE": str(tmp_path / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    processes = Processes(tmp_path / "output", environment)
    yield lambda: processes.start(
        sys.executable, tmp_path / "run.py", folder=tmp_path, forked=True
    )
    processes.end()


def ended(process: Process) -> str:
    """All that it has said."""
    assert process.wait() == 0, process.text
    return process.text.strip()


@pytest.fixture
def load_afresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Path]:
    """Loads a plant as a program that begins does, from that cache; returns the file there."""
    monkeypatch.setenv("TWINMATCH_CACHE", str(tmp_path / "cache"))

    def load() -> Path:
        monkeypatch.setattr(store, "_LOADED", {})
        kernels = store.kernels_of(Lag, frozenset(), frozenset())
        vector = np.array([2.0, 1.0])
        still = np.zeros(1)
        none = np.zeros(0)
        reached = kernels.advance(vector, still, np.array([3.0]), none, 1.0, 40)
        assert reached[0] == pytest.approx(6.0 * (1.0 - math.exp(-1.0)), rel=1e-6)
        (stored,) = (tmp_path / "cache").glob("lag_*.code")
        return stored

    return load


def test_a_second_use_takes_what_the_first_has_compiled(
    load_afresh: Callable[[], Path],
) -> None:
    stored = load_afresh()
    before = stored.stat()
    assert load_afresh() == stored
    assert stored.stat().st_mtime_ns == before.st_mtime_ns


def test_a_damaged_file_is_compiled_again(
    load_afresh: Callable[[], Path], tmp_path: Path
) -> None:
    stored = load_afresh()
    whole = stored.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:-1], bytes(reversed(whole))):
        for file in (tmp_path / "cache").iterdir():
            file.write_bytes(damaged)
        assert load_afresh().read_bytes() == whole


def test_what_a_wheel_brings_is_taken_first_unless_it_is_damaged(
    load_afresh: Callable[[], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = load_afresh()
    shipped = tmp_path / "machine_code"
    monkeypatch.setattr(store, "SHIPPED", shipped)
    shipped.mkdir()
    brought = stored.rename(shipped / stored.name)
    with pytest.raises(ValueError, match="not enough values"):
        load_afresh()  # it keeps nothing in the cache
    brought.write_bytes(brought.read_bytes()[:-1])
    assert load_afresh().read_bytes()[:-1] == brought.read_bytes()


def test_two_programs_may_come_at_once(start: Start, tmp_path: Path) -> None:
    first = start()
    second = start()
    assert float(ended(first)) == float(ended(second)) == pytest.approx(1.5)
    names = sorted(path.name for path in (tmp_path / "cache").iterdir())
    assert re.fullmatch(
        r"equations_[0-9a-f]+\.code tank_[0-9a-f]+\.code", " ".join(names)
    )


def test_what_does_not_change_the_equations_compiles_nothing(
    start: Start, tmp_path: Path
) -> None:
    ended(start())
    (compiled,) = (tmp_path / "cache").glob("equations_*.code")
    before = compiled.stat()
    (tmp_path / "tank.py").write_text(PLANT.replace("default=2.0", "default=4.0"))
    assert float(ended(start())) == pytest.approx(1.25)
    assert list((tmp_path / "cache").glob("equations_*.code")) == [compiled]
    assert compiled.stat().st_mtime_ns == before.st_mtime_ns


def test_a_changed_plant_is_derived_again(start: Start, tmp_path: Path) -> None:
    assert float(ended(start())) == pytest.approx(1.5)
    (tmp_path / "tank.py").write_text(
        PLANT.replace("self.inflow / self.area", "2 * self.inflow / self.area")
    )
    assert float(ended(start())) == pytest.approx(2.0)


def test_equations_are_recognised_whatever_else_changes_in_the_file(
    tmp_path: Path,
) -> None:
    def equations(**changes: str) -> str:
        text = PLANT
        for before, after in changes.values():
            assert before in text
            text = text.replace(before, after)
        file = tmp_path / f"tank_{len(list(tmp_path.iterdir()))}.py"
        file.write_text(text)
        scope: dict[str, Any] = {"__name__": file.stem}
        exec(compile(text, str(file), "exec"), scope)
        return store.digest_of(derive(scope["Tank"](), frozenset(), frozenset()))

    digest = equations()
    assert (
        equations(comment=("    def equations", "    # m3\n    def equations"))
        == digest
    )
    assert (
        equations(
            default=("default=2.0, bounds=(0.5, 8.0)", "default=3.0, bounds=(0.1, 9.0)")
        )
        == digest
    )
    assert (
        equations(order=("self.inflow / self.area", "1 / self.area * self.inflow"))
        == digest
    )
    assert (
        equations(rate=("self.inflow / self.area", "2 * self.inflow / self.area"))
        != digest
    )
    assert (
        equations(start=("self.height: self.level", "self.height: self.level / 2"))
        != digest
    )
    assert equations(output=("output=self.height", "output=self.height + 1")) != digest
    assert (
        Motor.model("with friction").equations
        != Motor.model("without friction").equations
    )


def test_kernels_are_compiled_once_for_all_plants() -> None:
    """With a loop and without one, with kinks and disturbances or none: a second plant compiles nothing."""
    source = "".join(path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py"))
    # which hands others the plant
    asked = set(re.findall(r"\bkernels\.([a-z_]+)\(", source)) - {"call"}
    assert len(asked) > 8
    compiled = []
    for plant in (Lag, Motor, Box):
        models = list(prepare(plant))
        assert [model.structure_name for model in models] == list(plant.structures)
        compiled.append(
            {name: getattr(models[0].kernels, name).func.signatures for name in asked}
        )
    assert all(len(signatures) >= 1 for signatures in compiled[0].values())
    assert compiled[0] == compiled[1] == compiled[2]


def test_every_plant_that_comes_along_is_prepared() -> None:
    for plant in PLANTS.values():
        without_external = [
            name
            for name, structure in plant.structures.items()
            if structure.external is None
        ]
        assert [model.structure_name for model in prepare(plant)] == without_external


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    environment = {**os.environ, "TWINMATCH_CACHE": str(blocked / "cache")}
    words = (sys.executable, "-m", "twinmatch.cli", "prepare")
    process = Process(
        *words, output=tmp_path / "said.txt", environment=environment, forked=True
    )
    assert process.wait() == 2
    progress, error = process.lines
    assert progress.startswith("twinmatch: preparing, compiling the equations of ")
    assert error.startswith(
        f"twinmatch: {blocked / 'cache'}: cannot keep the compiled equations there"
    )
    assert "TWINMATCH_CACHE" in error
