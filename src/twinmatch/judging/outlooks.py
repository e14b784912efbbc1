"""What the twin knows at chosen samples of a session of what comes next."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from twinmatch.forecasting import ForecastError, Outlook
from twinmatch.judging.interrupt import held_interrupts
from twinmatch.judging.judgement import EVERY, Watch
from twinmatch.judging.terms import Terms
from twinmatch.sessions import Session
from twinmatch.signals import Sample
from twinmatch.twin import Twin
from twinmatch.twin.forecaster import Forecaster

__all__ = ["Prospect", "prospects", "samples_at"]


class Prospect(NamedTuple):
    """A candidate ready to be asked what comes after a sample, and whose lead it was then."""

    outlook: Outlook
    leader: str
    leader_confidence: float
    """How often the leader's error was within 3 % of the best candidate's in hindsight, so far."""

    @property
    def leads(self) -> bool:
        """Whether the one that is asked is the leader."""
        return self.outlook.candidate == self.leader


def prospects(
    session: Session,
    terms: Terms,
    at: Collection[int],
    *,
    candidate: str | None = None,
    watch: Watch | None = None,
) -> dict[int, Prospect]:
    """Send a session through the twin once, as far as the last of these samples, and stop at each of them.

    What is known at a sample depends on it and on those before it, whatever else is asked for.

    Args:
        session: with these samples.
        terms: parameters and candidates to begin with.
        at: indices of the samples.
        candidate: whom to ask; the leader of each sample if not given.
        watch: called now and then with (samples done, samples in all).

    Raises:
        ForecastError: the session has no such sample, or there is no candidate, or not that one, at it.
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
                    raise _nobody(session.name, twin, samples[done:])
                found[sample.index] = _prospect(twin.discriminator.forecaster, sample.index, candidate)
            if watch is not None and done % EVERY == 0:
                watch(done, ends)
            check_interrupt()
    return found


def samples_at(session: Session, at: Collection[int]) -> dict[int, Sample]:
    """The samples of these indices.

    Raises:
        ForecastError: the session does not hold one of them.
    """
    wanted = set(at)
    found = {sample.index: sample for sample in session.samples if sample.index in wanted}
    absent = sorted(wanted - found.keys())
    if absent:
        first, last = session.samples[0].index, session.samples[-1].index
        why = " without that one" if first < absent[0] < last else ""
        msg = (
            f"session {session.name}: has no sample {absent[0]} to foretell from; it holds {first} to "
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
        raise ForecastError(f"sample {sample}: no candidate is called {name!r}; there are: {names}")
    return Prospect(_outlook(forecaster, name), leader, forecaster.confidence)


def _outlook(forecaster: Forecaster, candidate: str) -> Outlook:
    """What it knows, with a word where no forecast of it could be judged yet."""
    outlook = forecaster.outlook(candidate)
    if forecaster.forecasts_of(candidate):
        return outlook
    note = (
        "no forecast of this candidate could be held against what came yet, so that the band is its own "
        "reckoning"
    )
    return replace(outlook, notes=(*outlook.notes, note))


def _nobody(session: str, twin: Twin, rest: Sequence[Sample]) -> ForecastError:
    """Why nobody can be asked at the first of the samples that are left, and from which on somebody can."""
    asked = f"session {session}: there is no candidate at sample {rest[0].index} to foretell what comes"
    for sample in rest[1:]:
        twin.push(sample)
        if twin.discriminator.forecaster.names:
            return ForecastError(f"{asked}; from sample {sample.index} on there is one")
    needed = "The loop needs set-point steps of a few degrees, some minutes apart,"
    if twin.settings.gains is None:
        needed = "The input has to move far above its noise, for some minutes in all,"
    return ForecastError(
        f"{asked}, nor at any later one: no match was accepted. {needed} or candidates given with "
        "--candidates"
    )
