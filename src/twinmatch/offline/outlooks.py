"""The twin's outlook at chosen samples of a session, from which it can forecast."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from twinmatch.forecasting import ForecastError, Outlook
from twinmatch.offline.interrupt import held_interrupts
from twinmatch.offline.judgement import EVERY, Watch
from twinmatch.offline.terms import Terms
from twinmatch.sessions import Session
from twinmatch.signals import Sample
from twinmatch.twin import Twin
from twinmatch.twin.forecaster import Forecaster

__all__ = ["Prospect", "prospects", "samples_at"]


class Prospect(NamedTuple):
    """A candidate ready to forecast from a sample, and the leader at that sample."""

    outlook: Outlook
    leader: str
    leader_confidence: float
    """How often so far the leader's error was within 3 % of the best candidate's, 0 to 1."""

    @property
    def leads(self) -> bool:
        """Whether the candidate is the leader."""
        return self.outlook.candidate == self.leader


def prospects(
    session: Session,
    terms: Terms,
    at: Collection[int],
    *,
    candidate: str | None = None,
    watch: Watch | None = None,
) -> dict[int, Prospect]:
    """Run a session through the twin once, up to the last of these samples, and collect the outlook at each.

    The outlook at a sample depends only on that sample and those before it.

    Args:
        session: the session.
        terms: parameters and initial candidates.
        at: indices of the samples.
        candidate: name of the candidate; the leader at each sample if not given.
        watch: called with (samples done, total).

    Raises:
        ForecastError: the session has no such sample, or the candidate does not exist at it.
    """
    wanted = samples_at(session, at)
    samples, found = session.samples, {}
    twin = Twin(terms.settings, terms.given, matching=terms.matching)
    ends = max((place for place, s in enumerate(samples) if s.index in wanted), default=-1) + 1
    with held_interrupts() as check_interrupt:
        for done, sample in enumerate(samples[:ends]):
            twin.push(sample)
            if sample.index in wanted:
                if not twin.discriminator.forecaster.names:
                    raise _no_candidate(session.name, twin, samples[done:])
                found[sample.index] = _prospect(twin.discriminator.forecaster, sample.index, candidate)
            if watch is not None and done % EVERY == 0:
                watch(done, ends)
            check_interrupt()
    return found


def samples_at(session: Session, at: Collection[int]) -> dict[int, Sample]:
    """The samples with these indices.

    Raises:
        ForecastError: the session does not have one of them.
    """
    wanted = set(at)
    found = {sample.index: sample for sample in session.samples if sample.index in wanted}
    absent = sorted(wanted - found.keys())
    if absent:
        first, last = session.samples[0].index, session.samples[-1].index
        why = " without that one" if first < absent[0] < last else ""
        msg = (
            f"session {session.name}: has no sample {absent[0]} to forecast from; it has {first} to "
            f"{last}{why}"
        )
        raise ForecastError(msg)
    return found


def _prospect(forecaster: Forecaster, sample: int, candidate: str | None) -> Prospect:
    leader = forecaster.leader
    assert leader is not None  # noqa: S101 — there are candidates
    name = leader if candidate is None else candidate
    if name not in forecaster.names:
        names = "; ".join(forecaster.names)
        raise ForecastError(f"sample {sample}: there is no candidate {name!r}; there are: {names}")
    return Prospect(_outlook(forecaster, name), leader, forecaster.confidence)


def _outlook(forecaster: Forecaster, candidate: str) -> Outlook:
    """The outlook, with a note if none of the candidate's forecasts has been evaluated yet."""
    outlook = forecaster.outlook(candidate)
    if forecaster.forecasts_of(candidate):
        return outlook
    note = (
        "no forecast of this candidate has been compared with measurements yet, so the band is only its own "
        "estimate"
    )
    return replace(outlook, notes=(*outlook.notes, note))


def _no_candidate(session: str, twin: Twin, rest: Sequence[Sample]) -> ForecastError:
    """The error for a sample without candidates, with the first sample that has one."""
    absent = f"session {session}: there is no candidate at sample {rest[0].index}"
    for sample in rest[1:]:
        twin.push(sample)
        if twin.discriminator.forecaster.names:
            return ForecastError(f"{absent}; there is one from sample {sample.index} on")
    needed = "record set-point steps far above the noise, some minutes apart,"
    if twin.settings.gains is None:
        needed = "move the input far above its noise, for some minutes in total,"
    return ForecastError(
        f"{absent} or later, since no match was accepted; {needed} or give candidates with --candidates"
    )
