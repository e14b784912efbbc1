"""Detectors for the traces that faults leave, one per kind of trace.

Sizes are counted in units of the output's noise, rates in that per second.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from twinmatch.health.balance import Movement
from twinmatch.health.earned import NOTHING
from twinmatch.settings import Rule

_SPANS: Final = (6.0, 8.0, 10.0, 12.0, 16.0, 20.0)
"""Lengths of the stretches over which the drive's effect is estimated, s."""


class _ComparedMovements(Rule):
    """Which movements of the drive are compared with the readings."""

    least: float = 15.0
    """Least movement expected from the drive, in noises: the size of a healthy camera's jumps."""
    rate: float = 4.5
    """What is added to it for every second, in noises: twice the error of a twin over minutes."""
    roughness: float = 2.0
    """What is added instead with a less accurate twin, in the roughness of the balance."""
    rough_rate: float = 1.0
    """Least usual error of a balance, in noises per second."""
    error_share: float = 0.25
    """Usual error of a balance as a share of what the drive does."""
    errors_last: float = 10.0
    """Time for which the error of a balance lasts, s: errors of a twin are alike for some seconds."""
    step: float = 8.0
    """A larger unexplained step is attributed to the sensor unless one like it came just before."""
    like: float = 4.0
    """Unexplained movement in the same direction just before that makes a step part of a movement."""


_COMPARED: Final = _ComparedMovements()


FOLLOWS: Final = (0.6, 2.5)
"""Range of shares of the expected effect that prove that the drive works."""


class _RepeatRule(Rule):
    """When a sensor that repeats its reading is frozen."""

    longer: float = 2.0
    """Factor by which a reading must be repeated more often than any before it: repeats come in runs."""
    chance: float = 1e-9
    """Probability below which repeated readings are not chance; a year has 3e7 seconds."""
    least_noise: float = 0.1
    """Mean change from reading to reading below which a healthy sensor may repeat itself indefinitely."""
    least_moves: int = 30
    """Changes of the reading needed to know how often it repeats."""
    coarsely: float = 8.0
    """Movement of the plant above which even a sensor with coarse steps should not repeat its reading."""
    steps: float = 3.0
    """A reading shows noise if its changes differ, on average, by so many of the smallest change."""
    moved: float = 30.0
    """Movement of the plant above which a sensor that repeats its reading is frozen."""
    missed: float = 30.0
    """Samples of readings that stood from which is known by how much the movement expected of them is missed."""


_REPEATS: Final = _RepeatRule()


class _LagRule(Rule):
    """How a lag of the input is looked for."""

    most: float = 7.0
    """Longest lag tried, s; the best one must be shorter, or it could as well be a dead drive."""
    least: float = 2.0
    """Least lag that is reported, s."""
    sum: float = 4.0
    """Movements are compared in sums over this time, to suppress noise, s."""
    far_better: float = 0.3
    """Share of the squared error that a far better explanation may leave."""


_LAG: Final = _LagRule()


class DriveEffect:
    """Whether the drive acts on the plant: what was seen of its expected effect over the newest stretches."""

    def restart(self) -> None:
        """Forget what was pushed."""
        self.share = math.nan
        """Least share of the expected effect over the judged stretches; NaN if none expects enough."""
        self.length = 0
        """Samples of that stretch."""
        self.expected = 0.0
        """Movement in it expected from the drive alone."""

    @property
    def follows(self) -> bool:
        """Whether the newest stretches prove that the drive works."""
        return FOLLOWS[0] <= self.share <= FOLLOWS[1]


class Effect(DriveEffect):
    """The effect of a drive that moves the output within a sample."""

    def __init__(self, period: float, noise: float) -> None:
        """`period` in s, `noise` of a reading."""
        self._period = period
        self._noise = noise
        self._spans = [max(2, round(s / period)) for s in _SPANS]
        self._accused: float | None = None  # the share that was last reported
        self.restart()

    def accuse(self) -> None:
        """The share was reported as a fault: from now on, what speaks against it is weighed."""
        self._accused = min(self.share, FOLLOWS[0])
        self.returned = 0.0

    def restart(self) -> None:
        """Forget what was pushed."""
        super().restart()
        self.returned = 0.0
        """Nats by which the whole effect has explained the movements better than the share that was reported.

        They are counted from the moment at which they were least.
        """
        self._sums: deque[tuple[float, float]] = deque(
            [(0.0, 0.0)], maxlen=self._spans[-1] + 1
        )
        self._last = 0.0

    def push(self, movement: Movement, roughness: float, *, earned: bool) -> None:
        """Take the movement of one period, the roughness (per second) of the balance that it comes from, and
        whether that balance has predicted the plant."""
        least = (
            max(_COMPARED.rate * self._noise, _COMPARED.roughness * roughness)
            * self._period
        )
        unexplained = movement.unexplained
        if self._accused is not None:
            usual = max(roughness, _COMPARED.rough_rate * self._noise) * self._period
            self._weigh(movement, usual, self._accused)
        continues = (
            abs(self._last) > _COMPARED.like * self._noise
            and unexplained * self._last > 0
        )
        isolated = abs(unexplained) > _COMPARED.step * self._noise and not continues
        self._last = unexplained
        drive, unexplained_sum = self._sums[-1]
        self._sums.append(
            (
                drive + movement.drive,
                unexplained_sum + (0.0 if isolated else unexplained),
            )
        )
        self.share = math.nan
        newest = self._sums[-1]
        moves = len(self._sums) - 1
        for length in self._spans:
            if length > moves:
                break
            before = self._sums[moves - length]
            expected = newest[0] - before[0]
            if abs(expected) < _COMPARED.least * self._noise + least * length:
                continue
            share = 1.0 + (newest[1] - before[1]) / expected
            counts = (
                earned
                or share >= FOLLOWS[0]
                or (length == self._spans[-1] and share <= NOTHING)
            )
            if counts and not share >= self.share:
                self.share = share
                self.length = length
                self.expected = expected

    def _weigh(self, movement: Movement, usual: float, share: float) -> None:
        """Weigh a movement, whose usual error is `usual` and lasts for several samples, against a share."""
        drive = movement.drive
        usual = math.hypot(usual, _COMPARED.error_share * movement.drive)
        most = 1.5 * abs(drive) + 3.0 * usual
        unexplained = min(max(movement.unexplained, -most), most)
        missing = unexplained + (1.0 - share) * drive
        ratio = (
            0.5
            * (missing**2 - unexplained**2)
            / usual**2
            * min(self._period / _COMPARED.errors_last, 1.0)
        )
        self.returned = max(self.returned + ratio, 0.0)


class Repeats:
    """Whether the sensor is frozen, judged from repeated readings."""

    def __init__(
        self, period: float, longest: float, noise: float, step: float = 0.0
    ) -> None:
        """`longest`: time for which a reading may be repeated, s; `noise` and `step`: those of a reading.

        Where steps are coarser than the noise, a healthy sensor repeats itself whenever the plant is at rest.
        At an end of its span it does so until the plant has moved far back from there.
        """
        self._noise = noise
        self._stated = step
        self._longest = 0  # most repeats of one reading so far
        self._most = max(3, round(longest / period))
        # share of readings that repeat the one before: of 300, of 30
        self._often = self._lately = 0.1
        self._change = 0.0  # mean change from reading to reading
        self._seen = 10  # readings; the first shares count as 10
        self._moves = 0  # changes
        # the change before, and by how much changes differ on average
        self._last = self._jitter = 0.0
        self._step = math.inf  # smallest change so far: that of a reading's last digit
        self.count = 0
        """How many times the newest reading has been repeated."""
        self.expected = 0.0
        """Movement expected since the first of them."""
        self._error = 0.0  # how far that movement may be wrong
        self._due = 0.0  # that movement as the equations have it
        self._missed = 0.0  # what the readings usually do beyond it, a sample
        self._inward = 0.0

    def push(
        self,
        change: float,
        movement: float,
        inward: float = 0.0,
        error: float = 0.0,
        *,
        earned: bool = True,
    ) -> None:
        """Take the newest change of the reading and, if it repeats the one before, the movement that was expected
        meanwhile, in the output's unit, with its usual `error`; this counts if the one who expected it has
        `earned` that.

        `inward`: 1 for a reading at the low end of the sensor's span, -1 at the high end, 0 between them.
        """
        self._inward = inward
        if change == 0.0:
            self.count += 1
            self.expected += self._shown(movement) if earned else 0.0
            self._due += movement
            self._error += error
            return
        if not self.stands:
            self._learn_miss(change)
            for repeats in (1.0,) * self.count + (0.0,):
                self._seen = min(self._seen + 1, 300)
                self._often += (repeats - self._often) / self._seen
                self._lately += (repeats - self._lately) / 30
                change_now = 0.0 if repeats else change
                self._change += (abs(change_now) - self._change) / 30
                self._jitter += (abs(change_now - self._last) - self._jitter) / 30
                self._last = change_now
            self._moves += 1
            self._step = min(self._step, abs(change))
            self._longest = max(self._longest, self.count)
        self.count = 0
        self.expected = 0.0
        self._error = 0.0
        self._due = 0.0

    def _learn_miss(self, change: float) -> None:
        """Learn from a change by how much the movement was missed that was expected while the reading stood."""
        if self.count == 0:
            return
        share = 1.0 - (1.0 - 1.0 / _REPEATS.missed) ** self.count
        missed = (change - self._due) / self.count
        self._missed += share * (missed - self._missed)

    def _shown(self, movement: float) -> float:
        """What is left of an expected movement without what was surely missed of such ones before the reading stood.

        The drive of a plant may have become weak, or its losses larger: then all of its rest looks like a movement.
        What is missed by less than the noise of a reading may be that noise: the mean is of some thirty samples.
        """
        surely_missed = max(0.0, abs(self._missed) - self._noise)
        if movement * self._missed >= 0.0:
            return movement
        return math.copysign(max(0.0, abs(movement) - surely_missed), movement)

    @property
    def _coarse(self) -> bool:
        """Whether the readings' steps, as the file says or as they have shown, are coarser than the noise."""
        shown = self._step if self._moves >= _REPEATS.least_moves else 0.0
        return max(self._stated, shown) > self._noise

    @property
    def unusual(self) -> bool:
        """Whether the newest reading has been repeated so often that nothing else can be judged from it."""
        moved = not self._coarse or abs(self.expected) > _REPEATS.coarsely * self._noise
        return self.count >= 3 and moved

    @property
    def stands(self) -> bool:
        """Whether the repeated readings show a frozen sensor."""
        if self.count + 1 < self._most:
            return False
        if self._inward:
            return self.expected * self._inward > _REPEATS.moved * self._noise
        if abs(self.expected) > _REPEATS.moved * self._noise + self._error:
            return True
        chance = max(self._often, self._lately, 0.02) ** self.count
        return self._lacks_noise and chance < _REPEATS.chance

    @property
    def _lacks_noise(self) -> bool:
        """Whether the reading has shown noise, and now repeats itself more often than it ever has."""
        if (
            self._moves < _REPEATS.least_moves
            or self._change < _REPEATS.least_noise * self._noise
        ):
            return False
        if self._coarse or self._jitter < _REPEATS.steps * self._step:
            # its noise is smaller than its last digit: it repeats whenever the plant is at rest
            return False
        return self.count >= _REPEATS.longer * self._longest


class Lag:
    """Lag of the readings behind the plant."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._size = round((_SPANS[-1] + _LAG.most + _LAG.sum) / period) + 2
        self._sum = max(1, round(_LAG.sum / period))
        self.restart()

    def restart(self) -> None:
        """Forget what was pushed."""
        # The observed and the expected effect of the drive, sample by sample.
        self._past: deque[tuple[float, float]] = deque(maxlen=self._size)

    def push(self, movement: Movement) -> None:
        """Take the movement of one period."""
        self._past.append((movement.unexplained + movement.drive, movement.drive))

    def seconds(self, length: int) -> float | None:
        """The lag that explains the newest `length` readings, s; None unless it does so far better than no
        lag and than a drive without effect."""
        most = round(_LAG.most / self._period)
        size = max(length, self._sum)
        if len(self._past) < most + size + self._sum:
            return None
        movements, drive = np.array(self._past).T
        kernel = np.ones(self._sum)
        movements = np.convolve(movements, kernel, "valid")[-size:]
        drive = np.convolve(drive, kernel, "valid")[-size - most :]
        squares_left = []
        for lag in range(most + 1):
            lagging = drive[most - lag : drive.size - lag]
            squares_left.append(float(np.sum((movements - lagging) ** 2)))
        best = int(np.argmin(squares_left))
        left_by_dead_drive = float(np.sum(movements**2))
        if not _LAG.least / self._period <= best < most:
            return None
        if squares_left[best] > _LAG.far_better * min(
            squares_left[0], left_by_dead_drive
        ):
            return None
        return best * self._period
