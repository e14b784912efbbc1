"""A recorded session through the twin, offline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinmatch.discrimination import Candidate, Verdict
from twinmatch.nodes.twin_parameters import at_period, read_settings
from twinmatch.sessions import open_any
from twinmatch.sessions.candidates import read_candidates
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport, Outcome, Twin, TwinSettings
from twinmatch.views import Summary, summarise

__all__ = ["Judgement", "judge_on", "judge_samples", "judge_session"]


@dataclass(frozen=True, eq=False)
class Judgement:
    """Everything that came out of a session."""

    name: str
    samples: Sequence[Sample]
    settings: TwinSettings
    matches: tuple[MatchReport, ...]
    verdicts: tuple[Verdict, ...]
    summary: Summary


def judge_session(
    path: Path,
    *,
    candidates: Path | None = None,
    config: Path | None = None,
    watch: Callable[[int, int], None] | None = None,
) -> Judgement:
    """Judge a session, an .mcap file or a recording.

    Args:
        path: what to judge.
        candidates: file of candidates to begin with.
        config: file of parameters.
        watch: called with (samples done, samples in all) now and then.

    Raises:
        TwinmatchError: one of the files cannot be used.
    """
    given = read_candidates(candidates) if candidates else []
    return judge_on(path, read_settings(config), given, config=config, watch=watch)


def judge_on(
    path: Path,
    settings: TwinSettings,
    given: Sequence[Candidate] = (),
    *,
    config: Path | None = None,
    watch: Callable[[int, int], None] | None = None,
) -> Judgement:
    """Judge what a path holds with settings at hand.

    Args:
        path: a session, an .mcap file or a recording.
        settings: fitted to the session's sample time, unless they came from a file.
        given: candidates to begin with.
        config: the file the settings came from, for messages; None: they are the defaults.
        watch: called with (samples done, samples in all) now and then.

    Raises:
        TwinmatchError: the session cannot be used, or has another sample time than the file says.
    """
    session = open_any(path)
    settings = at_period(settings, session.period, config)
    return judge_samples(
        session.name, session.samples, settings, given=given, notes=session.notes, watch=watch
    )


def judge_samples(
    name: str,
    samples: Sequence[Sample],
    settings: TwinSettings,
    *,
    given: Sequence[Candidate] = (),
    notes: Sequence[str] = (),
    watch: Callable[[int, int], None] | None = None,
    told: Callable[[int, Outcome], None] | None = None,
) -> Judgement:
    """Push samples through a twin, one by one, as the live nodes do.

    `watch` is called now and then, `told` after every sample with its number, from 1, and what came of it.
    """
    twin = Twin(settings, given)
    matches: list[MatchReport] = []
    verdicts: list[Verdict] = []
    for done, sample in enumerate(samples):
        outcome = twin.push(sample)
        if outcome.match is not None:
            matches.append(outcome.match)
        verdicts += outcome.verdicts
        if told is not None:
            told(done + 1, outcome)
        if watch is not None and done % 50 == 0:
            watch(done, len(samples))
    summary = summarise(samples, verdicts, settings.gains, notes, limits=settings.limits)
    return Judgement(name, samples, settings, tuple(matches), tuple(verdicts), summary)
