"""What the law takes in place of readings: decided from verdicts, by the objects that decide it in the bridge."""

from __future__ import annotations

import math
from collections.abc import Iterable

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.health import EstimatedReading
from twinmatch.safety import Accusations, StandIns

__all__ = ["LawOnEstimates", "accusation_in"]


def accusation_in(verdict: Verdict, accusations: Accusations) -> str | None:
    """What a verdict accuses, once `accusations` has taken it; None if it accuses nothing."""
    return accusations.take(
        verdict.sample,
        trusted=verdict.level is TrustLevel.TRUSTED,
        fault=verdict.fault,
        reason=verdict.reason,
    )


class LawOnEstimates:
    """A law for which estimates may stand in for the readings of some sensors.

    The bridge receives a verdict after the sample that it is about, and before the next one is read. What its
    guards end besides is not known here: no law runs then.
    """

    def __init__(self, signals: Iterable[str], period: float) -> None:
        """Begin with sensors that are believed; `period` is that of the samples, s."""
        # The bridge's limit of what is too hot ends the drive: it is the guard's.
        self._stand_ins = StandIns(signals, math.inf, "")
        self._accusations = Accusations()
        self._period = period

    def take(self, verdict: Verdict) -> None:
        """Take a verdict, which may accuse a sensor or give sensors back."""
        if accusation_in(verdict, self._accusations) is not None:
            accused_at = verdict.sample * self._period
            self._stand_ins.accuse(verdict.fault_signal, verdict.fault, accused_at)
        if not verdict.fault:
            self._stand_ins.give_back()

    def taken_after(
        self, sample: int, estimates: Iterable[EstimatedReading]
    ) -> dict[str, float]:
        """By signal, what the law takes at the sample after this one, whose estimates these are."""
        now = sample * self._period
        for estimate in estimates:
            self._stand_ins.take(
                estimate.signal, estimate.value, estimate.band, estimate.wide, now
            )
        return {
            signal: state.value
            for signal, state in self._stand_ins.look(now).items()
            if not math.isnan(state.value)
        }
