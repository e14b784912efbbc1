"""The benchmark of the long commands runs them, and says how their cost grows; figures are for a reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.places import PROJECT


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """`benchmarks.commands`, which is not an installed package."""
    monkeypatch.syspath_prepend(str(PROJECT))
    import benchmarks.commands

    return benchmarks.commands


def test_costs_are_given_in_references_and_by_how_much_they_grow(
    commands: ModuleType,
) -> None:
    times = {
        ("replay", 1800): [2.0, 3.0, 10.0],
        ("replay", 3600): [6.0],
        ("new-plant", 1800): [1.5],
    }
    reference, *rows = commands.costs_in_references(times, [1.0, 2.0, 9.0])
    assert reference.seconds == 2.0
    assert [row.seconds for row in rows] == [3.0, 6.0, 1.5]
    assert [row.note for row in rows] == [
        "1.50 references",
        "3.00 references; × 2.00 for × 2 samples",
        "0.75 references",
    ]


def test_a_command_answers_or_its_error_is_shown(
    commands: ModuleType, tmp_path: Path
) -> None:
    recording = commands.recording(tmp_path / "made", 300)
    # each time another name, as it overwrites nothing
    assert commands.cost("new-plant", recording) > 0.0
    assert commands.cost("new-plant", recording) > 0.0
    absent = replace(recording, folder=tmp_path / "absent")
    with pytest.raises(RuntimeError, match=r"new-plant: exit code 2: .*kit\.csv"):
        commands.cost("new-plant", absent)
