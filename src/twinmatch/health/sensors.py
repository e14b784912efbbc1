"""What is learned of a sensor from its readings: noise, last digit, pauses, and long repeats."""

from __future__ import annotations

import math
from typing import Final

from twinmatch.dynamics.bank import JUNK
from twinmatch.health.roughness import Roughness

_STANDS: Final = math.log(1.0 - 1e-4)
"""Log-probability with which a frozen sensor repeats its reading."""
_MOVES: Final = 20
"""Movements of a reading after which its last digit is known."""


class LearnedSensor:
    """Learns of one output; numbers are in its unit."""

    def __init__(self, noise: float, span: tuple[float, float], second: float) -> None:
        """Begin with the plant file's noise; `second`: samples in a second of a plant as fast as the rig."""
        self._usual = noise
        self._span = span[1] - span[0]
        self._second = second
        self.noise = noise
        """Standard deviation of a reading."""
        self.step = 0.1 * noise
        """Value of its last digit."""
        self._roughness = Roughness(noise)
        self._walk = 2.0 * noise  # how far readings usually move in a sample
        self._smallest = math.inf  # movement so far
        self._moves = 0  # movements so far
        # Counts of repeats and of readings: after a new reading, and after a repeat.
        self._pauses = [[1.0, 50.0], [2.0, 4.0]]
        self.restart()

    def restart(self) -> None:
        """Begin again after a gap, keeping what was learned."""
        self._before = self._earlier = math.nan  # the reading before, and the one before that
        self._anchor = math.nan  # the reading before an outlier
        self._counted = self._pauses[0]
        self.repeated = False
        """Whether the reading is the one before."""
        self.repeats = 0
        """Repeats in a row."""
        self.frozen = 0.0
        """What they say for a frozen sensor, nats."""

    @property
    def variance(self) -> float:
        """That of a reading, with its rounding."""
        return self.noise**2 + self.step**2 / 12.0

    def read(self, value: float, counts: bool) -> None:
        """Take a reading, and whether it counts."""
        self._counted = self._pauses[self.repeated]
        self.repeated = counts and value == self._before

    @property
    def pause(self) -> float:
        """Probability that it repeats this reading, or might have, whatever the plant does."""
        return self._counted[0] / self._counted[1]

    def walked(self, value: float, counts: bool, gained: float) -> float:
        """Log-probability of the reading without equations: it is like the one before. A repeat says nothing
        of a display with coarse steps: it counts as the equations say, `gained`."""
        if self.repeated:
            return gained
        if not counts or math.isnan(self._before):
            return 0.0
        anchor = self._before if math.isnan(self._anchor) else self._anchor
        change = value - anchor
        spread = self._walk
        near = _between(change, self.step, 1.0 * spread)
        far = _between(change, self.step, 3.0 * spread)
        moved = min(max(abs(change), 0.3 * self.noise), 4.0 * spread)
        self._walk += (1.2 * moved - spread) / (30.0 * self._second)
        likelihood = 0.95 * near + 0.05 * far
        junk = JUNK * min(self.step / self._span, 1.0)
        # A reading that says nothing is not where the next one starts, but two are.
        self._anchor = anchor if likelihood < junk and math.isnan(self._anchor) else math.nan
        return math.log((1.0 - self.pause) * likelihood + junk)

    def learn(self, value: float, counts: bool, gained: float) -> None:
        """Learn of this reading, whose log-probability was `gained`."""
        if self.repeated:
            self.repeats = self.repeats + 1
            self.frozen = self.frozen + _STANDS - gained
        elif counts:
            self.repeats = 0
            self.frozen = 0.0
        earlier = self._earlier
        before = self._before
        self._earlier = before
        self._before = value if counts else math.nan
        if not counts or math.isnan(before):
            return
        if self.repeats < 10:
            self._counted[0] += 0.5 * self.repeated
            self._counted[1] += 1.0
            if self._counted[1] > 500.0:
                self._counted[:] = 0.5 * self._counted[0], 0.5 * self._counted[1]
        moved = abs(value - before)
        if moved > 1e-9:
            self._moves = self._moves + 1
            self._smallest = min(self._smallest, moved)
            if self._moves >= _MOVES:
                self.step = min(self._smallest, 30.0 * self._usual)
        if not math.isnan(earlier):
            self._roughness.take(abs(value - 2.0 * before + earlier))
        self.noise = self._roughness.noise


def _between(deviation: float, digit: float, spread: float) -> float:
    """Probability that a normal value rounds to a reading with this deviation from its mean."""
    low = (deviation - 0.5 * digit) / (math.sqrt(2.0) * spread)
    high = (deviation + 0.5 * digit) / (math.sqrt(2.0) * spread)
    return 0.5 * (math.erf(high) - math.erf(low))
