"""What is learned of a plant's sensors from their readings: noise, last digit, pauses, and long repeats."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from twinmatch.dynamics import Model
from twinmatch.dynamics.bank import JUNK
from twinmatch.signals import BoolArray, FloatArray

_SECOND: Final = 1.954
"""Mean size of the second difference of white noise, in its standard deviation."""
_STANDS: Final = math.log(1.0 - 1e-4)
"""Log-probability with which a frozen sensor repeats its reading."""
_MOVES: Final = 20
"""Movements of a reading after which its last digit is known."""


class LearnedSensors:
    """Learns of all outputs of one plant; every array has a value for each."""

    def __init__(self, model: Model, second: float) -> None:
        """Begin with the plant file's noise; `second`: samples in a second of a plant as fast as the rig."""
        self._usual, self._second, o = model.noise, second, len(model.noise)
        self._spans = np.array([output.span[1] - output.span[0] for output in model.plant.outputs.values()])
        self.noise = model.noise.copy()
        self.steps = 0.1 * model.noise
        """Of the last digits."""
        self._rough, self._walk = model.noise * _SECOND, 2.0 * model.noise
        self._smallest, self._moves = np.full(o, np.inf), np.zeros(o, dtype=int)
        self._pauses = np.tile(np.array([[1.0, 50.0], [2.0, 4.0]]), (o, 1, 1))
        self.restart()

    def restart(self) -> None:
        """Begin again after a gap, keeping what was learned."""
        o = self._usual.size
        self._before = np.full((2, o), np.nan)
        self.repeated = np.zeros(o, dtype=bool)
        """Whether each reading is the one before."""
        self._state = np.zeros(o, dtype=int)
        self.repeats, self.frozen = np.zeros(o, dtype=int), np.zeros(o)
        """How often in a row, and what that says for a frozen sensor, nats."""

    def read(self, values: FloatArray, seen: BoolArray) -> FloatArray:
        """Take a sample; the probability that a healthy sensor repeats itself, whatever the plant does."""
        self._state = self.repeated.astype(int)
        self.repeated = (values == self._before[1]) & seen
        paused, of = self._pauses[np.arange(values.size), self._state].T
        return np.asarray(paused / of)

    def walked(self, values: FloatArray, seen: BoolArray, pauses: FloatArray, gained: FloatArray) -> float:
        """Log-probability of the readings without equations: each is like the one before. A repeat says
        nothing of a display with coarse steps: it counts as the equations say, `gained`."""
        total = 0.0
        for i in range(values.size):
            if self.repeated[i]:
                total += gained[i]
            elif seen[i] and not math.isnan(self._before[1, i]):
                off, spread, digit = values[i] - self._before[1, i], self._walk[i], self.steps[i]
                near, far = (_between(off, digit, by * spread) for by in (1.0, 3.0))
                junk = JUNK * min(digit / self._spans[i], 1.0)
                total += math.log((1.0 - pauses[i]) * (0.95 * near + 0.05 * far) + junk)
                moved = min(max(abs(off), 0.3 * self.noise[i]), 4.0 * spread)
                self._walk[i] += (1.2 * moved - spread) / (30.0 * self._second)
        return total

    def learn(self, values: FloatArray, seen: BoolArray, gained: FloatArray) -> None:
        """Learn of this sample, whose readings had the log-probabilities `gained`."""
        self.repeats = np.where(self.repeated, self.repeats + 1, np.where(seen, 0, self.repeats))
        fresh = np.where(seen, 0.0, self.frozen)
        self.frozen = np.where(self.repeated, self.frozen + _STANDS - gained, fresh)
        one, two, three = *self._before, np.where(seen, values, np.nan)
        self._before = np.array([two, three])
        if np.isnan(one).all():
            return
        rough, moved = np.abs(three - 2 * two + one), np.abs(three - two)
        for i in range(values.size):
            if not math.isnan(rough[i]):
                self._rough[i] += (min(rough[i], 3.0 * self._rough[i]) - self._rough[i]) / 100.0
            if moved[i] > 1e-9:
                self._moves[i] += 1
                self._smallest[i] = min(self._smallest[i], moved[i])
                if self._moves[i] >= _MOVES:
                    self.steps[i] = min(self._smallest[i], 30.0 * self._usual[i])
            if seen[i] and self.repeats[i] < 10:
                pauses = self._pauses[i, self._state[i]]
                pauses += (0.5 * self.repeated[i], 1.0)
                if pauses[1] > 500.0:
                    pauses *= 0.5
        self.noise = np.clip(self._rough / _SECOND, 0.3 * self._usual, 1.5 * self._usual)


def _between(off: float, digit: float, spread: float) -> float:
    """Probability that a normal value rounds to a reading that is `off` from its mean."""
    low, high = ((off + side * digit) / (math.sqrt(2.0) * spread) for side in (-0.5, 0.5))
    return 0.5 * (math.erf(high) - math.erf(low))
