"""Runs the samples of a session through the twin and collects the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinmatch.comparing import Candidate, Verdict
from twinmatch.offline.interrupt import held_interrupts
from twinmatch.offline.terms import Terms, terms_from_files
from twinmatch.sessions import Session, open_any
from twinmatch.showing.summary import SessionSummary, summarise
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport, Outcome, Twin, TwinSettings

__all__ = ["Judgement", "Watch", "judge", "judge_samples", "judge_session"]

Watch = Callable[[int, int], None]
"""Called with (samples done, total) every `EVERY` samples."""

EVERY = 50
"""Samples between two calls of `Watch`."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """All results of a session."""

    name: str
    samples: Sequence[Sample]
    settings: TwinSettings
    matches: tuple[MatchReport, ...]
    verdicts: tuple[Verdict, ...]
    summary: SessionSummary


def judge_session(
    path: Path,
    *,
    candidates: Path | None = None,
    config: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
) -> Judgement:
    """Judge a session, an .mcap file or a recording.

    Args:
        path: the session or recording.
        candidates: file of initial candidates.
        config: parameter file; without it the defaults.
        plant: name or file of the plant, if the session does not name it or it is in a file.
        watch: called with the progress.

    Raises:
        TwinmatchError: one of the files cannot be used.
    """
    session = open_any(path, plant=plant)
    return judge(session, terms_from_files(session, config, candidates), watch=watch)


def judge(
    session: Session,
    terms: Terms,
    *,
    watch: Watch | None = None,
    on_outcome: Callable[[int, Outcome], None] | None = None,
    beside: Callable[[Twin, Sample, Outcome], None] | None = None,
) -> Judgement:
    """Judge a session with these terms; see `judge_samples`."""
    return judge_samples(
        session.name,
        session.samples,
        terms.settings,
        given=terms.given,
        matching=terms.matching,
        notes=session.notes,
        watch=watch,
        on_outcome=on_outcome,
        beside=beside,
    )


def judge_samples(
    name: str,
    samples: Sequence[Sample],
    settings: TwinSettings,
    *,
    given: Sequence[Candidate] = (),
    matching: TwinSettings | None = None,
    notes: Sequence[str] = (),
    watch: Watch | None = None,
    on_outcome: Callable[[int, Outcome], None] | None = None,
    beside: Callable[[Twin, Sample, Outcome], None] | None = None,
) -> Judgement:
    """Push samples through a twin, one by one, as the live nodes do; Ctrl-C takes effect between two of them.

    `matching` are separate settings for matches, if any. `on_outcome` is called after every sample with its
    number, from 1, and its outcome; `beside` with the twin in its current state, the sample and the outcome.
    """
    twin = Twin(settings, given, matching=matching)
    matches: list[MatchReport] = []
    verdicts: list[Verdict] = []
    with held_interrupts() as check_interrupt:
        for done, sample in enumerate(samples):
            outcome = twin.push(sample)
            if outcome.match is not None:
                matches.append(outcome.match)
            verdicts += outcome.verdicts
            if on_outcome is not None:
                on_outcome(done + 1, outcome)
            if beside is not None:
                beside(twin, sample, outcome)
            if watch is not None and done % EVERY == 0:
                watch(done, len(samples))
            check_interrupt()
        summary = summarise(samples, verdicts, settings.gains, notes, settings.period)
    return Judgement(name, samples, settings, tuple(matches), tuple(verdicts), summary)
