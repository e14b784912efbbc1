"""What the law takes in place of readings: decided here as the bridge decides it, from the same verdicts."""

from __future__ import annotations

import math
from collections.abc import Iterable

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.health import EstimatedReading
from twinmatch.safety import ACCUSED, Accusations, StandIn

__all__ = ["StandIns"]


class StandIns:
    """The sensors that an operator has allowed to be read through.

    The bridge receives a verdict after the sample that it is about, and before the next one is read. What its
    guards end besides is not known here: no law runs then.
    """

    def __init__(self, signals: Iterable[str], period: float) -> None:
        """Begin with sensors that are believed; `period` is that of the samples, s."""
        # The bridge's limit of what is too hot ends the drive: it is the guard's.
        self._of_signals = {signal: StandIn(signal, math.inf, "") for signal in signals}
        self._period = period
        self._accusations = Accusations()

    def take(self, verdict: Verdict) -> None:
        """Take a verdict, which may accuse a sensor or give sensors back."""
        accusation = self._accusations.take(
            verdict.sample,
            trusted=verdict.level is TrustLevel.TRUSTED,
            fault=verdict.fault,
            reason=verdict.reason,
        )
        accused = self._of_signals.get(verdict.fault_signal)
        if (
            accusation is not None
            and accused is not None
            and verdict.fault in ACCUSED["sensor"]
        ):
            accused.accuse(verdict.sample * self._period)
        if not verdict.fault:
            for stand_in in self._of_signals.values():
                stand_in.give_back()

    def taken_after(
        self, sample: int, estimates: Iterable[EstimatedReading]
    ) -> dict[str, float]:
        """By signal, what the law takes at the sample after this one, whose estimates these are."""
        now = sample * self._period
        for estimate in estimates:
            stand_in = self._of_signals.get(estimate.signal)
            if stand_in is not None:
                stand_in.take(estimate.value, estimate.band, estimate.wide, now)
        taken = {
            signal: stand_in.look(now).value
            for signal, stand_in in self._of_signals.items()
        }
        return {
            signal: value for signal, value in taken.items() if not math.isnan(value)
        }
