"""`twinmatch replay` on one session: judges it and shows the verdicts while they come."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from twinmatch.cli_interrupt import held_interrupts
from twinmatch.cli_progress import Progress
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.twin_parameters import at_period, read_settings
from twinmatch.replay import Judgement, judge_samples
from twinmatch.sessions import Session, open_any
from twinmatch.sessions.candidates import read_candidates
from twinmatch.twin import MatchReport, Outcome
from twinmatch.views import document
from twinmatch.views.line import Lines, closing_lines, redraws

if TYPE_CHECKING:
    from twinmatch.discrimination import Verdict
    from twinmatch.views.terminal import Screen

__all__ = ["replay"]


def replay(path: Path, options: argparse.Namespace) -> Judgement:
    """Judge a session and show it: a view that is redrawn on a terminal, plain lines elsewhere.

    Raises:
        TwinmatchError: the session or a file that the options name cannot be used.
    """
    judgement = _judge(path, options)
    if options.json is not None:
        entry = document(judgement.name, judgement.verdicts, judgement.summary, judgement.matches)
        options.json.write_text(json.dumps(entry, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    if options.figure is not None:
        from twinmatch.views.figures import draw_verdict  # noqa: PLC0415 — matplotlib is slow to import

        draw_verdict(judgement.samples, judgement.verdicts, judgement.settings, options.figure)
    return judgement


def _judge(path: Path, options: argparse.Namespace) -> Judgement:
    """As `judge_session` does, and tell of every match and verdict when it comes."""
    given = read_candidates(options.candidates) if options.candidates else []
    settings = read_settings(options.config)
    session = open_any(path)
    settings = at_period(settings, session.period, options.config)
    shown = _Told(session)
    with held_interrupts() as check_interrupt, shown:

        def told(done: int, outcome: Outcome) -> None:
            shown.advance(done, outcome.match, outcome.verdicts)
            check_interrupt()

        judgement = judge_samples(
            session.name, session.samples, settings, given=given, notes=session.notes, told=told
        )
    verdicts = judgement.verdicts
    for line in closing_lines(judgement.summary, verdicts[-1] if verdicts else None):
        shown.say(line)
    return judgement


class _Told:
    """Where the run is shown: a screen, or lines with a bar on standard error."""

    def __init__(self, session: Session) -> None:
        self._total = len(session.samples)
        self._screen = redraws(sys.stdout)
        self._view: Screen | Lines = _screen(session) if self._screen else Lines(session.period)
        self._bar = Progress()

    def __enter__(self) -> _Told:
        if not self._screen:
            self._bar.__enter__()
        self._view.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._view.close(wipe=kind is not None and issubclass(kind, TwinmatchError))
        self._bar.__exit__()

    def say(self, line: str) -> None:
        self._view.say(line)

    def advance(self, done: int, match: MatchReport | None, verdicts: tuple[Verdict, ...]) -> None:
        if match is not None:
            self._view.take_match(match)
        for verdict in verdicts:
            self._view.take_verdict(verdict)
        self._view.advance(done)
        if done % 50 == 0:
            self._bar.advance(done, self._total)


def _screen(session: Session) -> Screen:
    from rich.console import Console  # noqa: PLC0415 — only a terminal needs it

    from twinmatch.views.terminal import Screen  # noqa: PLC0415

    return Screen(Console(highlight=False), session.name, session.period, len(session.samples))
