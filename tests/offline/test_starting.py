"""`--memory` and `--rig`: sessions that start from earlier ones, and what happens to a memory that cannot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.memory.test_start import taught
from tests.support.places import PROJECT, SHIPPED
from twinmatch.cli import main
from twinmatch.memory import Memory
from twinmatch.sessions import read_session, write_session

SAMPLES = 100
"""The first verdict comes after the 60th."""


def first_verdict(tmp_path: Path, *options: str) -> dict:
    """That of the sample session's first minutes."""
    session = tmp_path / SHIPPED.name
    out = tmp_path / "verdicts.json"
    if not session.exists():
        write_session(session, read_session(SHIPPED).samples[:SAMPLES])
    assert main(["replay", str(session), "--json", str(out), *options]) == 0
    return json.loads(out.read_text("utf-8"))["verdicts"][0]


@pytest.fixture
def memory(tmp_path: Path) -> Path:
    path = tmp_path / "memory.sqlite"
    Memory(path).add([taught(k, conductance=1.0 + 0.02 * k) for k in range(1, 4)])
    return path


def test_a_replay_starts_from_the_memory_and_says_so(
    tmp_path: Path, memory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    verdict = first_verdict(tmp_path, "--memory", str(memory))
    assert verdict["leader"] in {
        "remembered",
        "session run_1",
        "session run_2",
        "session run_3",
    }
    assert "3 sessions are remembered" in capsys.readouterr().err
    assert first_verdict(tmp_path)["leader"] is None


def test_it_joins_the_users_candidates_and_leaves_out_the_session_itself(
    tmp_path: Path, memory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    users_file = PROJECT / "config" / "paper_candidates.yaml"
    verdict = first_verdict(
        tmp_path, "--memory", str(memory), "--candidates", str(users_file)
    )
    assert verdict["leader"] in {
        "remembered",
        "session run_1",
        "session run_2",
        "session run_3",
    }
    alone = tmp_path / "alone.sqlite"
    Memory(alone).add([replace(taught(1), name=SHIPPED.name)])
    assert first_verdict(tmp_path, "--memory", str(alone))["leader"] is None
    assert "nothing is remembered yet" in capsys.readouterr().err


@pytest.mark.parametrize(
    "content", [b"no memory at all", b"SQLite format 3\x00" + b"\x07" * 4000]
)
def test_a_memory_that_cannot_be_read_is_one_line_and_the_run_continues(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    path = tmp_path / "memory.sqlite"
    path.write_bytes(content)
    assert first_verdict(tmp_path, "--memory", str(path))["leader"] is None
    (line,) = [
        line for line in capsys.readouterr().err.splitlines() if "memory" in line
    ]
    assert line.endswith("this run starts without a memory")


def test_a_rig_has_a_memory_of_its_own_in_the_users_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert first_verdict(tmp_path, "--rig", "left")["leader"] is None
    assert "rigs of this name: none" in capsys.readouterr().err
    (tmp_path / "twinmatch").mkdir(exist_ok=True)
    Memory(tmp_path / "twinmatch" / "peltier@left.sqlite").add(
        [taught(k, rig="left") for k in (1, 2)]
    )
    assert first_verdict(tmp_path, "--rig", "left")["leader"] in {
        "remembered",
        "session run_1",
        "session run_2",
    }


def test_what_a_session_started_from_is_recorded_as_a_file_of_candidates(
    memory: Path,
) -> None:
    from twinmatch.offline.starting import remembered_start
    from twinmatch.parameters.candidates import candidates_text, parse_candidates

    start = remembered_start(memory, "", "")
    read_back = parse_candidates(candidates_text(start.candidates), "file")
    assert [(c.name, c.parameters) for c in read_back] == [
        (c.name, c.parameters) for c in start.candidates
    ]
    for candidate, original in zip(read_back, start.candidates, strict=True):
        np.testing.assert_allclose(
            candidate.covariance, original.covariance, rtol=1e-15
        )
