"""The folder in which twinmatch keeps what takes long to make, and answers kept there.

The folder is `$TWINMATCH_CACHE`, or `twinmatch` in the user's cache folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from functools import cached_property
from pathlib import Path
from typing import Any, Final

_MOST: Final = 4000
"""Largest number of answers in a file: tables with remarks in their cells ask for ever new ones."""


def cache_folder() -> Path:
    """Where machine code and answers are kept."""
    chosen = os.environ.get("TWINMATCH_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "twinmatch"


class KeptAnswers:
    """What a slow library has answered to questions that are texts, in a file for all processes.

    A line of the file is the question and its answer, as JSON. It is only ever appended to, a line at a time,
    so processes need not wait for each other. What cannot be read counts as not asked yet, and a folder that
    cannot be written to keeps nothing.
    """

    def __init__(self, name: str, made_by: str) -> None:
        """Begin with what is kept.

        Args:
            name: that of the file, without what follows from `made_by`.
            made_by: all that answers depend on besides the question, such as versions; another text has
                another file.
        """
        digest = hashlib.sha256(made_by.encode()).hexdigest()[:16]
        self._path = cache_folder() / f"{name}-{digest}.jsonl"

    def get(self, question: tuple[str, ...]) -> Any:
        """The answer, made of what JSON can hold; None if there is none."""
        return self._answers.get(question)

    def keep(self, question: tuple[str, ...], answer: Any) -> None:
        """Keep an answer for this process and those to come."""
        is_full = len(self._answers) >= _MOST
        self._answers[question] = answer
        if is_full:
            return
        line = json.dumps([list(question), answer]) + "\n"
        with contextlib.suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line)

    @cached_property
    def _answers(self) -> dict[tuple[str, ...], Any]:
        """All that are kept, by question."""
        try:
            lines = self._path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            return {}
        answers = {}
        for line in lines:
            # A line that was cut off, as by a full disk, is followed by others.
            with contextlib.suppress(ValueError, TypeError):
                question, answer = json.loads(line)
                answers[tuple(question)] = answer
        return answers
