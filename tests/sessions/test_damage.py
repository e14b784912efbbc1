"""Damaged sessions: no fewer samples than plain readers find, and what is missing is said."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from tests.support.broken_sessions import (
    KINDS,
    as_session,
    broken,
    plainly_found,
    samples_in,
    strictly_read,
    whole_file,
)
from twinmatch.cli import main
from twinmatch.cli.shared import open_shown
from twinmatch.errors import TwinmatchError
from twinmatch.memory import Memory
from twinmatch.sessions import read_session
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE
from twinmatch.sessions.recording import repair_session
from twinmatch.sessions.scan import Scan
from twinmatch.signals import Sample

COUNT = 60


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("kind", range(len(KINDS)))
def test_no_sample_is_lost_that_a_plain_reader_finds(
    tmp_path: Path, kind: int, compression
) -> None:
    """`python -m benchmarks.damage` does the same with more and longer files."""
    sound = whole_file(COUNT, 10, compression)
    samples_of_whole = samples_in(sound)
    rng = random.Random(f"{kind} {compression}")
    for number in range(6):
        content = broken(sound, rng, kind)
        session = as_session(tmp_path / f"s{number}", content)
        scan = Scan(session / f"s{number}_0.mcap")
        try:
            ours = {m.data for m in scan if m.topic.name == SAMPLE.name}
            samples = read_session(session).samples
        except TwinmatchError:
            assert not plainly_found(content, samples_of_whole)
            continue
        assert len(samples) == len(ours)
        assert len(ours & samples_of_whole) >= len(
            plainly_found(content, samples_of_whole)
        )
        faults = repair_session(session).faults
        assert strictly_read(content) or any(
            "damaged" in f or "truncated" in f for f in faults
        )
        assert {
            encode_sample(s) for s in read_session(session).samples
        } >= ours & samples_of_whole


def damaged(folder: Path) -> Path:
    """A session of which one chunk has a wrong checksum."""
    content = whole_file(COUNT, 10)
    place = (
        content.index(encode_sample(Sample(25, 1_000_025 * 10**9, 30.0, 25.5, 1.0)))
        + 80
    )
    return as_session(
        folder, content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    )


def test_what_is_missing_is_said_where_a_session_is_opened(tmp_path, capsys):
    session = open_shown(damaged(tmp_path / "run"))
    assert session.missing == session.notes[: len(session.missing)]
    printed = capsys.readouterr().err
    assert (
        "session run is not complete: run_0.mcap: the file is damaged: the checksum of a chunk"
        in printed
    )
    assert "20 messages were read that no checksum confirms" in printed


def test_a_memory_learns_from_a_damaged_session_only_if_told(tmp_path, capsys):
    session = damaged(tmp_path / "run")
    memory = tmp_path / "memory.sqlite"
    words = ["remember", str(session), "--memory", str(memory), "--plant", "peltier"]
    assert main(words) == 2
    refusal = capsys.readouterr().err
    assert "the checksum of a chunk is wrong" in refusal
    assert "give --although to learn from what is there" in refusal
    assert Memory(memory).lessons() == []
    assert main([*words, "--although"]) == 0
    printed = capsys.readouterr()
    assert "teaches nothing: its healthy part is too short" in printed.out
    assert "session run is not complete" in printed.err


LAW = {"kind": "pid", "proportional": 1.0, "integral": 0.02, "derivative": 0.0}
COMMANDS = {
    "replay": (),
    "forecast": ("--at", "40"),
    "backtest": ("--peers",),
    "experiment": (),
    "try-controller": ("--loop", "law.json"),
    "retune": (),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_says_what_is_missing(
    command: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    """Before anything else, so a minute is enough, for which most have nothing else to say."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law.json").write_text(json.dumps(LAW))
    main([command, str(damaged(tmp_path / "run")), *COMMANDS[command]])
    printed = capsys.readouterr()
    assert "the checksum of a chunk is wrong" in " ".join(
        (printed.out + printed.err).split()
    )
