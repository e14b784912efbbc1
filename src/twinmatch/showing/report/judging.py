"""From a path to the data of a report: the session judged again, and compared with recorded verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from twinmatch.errors import TwinmatchError
from twinmatch.offline.backtest import Backtest, Choices, Listener, graded
from twinmatch.offline.judgement import Judgement, Watch
from twinmatch.offline.judgement import judge as judge_on
from twinmatch.offline.terms import Terms, recorded_terms, terms_from_files
from twinmatch.offline.verification import compare, holds_verdicts
from twinmatch.sessions import Session, open_any
from twinmatch.sessions.files import ProgressCallback, part_of

__all__ = ["Judged", "judge"]


@dataclass(frozen=True, eq=False)
class Judged:
    """A session, its judgement, and the origin of its parameters and verdicts."""

    session: Session
    judgement: Judgement
    tested: Backtest
    """The forecasts made during the judgement, compared with the measurements."""
    parameters: str
    """Where the parameters came from, in words."""
    recorded: str
    """How the verdicts in the session compare with those of the judgement, in a sentence."""
    identical: bool | None
    """Whether they are the same bit for bit; None if there are none, or they cannot be compared."""


def judge(
    path: Path,
    *,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
    progress: ProgressCallback | None = None,
) -> Judged:
    """Judge a session, an `.mcap` file or a recording for a report.

    Without `config` the parameters are those recorded with the session, otherwise the defaults; the same
    applies to the initial candidates.

    Raises:
        TwinmatchError: one of the files cannot be used.
    """
    session = open_any(path, progress=progress, plant=plant)
    terms, unlike = _terms(session, config, candidates)
    choices = Choices()
    listener = Listener.to(session.samples, terms.settings.period, choices)
    judgement = judge_on(session, terms, watch=part_of(watch, 0, 2), beside=listener)
    tested = graded(judgement, listener, choices, watch=part_of(watch, 1, 2))
    recorded, identical = _compared(session, judgement, unlike)
    return Judged(session, judgement, tested, terms.source, recorded, identical)


def _terms(session: Session, config: Path | None, candidates: Path | None) -> tuple[Terms, str]:
    """The terms, and why they differ from those of the recorded verdicts; empty: they do not."""
    try:
        return recorded_terms(session, config, candidates), ""
    except TwinmatchError as error:
        return terms_from_files(session, config, candidates), str(error)


def _compared(session: Session, judgement: Judgement, unlike: str) -> tuple[str, bool | None]:
    count = holds_verdicts(session)
    if not count:
        return "The session has no recorded verdicts; all of them were computed for this report.", None
    try:
        found = None if unlike else compare(session, judgement)
    except TwinmatchError as error:
        found, unlike = None, str(error)
    if found is None:
        return (
            f"The session has {count} recorded verdicts. They were computed again for this report and could "
            f"not be compared with the recorded ones: {unlike}."
        ), None
    held = f"The session has {found.verdicts} recorded verdicts and {_matches(found.matches)}."
    if found.identical:
        return f"{held} They were computed again for this report and are the same, bit for bit.", True
    return (
        f"{held} They were computed again for this report and differ from the recorded ones. "
        f"First difference: {found.difference}."
    ), False


def _matches(count: int) -> str:
    return f"{count} match{'' if count == 1 else 'es'}"
