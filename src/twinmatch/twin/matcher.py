"""Samples in, matches out."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.discrimination import Candidate, Family
from twinmatch.matching import Match, Status, match
from twinmatch.signals import Sample
from twinmatch.twin.schedule import Schedule, Trigger
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.threads import one_thread

__all__ = ["MatchReport", "Matcher", "candidate_name"]


class MatchReport(NamedTuple):
    """A match and where in the session it was made."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: float
    """Set-point at the window's end, °C."""
    match: Match


class Matcher:
    """Fits the rig parameters whenever the schedule says a window excited the loop."""

    def __init__(self, settings: TwinSettings | None = None) -> None:
        """Begin with the start values of the settings."""
        self.settings = settings or TwinSettings()
        self.schedule = Schedule(self.settings.schedule, self.settings.period)
        self._standing = Family(self.settings.most_candidates, self.settings.regime_width)

    def push(self, sample: Sample) -> MatchReport | None:
        """Take one sample; return the match it sets off, if any."""
        trigger = self.schedule.push(sample)
        if trigger is None or not trigger.excited:
            return None
        with one_thread():
            return self._match(trigger)

    def _match(self, trigger: Trigger) -> MatchReport:
        settings = self.settings
        standing = self._standing.standing_at(trigger.operating_point)
        result = match(
            trigger.window,
            free=settings.free,
            start=standing.parameters if standing else settings.start,
            incumbent=standing.parameters if standing else None,
            noise=settings.noise,
            gains=settings.gains,
            min_step=settings.schedule.min_step,
        )
        if result.status is Status.ACCEPTED:
            name = candidate_name(trigger.operating_point)
            self._standing.admit(Candidate(name, trigger.operating_point, result.parameters, None))
        return MatchReport(trigger.sample, trigger.operating_point, result)


def candidate_name(operating_point: float) -> str:
    """What a candidate is called: the set-point it was matched at."""
    return f"{operating_point:g} °C"
