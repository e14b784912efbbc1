"""`twinmatch replay` on one session: judges it and shows the verdicts while they come."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from twinmatch.errors import TwinmatchError
from twinmatch.offline.interrupt import held_interrupts
from twinmatch.offline.judgement import Judgement, judge
from twinmatch.offline.progress import Progress
from twinmatch.offline.terms import terms_from_files
from twinmatch.sessions import Session, open_any
from twinmatch.showing.lines import Lines, redraws
from twinmatch.showing.summary import closing_lines, document
from twinmatch.twin import Outcome

if TYPE_CHECKING:
    from twinmatch.showing.terminal import Screen

__all__ = ["replay"]


def replay(path: Path, options: argparse.Namespace) -> Judgement:
    """Judge a session and show it: a view that is redrawn on a terminal, plain lines elsewhere.

    Raises:
        TwinmatchError: the session or a file that the options name cannot be used.
    """
    with held_interrupts():
        return _replay(path, options)


def _replay(path: Path, options: argparse.Namespace) -> Judgement:
    judgement = _judge(path, options)
    if options.json is not None:
        entry = document(judgement.name, judgement.verdicts, judgement.summary, judgement.matches)
        options.json.write_text(json.dumps(entry, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    if options.figure is not None:
        from twinmatch.showing.figures.session import draw_verdict  # noqa: PLC0415 — matplotlib is slow to import

        draw_verdict(judgement.samples, judgement.verdicts, judgement.settings, options.figure)
    return judgement


def _judge(path: Path, options: argparse.Namespace) -> Judgement:
    """Judge as `judge_session` does, and show every match and verdict when it comes."""
    with Progress("reading") as progress:
        session = open_any(path, plant=options.plant, progress=progress.advance)
    terms = terms_from_files(session, options.config, options.candidates)
    with _Display(session) as shown:
        judgement = judge(session, terms, on_outcome=shown.advance)
    verdicts = judgement.verdicts
    for line in closing_lines(judgement.summary, verdicts[-1] if verdicts else None):
        shown.say(line)
    return judgement


class _Display:
    """A screen on a terminal; elsewhere lines, with a progress bar on standard error."""

    def __init__(self, session: Session) -> None:
        self._total = len(session.samples)
        self._screen = redraws(sys.stdout)
        self._view: Screen | Lines = _screen(session) if self._screen else Lines(session.period)
        self._bar = Progress()

    def __enter__(self) -> _Display:
        if not self._screen:
            self._bar.__enter__()
        self._view.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._view.close(wipe=kind is not None and issubclass(kind, TwinmatchError))
        self._bar.__exit__()

    def say(self, line: str) -> None:
        self._view.say(line)

    def advance(self, done: int, outcome: Outcome) -> None:
        if outcome.match is not None:
            self._view.take_match(outcome.match)
        for verdict in outcome.verdicts:
            self._view.take_verdict(verdict)
        self._view.advance(done)
        if done % 50 == 0:
            self._bar.advance(done, self._total)


def _screen(session: Session) -> Screen:
    from rich.console import Console  # noqa: PLC0415 — only a terminal needs it

    from twinmatch.showing.terminal import Screen  # noqa: PLC0415

    return Screen(Console(highlight=False), session.name, session.period, len(session.samples))
