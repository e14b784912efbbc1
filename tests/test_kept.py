"""Answers that are kept on disk."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch import kept
from twinmatch.kept import KeptAnswers

QUESTIONS = st.lists(st.text(), min_size=1, max_size=2).map(tuple)
VERSIONS = itertools.count()
VALUES = st.floats(allow_nan=False) | st.text() | st.booleans()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TWINMATCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@given(asked=st.dictionaries(QUESTIONS, VALUES, max_size=5))
def test_what_was_kept_is_read_bit_for_bit(
    asked: dict[tuple[str, ...], object],
) -> None:
    made_by = str(next(VERSIONS))
    answers = KeptAnswers("test", made_by)
    for question, answer in asked.items():
        assert answers.get(question) is None
        answers.keep(question, answer)
    read = KeptAnswers("test", made_by)
    assert {question: read.get(question) for question in asked} == asked


def test_answers_of_another_version_do_not_count() -> None:
    KeptAnswers("test", "version 1").keep(("question",), 1.0)
    assert KeptAnswers("test", "version 1").get(("question",)) == 1.0
    assert KeptAnswers("test", "version 2").get(("question",)) is None


def test_two_processes_that_write_lose_nothing() -> None:
    first = KeptAnswers("test", "")
    second = KeptAnswers("test", "")
    assert first.get(("a",)) is second.get(("a",)) is None
    first.keep(("a",), 1.0)
    second.keep(("b",), 2.0)
    first.keep(("c",), 3.0)
    read = KeptAnswers("test", "")
    assert [read.get((name,)) for name in "abc"] == [1.0, 2.0, 3.0]


def test_a_file_does_not_grow_for_ever(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    monkeypatch.setattr(kept, "_MOST", 3)
    answers = KeptAnswers("test", "")
    for number in range(5):
        answers.keep((str(number),), number)
        assert answers.get((str(number),)) == number
    [file] = folder.iterdir()
    assert len(file.read_text().splitlines()) == 3
