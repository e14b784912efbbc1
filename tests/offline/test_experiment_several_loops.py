"""The next experiment of a plant with two loops: what is planned, and what its twins are fitted to."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip(
    "tclab", reason="the simulated kit is not installed; it is in the extra 'tclab'"
)

from benchmarks.two_heaters import BEGINS, MISHAPS, SIZE, run
from twinmatch.cli import main
from twinmatch.offline.controllers import experiment_terms, ground_of
from twinmatch.sessions import read_session, write_session

OFFSET = MISHAPS["T1 +5 °C"]
LEFT_OUT = f"to {SIZE - 1} are left out: sensor-drift of temperature T1"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 minutes under the kit's own loops, the last 15 of them with a sensor that reads 5 °C too much."""
    path = tmp_path_factory.mktemp("two") / "offset"
    write_session(path, list(run(1, OFFSET, "pid")))
    return path


def test_known_loops_are_planned_with_and_faulty_samples_are_none(
    session: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Set-points, by the names in the plant file; and the fits know nothing of the wrong readings."""
    path = tmp_path / "course.json"
    assert (
        main(
            [
                "experiment",
                str(session),
                "--plant",
                "tclab-both",
                "--minutes",
                "5",
                "--json",
                str(path),
            ]
        )
        == 0
    )
    printed = capsys.readouterr().out
    assert LEFT_OUT in printed
    assert "hold temperature T1 " in printed
    assert "°C, temperature T2 " in printed
    document = json.loads(path.read_text())
    assert document["planned"] == "set-points"
    assert any(LEFT_OUT in note for note in document["notes"])
    last_samples = [
        int(name.rsplit(" ", maxsplit=1)[1]) for name in document["contenders"]
    ]
    assert last_samples
    assert max(last_samples) <= BEGINS


def test_loops_that_did_not_run_are_not_planned_with(session: Path) -> None:
    """A law whose commands are not the recorded ones is not the one that ran."""
    recorded = read_session(session)
    commanded = [
        replace(sample, inputs=(30.0, 30.0)) for sample in recorded.samples[:600]
    ]
    as_recorded = ground_of(
        replace(recorded, plant="tclab-both", samples=recorded.samples[:600])
    )
    others = ground_of(replace(recorded, plant="tclab-both", samples=commanded))
    assert as_recorded.loops is not None
    assert others.loops is None
    assert experiment_terms(as_recorded).holding.law is as_recorded.loops
    assert experiment_terms(others).holding.law is None
