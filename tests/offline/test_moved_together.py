"""`experiment` on a plant of which it cannot say what to record next: why not, and what helps."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.literature import furnace, three_tanks
from twinmatch.cli import main

TOGETHER = "command1, command2 and command3 moved only together with the other inputs"


def test_inputs_that_moved_together_are_named_and_one_after_the_other_serves(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Three loops of a furnace whose set-points step at once, and then, as advised, one after the other."""
    monkeypatch.chdir(tmp_path)
    columns = furnace().write(Path("together.csv"))
    furnace(together=False).write(Path("alone.csv"))
    assert (
        main(["new-plant", "zones", "--from", "together.csv", "--map", *columns]) == 0
    )
    asked = ["--plant", "zones.py", "--minutes", "60", "--map", *columns]
    capsys.readouterr()
    assert main(["experiment", "together.csv", *asked]) == 2
    refusal = capsys.readouterr().err
    assert TOGETHER in refusal
    assert "or of the set-points, one after the other" in refusal
    assert "record steps of every input" not in refusal
    assert main(["experiment", "alone.csv", *asked]) == 0
    assert "hold command1" in capsys.readouterr().out


def answered(name: str, columns: list[str]) -> int:
    """The exit code of `experiment` on a plant that `new-plant` writes of these columns of the tanks."""
    assert main(["new-plant", name, "--from", "tanks.csv", "--map", *columns]) == 0
    asked = ["--plant", f"{name}.py", "--minutes", "10", "--map", *columns]
    return main(["experiment", "tanks.csv", *asked])


def test_with_another_number_of_inputs_than_of_outputs_a_part_of_the_plant_is_asked(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    time, *outputs, first, second = three_tanks().write(Path("tanks.csv"))
    assert answered("all_tanks", [time, *outputs, first, second]) == 2
    refusal = capsys.readouterr().err
    assert "has 3 outputs and 2 inputs" in refusal
    assert "write a plant of 2 of the outputs" in refusal
    assert answered("two_tanks", [time, *outputs[:2], first, second]) == 0
    assert "hold command1" in capsys.readouterr().out

    assert answered("one_tank", [time, "output=reading1", first, second]) == 2
    refusal = capsys.readouterr().err
    assert "write a plant of 1 of the inputs, with the others as disturb" in refusal
    one_input = [time, "output=reading1", "input=command1", "further=command2"]
    assert answered("one_loop", one_input) == 0
