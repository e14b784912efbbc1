"""What a plant file lacks is named, and the lines that are shown are what it lacks."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from tests.support.plants import Lag
from tests.support.rooms import PERIOD, SETTINGS, Room, judged_room, recorded_room
from twinmatch.adding.data import compare_structures
from twinmatch.dynamics import Equations, Parameters
from twinmatch.fitting import fit_structure
from twinmatch.fitting.lacks import lack_of
from twinmatch.plants import find_plant


@pytest.mark.parametrize(("seed", "stores"), [(2, 2), (3, 3)])
def test_of_a_room_of_several_stores_the_lacking_one_is_named(
    seed: int, stores: int
) -> None:
    lack = judged_room(seed, stores).split("; ")[-1]
    assert lack.startswith("a second store between heating and inner")
    assert (", and a third one beside it" in lack) is (stores == 3)
    assert int(lack.split("would explain ")[1].split("%")[0]) >= 90


def test_a_room_of_one_store_lacks_none() -> None:
    assert "store" not in judged_room(1, 1)


def test_the_lines_that_are_shown_are_the_second_store(tmp_path: Path) -> None:
    """Heavy walls beside the room; put into the file as they stand, the lines leave the noise."""
    window = recorded_room(1, 2)
    compared = compare_structures([window], Room, SETTINGS)
    (finding,) = compared.findings
    assert finding.what.startswith(
        "the structure 'one store' leaves residuals: a second store beside inner of"
    )
    titles = [
        note.startswith("lines that add a second store beside inner")
        for note in compared.notes
    ]
    title = titles.index(True)
    lines = [note[2:] for note in compared.notes[title + 1 :]]
    split = next(k for k, line in enumerate(lines) if line.startswith("in `equations`"))
    declared = [re.sub(r"= \{…, (.*)\}$", r"= {\1}", line) for line in lines[:split]]
    source = textwrap.dedent(inspect.getsource(Room))
    source = re.sub(
        r"    structures = .*",
        textwrap.indent("\n".join(declared), "    ").replace("\\", ""),
        source,
    )
    source = source.replace("return Equations(", "held = Equations(").replace(
        '"room"', '"walled"'
    )
    body = textwrap.indent("\n".join(lines[split + 1 :]), "    ")
    path = tmp_path / "walled.py"
    path.write_text(
        f"from twinmatch.dynamics import *\n\n\n{source.rstrip()}\n{body}\n"
    )
    plant = find_plant(str(path))
    fitted = fit_structure([window], plant.model(), law=None)
    residuals = (fitted.measured[0] - fitted.simulated[0]) / plant.output.noise
    assert window.period == PERIOD
    # White noise of the declared size: within three standard errors of 500 samples.
    assert float((residuals**2).mean()) == pytest.approx(1.0, abs=0.2)


def test_the_lines_import_what_they_use() -> None:
    """Of every effect: the fit is a stand-in that prefers it, since only the lines are looked at."""
    base = Lag.model().parameters()
    lines_of: dict[str, tuple[str, ...]] = {}

    def prefer(free: tuple[str, ...], start: Parameters) -> tuple[Parameters, float]:
        return start, 1.0 if start.model.structure.free == free else 100.0

    seen: list[tuple[str, ...]] = []

    def remember(start: Parameters) -> None:
        seen.append(start.model.structure.free)

    assert lack_of(base, 1.0, 100.0, 100.0, remember) is None
    for free in set(seen):
        lack = lack_of(base, 1.0, 100.0, 100.0, partial(prefer, free))
        assert lack is not None
        lines_of[lack.what] = lack.lines
    names = ("DeadTime", "Parameter", "State", "dry_friction", "replace")
    for what, lines in lines_of.items():
        text = "\n".join(line for line in lines if not line.startswith("from "))
        imported = " ".join(
            line.partition(" import ")[2] for line in lines if line.startswith("from ")
        )
        used = {name for name in names if re.search(rf"\b{name}\(", text)}
        assert used == set(re.findall(r"\w+", imported)), what
    assert any("replace" in "".join(lines) for lines in lines_of.values())


def test_only_effects_that_could_win_are_fitted() -> None:
    """One that leaves only noise ends the search before those that add more values."""
    base = Lag.model().parameters()
    n_without = base.model.structure.n_parameters()

    def fitted(independent: float, left: float, left_by_first: float) -> list[int]:
        """How many values each fitted effect adds, if the first of them leaves so much and the others all."""
        added: list[int] = []

        def fit(start: Parameters) -> tuple[Parameters, float]:
            added.append(start.model.structure.n_parameters() - n_without)
            return start, left_by_first if len(added) == 1 else left

        lack_of(base, 1.0, left, independent, fit)
        return added

    of_all = fitted(100.0, 100.0, 100.0)
    assert of_all == sorted(of_all)
    assert set(of_all) > {1, 2}
    assert fitted(100.0, 100.0, 1.0) == [1]
    assert set(fitted(6.0, 20.0, 20.0)) == {1, 2, 3}
    assert fitted(4.0, 3.5, 1.0) == []


def test_two_effects_together_are_fitted_where_one_of_them_could_be() -> None:
    """A store between drive and state, and another one beside it: in this file, the effect with most values."""
    base = Lag.model().parameters()

    def most_values_tried(fails: Callable[[set[str]], bool]) -> int:
        """How many values the richest effect adds that is tried, if effects with such parameters cannot be
        fitted."""
        tried: list[int] = []

        def fit(start: Parameters) -> tuple[Parameters, float] | None:
            added = set(start.model.structure.free) - set(base.model.structure.free)
            tried.append(len(added))
            return None if fails(added) else (start, 100.0)

        lack_of(base, 1.0, 100.0, 100.0, fit)
        return max(tried)

    assert most_values_tried(lambda _: False) == 4
    assert most_values_tried(lambda added: "fed_lag" in added) == 4
    assert most_values_tried(lambda added: bool({"fed_lag", "beside_lag"} & added)) == 2


class NamedOutput(Lag, name="named_output"):
    """The same plant, whose file names its only output, as one of several loops does."""

    def equations(self, parts: frozenset[str]) -> Equations:
        """Those of a lag."""
        plain = super().equations(parts)
        return replace(plain, output={self.y: plain.output})


def test_an_output_may_be_named_or_not() -> None:
    """Each effect is put into both files, and the equations are derived."""
    states: dict[str, list[list[str]]] = {}
    for plant in (Lag, NamedOutput):
        of_plant: list[list[str]] = states.setdefault(plant.name, [])

        def derive(start: Parameters, into: list[list[str]] = of_plant) -> None:
            into.append([*start.model.states])

        lack_of(plant.model().parameters(), 1.0, 100.0, 100.0, derive)
    assert states["named_output"] == states["lag"] != []
