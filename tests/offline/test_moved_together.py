"""`experiment` on a plant whose loops moved all inputs together: why it cannot answer, and what helps."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.literature import furnace
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
