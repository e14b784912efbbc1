"""A run whose recorder was killed lies in several folders, and is one session for every reader."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinmatch.offline.archive import find_sessions
from twinmatch.offline.archive.files import content_of
from twinmatch.sessions import SessionError, SessionWriter, read_session
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE
from twinmatch.sessions.metadata import CONTINUES
from twinmatch.signals import Sample


def record(folder: Path, *indices: int, continues: str = "run") -> Path:
    """A piece with these samples."""
    with SessionWriter(folder) as writer:
        if continues:
            writer.add_record(CONTINUES, {"session": continues})
        writer.add_topic(SAMPLE)
        for k in indices:
            sample = Sample(k, (k + 1) * 10**9, 30.0, 25.0, float(k))
            writer.write(SAMPLE.name, encode_sample(sample), sample.stamp)
    return folder


def indices(path: Path) -> list[int]:
    return [sample.index for sample in read_session(path).samples]


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A run with four recorders: one had no time for a sample, the last two fetched the past."""
    first = record(tmp_path / "run", 0, 1, 2, continues="")
    record(tmp_path / "run_2")
    record(tmp_path / "run_3", 0, 1, 2, 3, 4)
    record(tmp_path / "run_4", 0, 1, 2, 3, 4, 5, 6)
    return first


def test_the_last_piece_that_begins_at_the_beginning_is_the_run(killed: Path) -> None:
    session = read_session(killed)
    assert [sample.index for sample in session.samples] == list(range(7))
    assert (session.name, session.path) == ("run", killed)
    assert session.counts == {SAMPLE.name: 7}
    assert len(list(session.messages())) == 7
    assert any(
        note.startswith("run_2 is left out: session run_2: has no ")
        for note in session.notes
    )


def test_a_piece_without_samples_stands_for_its_run(killed: Path) -> None:
    assert indices(killed.with_name("run_2")) == list(range(7))
    assert indices(killed.with_name("run_3")) == list(range(5))


def test_samples_after_the_keeper_was_gone_are_appended(tmp_path: Path) -> None:
    first = record(tmp_path / "run", 0, 1, 2, continues="")
    record(tmp_path / "run_2", 2, 5, 6)
    session = read_session(first)
    assert [sample.index for sample in session.samples] == [0, 1, 2, 5, 6]
    assert session.counts == {SAMPLE.name: 5}
    assert session.end == 7 * 10**9


def test_a_piece_that_is_an_empty_file_is_left_out(tmp_path: Path) -> None:
    first = record(tmp_path / "run", 0, 1, continues="")
    (tmp_path / "run_2").mkdir()
    (tmp_path / "run_2" / "run_2_0.mcap").touch()
    assert indices(first) == [0, 1]
    assert indices(tmp_path / "run_2") == [0, 1]


def test_sessions_that_only_have_such_names_stay_apart(tmp_path: Path) -> None:
    first = record(tmp_path / "run", 0, 1, continues="")
    record(tmp_path / "run_2", 7, 8, 9, continues="")
    (tmp_path / "run_3").mkdir()
    assert indices(first) == [0, 1]
    assert indices(tmp_path / "run_2") == [7, 8, 9]
    assert find_sessions([tmp_path]) == [first, tmp_path / "run_2"]


def test_a_run_without_any_sample_is_refused(tmp_path: Path) -> None:
    first = record(tmp_path / "run", continues="")
    record(tmp_path / "run_2")
    with pytest.raises(SessionError, match="session run: has no "):
        read_session(first)


def test_an_archive_lists_a_run_once_and_sees_its_pieces_change(killed: Path) -> None:
    assert find_sessions([killed.parent]) == [killed]
    assert find_sessions([killed.with_name("run_3")]) == [killed.with_name("run_3")]
    before = content_of(killed)
    record(killed.with_name("run_5"), 0, 1)
    assert content_of(killed) != before
