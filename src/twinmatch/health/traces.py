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

_SPANS: Final = (6.0, 8.0, 10.0, 12.0, 16.0, 20.0)
"""Lengths of the stretches over which the drive's effect is estimated, s."""
_MIN_EFFECT: Final = 15.0
"""Least movement expected from the drive: the size of a healthy camera's jumps …"""
_MIN_RATE: Final = 4.5
"""… plus this for every second: twice the error of a twin over minutes …"""
_ROUGHNESS: Final = 2.0
"""… or, with a less accurate twin, so many times the roughness of the balance."""
_ROUGH_RATE: Final = 1.0
"""Least usual error of a balance, in noises per second …"""
_ERROR_SHARE: Final = 0.25
"""… and as a share of what the drive does …"""
_ERRORS_LAST: Final = 10.0
"""… and time for which it lasts, s: errors of a twin are alike for some seconds."""
_STEP: Final = 8.0
"""A larger unexplained step is attributed to the sensor unless one like it came just before."""
_LIKE: Final = 4.0
"""Unexplained movement in the same direction just before that makes a step part of a movement."""
FOLLOWS: Final = (0.6, 2.5)
"""Range of shares of the expected effect that prove that the drive works."""

_LONGER: Final = 2.0
"""Factor by which a reading must be repeated more often than any before it: repeats come in runs."""
_CHANCE: Final = 1e-9
"""Probability below which repeated readings are not chance; a year has 3e7 seconds."""
_MIN_NOISE: Final = 0.1
"""Mean change from reading to reading below which a healthy sensor may repeat itself indefinitely."""
_MIN_MOVES: Final = 30
"""Changes of the reading needed to know how often it repeats."""
_COARSELY: Final = 8.0
"""Movement of the plant above which even a sensor with coarse steps should not repeat its reading."""
_STEPS: Final = 3.0
"""A reading shows noise if its changes differ, on average, by so many of the smallest change."""
_MOVED: Final = 30.0
"""Movement of the plant above which a sensor that repeats its reading is frozen."""

_MAX_LAG: Final = 7.0
"""Longest lag tried, s; the best one must be shorter, or it could as well be a dead drive."""
_MIN_LAG: Final = 2.0
"""Least lag that is reported, s."""
_LAG_SUM: Final = 4.0
"""Movements are compared in sums over this time, to suppress noise, s."""
_FAR_BETTER: Final = 0.3
"""Share of the squared error that a far better explanation may leave."""


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
        """Log-likelihood ratio of the whole effect to the share reported, nats, since it was least."""
        self._sums: deque[tuple[float, float]] = deque([(0.0, 0.0)], maxlen=self._spans[-1] + 1)
        self._last = 0.0

    def push(self, movement: Movement, roughness: float, *, earned: bool) -> None:
        """Take the movement of one period, the roughness (per second) of the balance that it comes from, and
        whether that balance has predicted the plant."""
        least = max(_MIN_RATE * self._noise, _ROUGHNESS * roughness) * self._period
        left = movement.unexplained
        if self._accused is not None:
            usual = max(roughness, _ROUGH_RATE * self._noise) * self._period
            self._weigh(movement, usual, self._accused)
        like = abs(self._last) > _LIKE * self._noise and left * self._last > 0
        isolated = abs(left) > _STEP * self._noise and not like
        self._last = left
        drive, rest = self._sums[-1]
        self._sums.append((drive + movement.drive, rest + (0.0 if isolated else left)))
        self.share = math.nan
        newest = self._sums[-1]
        known = len(self._sums) - 1
        for length in self._spans:
            if length > known:
                break
            then = self._sums[known - length]
            expected = newest[0] - then[0]
            if abs(expected) < _MIN_EFFECT * self._noise + least * length:
                continue
            share = 1.0 + (newest[1] - then[1]) / expected
            counts = earned or share >= FOLLOWS[0] or (length == self._spans[-1] and share <= NOTHING)
            if counts and not share >= self.share:
                self.share = share
                self.length = length
                self.expected = expected

    def _weigh(self, movement: Movement, usual: float, share: float) -> None:
        """Weigh a movement, whose usual error is `usual` and lasts for several samples, against a share."""
        drive = movement.drive
        usual = math.hypot(usual, _ERROR_SHARE * movement.drive)
        most = 1.5 * abs(drive) + 3.0 * usual
        left = min(max(movement.unexplained, -most), most)
        missing = left + (1.0 - share) * drive
        ratio = 0.5 * (missing**2 - left**2) / usual**2 * min(self._period / _ERRORS_LAST, 1.0)
        self.returned = max(self.returned + ratio, 0.0)


class Repeats:
    """Whether the sensor is frozen, judged from repeated readings."""

    def __init__(self, period: float, longest: float, noise: float, step: float = 0.0) -> None:
        """`longest`: time for which a reading may be repeated, s; `noise` and `step`: those of a reading.

        Where steps are coarser than the noise, a healthy sensor repeats itself whenever the plant is at rest.
        At an end of its span it does so until the plant has moved far back from there.
        """
        self._noise = noise
        self._stated = step
        self._longest = 0  # most repeats of one reading so far
        self._most = max(3, round(longest / period))
        self._often = self._lately = 0.1  # share of readings that repeat the one before: of 300, of 30
        self._change = 0.0  # mean change from reading to reading
        self._seen = 10  # readings; the first shares count as 10
        self._moves = 0  # changes
        self._last = self._jitter = 0.0  # the change before, and by how much changes differ on average
        self._step = math.inf  # smallest change so far: that of a reading's last digit
        self.count = 0
        """How many times the newest reading has been repeated."""
        self.expected = 0.0
        """Movement expected since the first of them …"""
        self._error = 0.0  # … and how far it may be wrong
        self._inward = 0.0

    def push(
        self, change: float, movement: Movement, inward: float = 0.0, error: float = 0.0, *,
        earned: bool = True,
    ) -> None:  # fmt: skip
        """Take the newest change of the reading and the movement it belongs to, with its usual `error`; this
        counts if the one who expected it has `earned` that.

        `inward`: 1 for a reading at the low end of the sensor's span, -1 at the high end, 0 between them.
        """
        self._inward = inward
        if change == 0.0:
            self.count += 1
            self.expected += (movement.drive + movement.passive) if earned else 0.0
            self._error += error
            return
        if not self.stands:
            for repeats in (1.0,) * self.count + (0.0,):
                self._seen = min(self._seen + 1, 300)
                self._often += (repeats - self._often) / self._seen
                self._lately += (repeats - self._lately) / 30
                now = 0.0 if repeats else change
                self._change += (abs(now) - self._change) / 30
                self._jitter += (abs(now - self._last) - self._jitter) / 30
                self._last = now
            self._moves += 1
            self._step = min(self._step, abs(change))
            self._longest = max(self._longest, self.count)
        self.count = 0
        self.expected = 0.0
        self._error = 0.0

    @property
    def _coarse(self) -> bool:
        """Whether the readings' steps, as the file says or as they have shown, are coarser than the noise."""
        shown = self._step if self._moves >= _MIN_MOVES else 0.0
        return max(self._stated, shown) > self._noise

    @property
    def unusual(self) -> bool:
        """Whether the newest reading has been repeated so often that nothing else can be judged from it."""
        moved = not self._coarse or abs(self.expected) > _COARSELY * self._noise
        return self.count >= 3 and moved

    @property
    def stands(self) -> bool:
        """Whether the repeated readings show a frozen sensor."""
        if self.count + 1 < self._most:
            return False
        if self._inward:
            return self.expected * self._inward > _MOVED * self._noise
        chance = max(self._often, self._lately, 0.02) ** self.count
        noisy = self._moves >= _MIN_MOVES and self._change >= _MIN_NOISE * self._noise
        # A reading whose noise is smaller than its last digit repeats whenever the plant is at rest.
        noisy = noisy and not self._coarse and self._jitter >= _STEPS * self._step
        noisy = noisy and self.count >= _LONGER * self._longest
        return abs(self.expected) > _MOVED * self._noise + self._error or (noisy and chance < _CHANCE)


class Lag:
    """Lag of the readings behind the plant."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._size = round((_SPANS[-1] + _MAX_LAG + _LAG_SUM) / period) + 2
        self._sum = max(1, round(_LAG_SUM / period))
        self.restart()

    def restart(self) -> None:
        """Forget what was pushed."""
        self._past: deque[tuple[float, float]] = deque(
            maxlen=self._size
        )  # observed and expected effect of the drive

    def push(self, movement: Movement) -> None:
        """Take the movement of one period."""
        self._past.append((movement.unexplained + movement.drive, movement.drive))

    def seconds(self, length: int) -> float | None:
        """The lag that explains the newest `length` readings, s; None unless it does so far better than no
        lag and than a drive without effect."""
        most = round(_MAX_LAG / self._period)
        size = max(length, self._sum)
        if len(self._past) < most + size + self._sum:
            return None
        seen, drive = np.array(self._past).T
        kernel = np.ones(self._sum)
        seen = np.convolve(seen, kernel, "valid")[-size:]
        drive = np.convolve(drive, kernel, "valid")[-size - most :]
        late = [float(np.sum((seen - drive[most - n : drive.size - n]) ** 2)) for n in range(most + 1)]
        best = int(np.argmin(late))
        dead = float(np.sum(seen**2))
        if not _MIN_LAG / self._period <= best < most or late[best] > _FAR_BETTER * min(late[0], dead):
            return None
        return best * self._period
