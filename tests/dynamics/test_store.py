"""What is made of a plant's equations, and where it is kept: a folder of its own for every test."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.plants import Box, Lag, Motor
from twinmatch.dynamics.prepare import prepare

SOURCE = Path(__file__).resolve().parents[2] / "src" / "twinmatch"
Start = Callable[..., subprocess.Popen[str]]

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
from twinmatch.dynamics import advance, begin
from tank import Tank

tank = Tank.model().parameters()
print(advance(tank, begin(tank, 1.0), 1.0, 1.0)[0])
"""


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Start a program beside the plant file, with an empty cache that nobody else has."""
    (tmp_path / "tank.py").write_text(PLANT)
    environment = {**os.environ, "TWINMATCH_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}

    def begin(program: str = RUN) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", program],
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    return begin


def ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    out, said = process.communicate(timeout=240)
    assert process.returncode == 0, said
    return out.strip(), said


def test_a_second_use_takes_what_the_first_has_compiled(start: Start, tmp_path: Path) -> None:
    out, _ = ended(start())
    assert float(out) == pytest.approx(1.5)
    (kept,) = (tmp_path / "cache").iterdir()
    before = kept.stat()
    assert ended(start()) == (out, "")
    assert [kept] == list((tmp_path / "cache").iterdir())
    assert kept.stat().st_mtime_ns == before.st_mtime_ns


def test_a_damaged_file_is_compiled_again(start: Start, tmp_path: Path) -> None:
    out, _ = ended(start())
    (kept,) = (tmp_path / "cache").iterdir()
    whole = kept.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:-1], bytes(reversed(whole))):
        kept.write_bytes(damaged)
        assert ended(start()) == (out, "")
    assert kept.read_bytes() == whole


def test_two_programs_may_come_at_once(start: Start, tmp_path: Path) -> None:
    first, second = start(), start()
    assert float(ended(first)[0]) == float(ended(second)[0]) == pytest.approx(1.5)
    assert [path.suffix for path in (tmp_path / "cache").iterdir() if path.is_file()] == [".code"]


def test_a_changed_plant_is_derived_again(start: Start, tmp_path: Path) -> None:
    assert float(ended(start())[0]) == pytest.approx(1.5)
    (tmp_path / "tank.py").write_text(PLANT.replace("self.inflow / self.area", "2 * self.inflow / self.area"))
    out, said = ended(start())
    assert float(out) == pytest.approx(2.0)
    assert said == ""


def test_kernels_are_compiled_once_for_all_plants() -> None:
    """With a loop and without one, with kinks and disturbances or none: a second plant compiles nothing."""
    source = "".join(path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py"))
    asked = set(re.findall(r"kernels\.([a-z_]+)\(", source)) - {"call"}  # which hands others the plant
    assert len(asked) > 8
    compiled = []
    for plant in (Lag, Motor, Box):
        models = list(prepare(plant))
        assert [model.structure_name for model in models] == list(plant.structures)
        compiled.append({name: getattr(models[0].kernels, name).func.signatures for name in asked})
    assert all(len(signatures) >= 1 for signatures in compiled[0].values())
    assert compiled[0] == compiled[1] == compiled[2]


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    done = subprocess.run(
        [sys.executable, "-m", "twinmatch.cli", "prepare"],
        env={**os.environ, "TWINMATCH_CACHE": str(blocked / "cache")},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"twinmatch: {blocked / 'cache'}: cannot keep the compiled equations there")
    assert "TWINMATCH_CACHE" in lines[0]
