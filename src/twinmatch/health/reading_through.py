"""What a sensor that lies should read: a filter of the plant that continues without it."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Model
from twinmatch.dynamics.bank import BankMembers, ChangeRows, Reading, step, unborn
from twinmatch.health.mixture import HealthyMixture

_BAND: Final = 1.645
"""Half of the band that holds nine of ten readings, in standard deviations."""


class MissingReading(NamedTuple):
    """What a sensor should read."""

    value: float
    band: float
    """Half of the width that holds 90 % of what it would read, both in the output's unit."""


class ReadThrough:
    """Estimates one output from the inputs and from the other outputs; push every sample."""

    def __init__(
        self, model: Model, healthy: HealthyMixture, output: int, table: ChangeRows, since: int
    ) -> None:
        """Begin with what is believed now, or with what was believed before its reading stood, `since` so
        many samples after the last gap; 0: it does not stand."""
        self._code, self._fixed, self._output, self._table = model.kernels.code, healthy.fixed, output, table
        self._alone, self._healthy = healthy.without(output, since), healthy
        self._none = unborn(0, len(healthy.numbers))
        self._given: Reading | None = None
        self._noise = 0.0
        self.samples = 0
        """Samples since it began."""
        self.good: float | None = None
        """For how long it was to be good when it began, s; None before that is known."""
        self.estimate = MissingReading(math.nan, math.nan)
        """What the sensor should read now."""

    def push(self, given: Reading, variance: float) -> None:
        """Take a sample in which this sensor does not count; `variance` is that of its noise."""
        self._given, self._noise, self.samples = given, variance, self.samples + 1
        step(self._code, self._fixed, self._alone, self._none, self._table, 1, given, 0)
        self.estimate = self._seen_in(self._alone, self.samples)

    def lasts(self, wide: float, longest: int) -> int:
        """For how many samples, at most `longest`, the band stays narrower than ± `wide` under these inputs,
        if the other sensors read what is expected."""
        members, given = BankMembers(*(array.copy() for array in self._alone)), self._given
        if given is None:
            return 0
        quiet = np.zeros_like(given.repeated)
        for k in range(longest):
            if self._seen_in(members, self.samples + k).band > wide:
                return k
            given = given._replace(y=members.expected[0].copy(), repeated=quiet)
            step(self._code, self._fixed, members, self._none, self._table, 1, given, 0)
        return longest

    def _seen_in(self, members: BankMembers, age: int) -> MissingReading:
        doubts = self._healthy.doubts
        variance = members.variance[0, self._output] * doubts[min(age, doubts.size - 1)]
        return MissingReading(
            float(members.expected[0, self._output]), _BAND * math.sqrt(variance + self._noise)
        )
