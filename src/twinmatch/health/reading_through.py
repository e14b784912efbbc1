"""What a sensor that lies should read: a filter of the plant that continues without it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Model
from twinmatch.dynamics.bank import (
    BankConstants,
    BankMembers,
    ChangeRows,
    Reading,
    step,
    unborn,
)
from twinmatch.settings import Rule


class _Bands(Rule):
    """Bands of the estimates that are made without a sensor."""

    far: float = 3.0
    """Bands beyond which an estimate was missed: five standard deviations."""
    untried: float = 2.0
    """Times as far, where no fresh reading has shown what the estimate is worth."""
    strays: float = 4.0
    """How far an estimate usually strays within the longest but one of these ages, in the sensor's noise."""
    prior: float = 2.0
    """Number of rehearsals as which that usual error counts."""


_BANDS: Final = _Bands()


_Z: Final = 1.645
"""Half of the band that holds nine of ten, in standard deviations of a normal distribution."""
_AGES: Final = np.array([10.0, 30.0, 60.0, 120.0, 300.0, 600.0])
"""Ages up to which errors are learned apart, s of a plant as fast as the rig; beyond, those of the last."""


class MissingReading(NamedTuple):
    """What a sensor should read."""

    value: float
    band: float
    """Half of the width that holds 90 % of what it would read, both in the output's unit."""


class ReadThrough:
    """Estimates one output from the inputs and from the other outputs; push every sample."""

    def __init__(
        self,
        model: Model,
        members: BankMembers,
        fixed: BankConstants,
        output: int,
        *,
        table: ChangeRows,
        band: Callable[[int, float, float], float],
    ) -> None:
        """Continue with one member that asks the sensor nothing. `band` is half of the width that holds nine
        of ten readings at an age, samples, where the member's variance and that of the noise are given."""
        self._code = model.kernels.code
        self._fixed = fixed
        self._output = output
        self._table = table
        self._member = members
        self._band = band
        self._no_traces = unborn(0, members.at.shape[1])
        self._newest: Reading | None = None
        self._noise = 0.0
        self.samples = self.rehearsed = 0
        """Samples since it began, and those of them at which it was not needed yet."""
        self.good: float | None = None
        """For how long it was to be good when it began, s; None before that is known."""
        self.estimate = MissingReading(math.nan, math.nan)
        """What the sensor should read now."""

    @property
    def belief(self) -> BankMembers:
        """What is believed without the sensor, as one member."""
        return self._member

    def push(self, reading: Reading, variance: float) -> None:
        """Take a sample in which this sensor does not count; `variance` is that of its noise."""
        self._newest = reading
        self._noise = variance
        self.samples = self.samples + 1
        step(
            self._code,
            self._fixed,
            self._member,
            self._no_traces,
            self._table,
            1,
            reading,
            0,
        )
        self.estimate = self._seen_in(self._member, self.samples)

    def lasts(self, wide: float, longest: int) -> int:
        """For how many samples, at most `longest`, the band stays narrower than ± `wide` under these inputs,
        if the other sensors read what is expected."""
        members = BankMembers(*(array.copy() for array in self._member))
        reading = self._newest
        if reading is None:
            return 0
        quiet = np.zeros_like(reading.repeated)
        for k in range(longest):
            if self._seen_in(members, self.samples + k).band > wide:
                return k
            reading = reading._replace(y=members.expected[0].copy(), repeated=quiet)
            step(
                self._code,
                self._fixed,
                members,
                self._no_traces,
                self._table,
                1,
                reading,
                0,
            )
        return longest

    def is_missed_by(self, value: float) -> bool:
        """Whether a reading is farther off from the estimate than that usually errs."""
        return self.bands_off(value) > _BANDS.far

    def bands_off(self, value: float) -> float:
        """By how many bands a reading is off from the estimate."""
        expected, band = self.estimate
        return abs(value - expected) / band

    def _seen_in(self, members: BankMembers, age: int) -> MissingReading:
        expected = float(members.expected[0, self._output])
        variance = float(members.variance[0, self._output])
        return MissingReading(expected, self._band(age, variance, self._noise))


class Rehearsal:
    """Reads through a sensor that is right, again and again, and learns how far off that is."""

    def __init__(self, second: float, noise: float) -> None:
        """Begin without any; `second`: samples in a second of a plant as fast as the rig; `noise` as the
        plant file declares it."""
        self._usual = (_BANDS.strays * noise) ** 2
        self._strays = _AGES[-2] * second
        self._ends = np.round(_AGES * second).astype(np.int64)
        self.sums = np.zeros(_AGES.size)
        """By age, the mean squared errors of the rehearsals that count, added up, in squares of the unit."""
        self.counts = np.zeros(_AGES.size)
        """By age, the number of these rehearsals."""
        self._early = True
        """Whether all of them began before the plant was known well."""
        self.drop()

    def drop(self) -> None:
        """Forget the one that is on: something else than its error may have come into it."""
        self.on: ReadThrough | None = None
        self.newest: ReadThrough | None = None
        """The one that took the newest sample, which may be over with it."""
        self._bands_when_fresh = math.nan
        """By how many of its bands it was off when the sensor's newest fresh reading came."""
        self._began_early = False
        self._squares, self._samples = np.zeros((2, _AGES.size))

    def begin(self, estimate: ReadThrough, *, early: bool) -> None:
        """Begin one; `early`: the plant is not known well yet. What such a one shows counts only until a
        later one is over: the errors that it has made are made no longer."""
        self.on = estimate
        self.newest = estimate
        self._began_early = early

    def push(self, reading: Reading, variance: float, output: int) -> None:
        """Take a sample of all outputs, and the variance of the noise of this one."""
        self.newest = self.on
        if self.on is None:
            return
        of_others = np.arange(reading.seen.size) != output
        self.on.push(reading._replace(seen=reading.seen & of_others), variance)
        if reading.seen[output] and not reading.repeated[output]:
            self._bands_when_fresh = self.on.bands_off(float(reading.y[output]))
        age = int(np.searchsorted(self._ends, self.on.samples))
        if age == _AGES.size:
            if reading.repeated[output]:
                return  # it may be frozen, and this is what shows it
            # the sensor was right: so far off are estimates
            if self._early and not self._began_early:
                self.sums[:] = 0.0
                self.counts[:] = 0.0
                self._early = False
            has_samples = self._samples > 0.0
            self.sums[has_samples] += (
                self._squares[has_samples] / self._samples[has_samples]
            )
            self.counts += has_samples
            newest = self.on
            self.drop()
            self.newest = newest
        elif reading.seen[output]:
            self._squares[age] += max(
                (reading.y[output] - self.on.estimate.value) ** 2 - variance, 0.0
            )
            self._samples[age] += 1.0

    def missed(self, since: int, value: float) -> bool:
        """Whether this reading, which has been repeated for so many samples, is far from the estimate.

        An estimate counts for what it was worth when the reading was fresh: the more of its standard
        deviations it was off by then, the farther it has to be off now. One that began later has shown nothing, and
        began nearer to where the reading stands than the plant was, if anything.
        """
        if self.on is None:
            return False
        if self.on.samples <= since:
            return self.on.bands_off(value) > _BANDS.untried * _BANDS.far
        deviations_when_fresh = _Z * self._bands_when_fresh
        return self.on.bands_off(value) > _BANDS.far * max(deviations_when_fresh, 1.0)

    def band(self, age: int, variance: float, noise: float) -> float:
        """Half of the width that holds nine of ten readings at an age, samples: that of Student's t, as the
        errors within a rehearsal are nearly one. The member's own variance, and the usual error, count as
        some rehearsals."""
        upto = min(int(np.searchsorted(self._ends, age)), _AGES.size - 1)
        number = _BANDS.prior + self.counts[upto]
        usual = max(variance, self._usual * min(age / self._strays, 1.0))
        squares = max(variance, (_BANDS.prior * usual + self.sums[upto]) / number)
        wider = (
            1.0
            + (_Z**2 + 1.0) / (4.0 * number)
            + (5.0 * _Z**4 + 16.0 * _Z**2 + 3.0) / (96.0 * number**2)
        )
        return _Z * math.sqrt(wider**2 * squares + noise)
