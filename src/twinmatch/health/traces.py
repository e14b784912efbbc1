"""The traces that faults leave, each looked for on its own.

Sizes are counted in units of the output's noise, rates in that per second.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from twinmatch.health.balance import Movement

__all__ = ["Effect", "Lag", "Repeats"]

_SPANS: Final = (6.0, 8.0, 10.0, 12.0, 16.0, 20.0)
"""Lengths of the stretches over which the drive's effect is asked for, s."""
_LEAST_EFFECT: Final = 15.0
"""Movement the drive must have been expected to make: what a healthy camera jumps by …"""
_LEAST_RATE: Final = 4.5
"""… and this for every second: twice what a twin is off by for minutes …"""
_ROUGHNESS: Final = 2.0
"""… or, with a twin that is off by more, so many times the roughness of the balance."""
_STEP: Final = 8.0
"""An unexplained step larger than this is the sensor's own if none like it came before."""
_LIKE: Final = 4.0
"""Unexplained movement in the same direction that makes a step belong to a movement."""
_FOLLOWS: Final = (0.6, 2.5)
"""Shares of the expected effect that prove the drive to work."""

_CHANCE: Final = 1e-9
"""Probability below which repeated readings are no chance; a year has 3e7 seconds."""
_LEAST_NOISE: Final = 0.1
"""Mean change from reading to reading below which a sensor may stand still for good."""
_LEAST_MOVES: Final = 30
"""Changes of the reading from which it is known how often it repeats itself."""
_COARSELY: Final = 8.0
"""Movement of the plant that a sensor of coarse steps should have shown, lest its repetition be unusual."""
_STEPS: Final = 3.0
"""Changes have to differ by so many of the smallest, on average, for a reading to show noise."""
_MOVED: Final = 30.0
"""Movement of the plant that a standing sensor should have shown."""

_LONGEST_LAG: Final = 7.0
"""Longest lag that is tried, s; a shorter one has to be best, or it could be a dead drive as well."""
_LEAST_LAG: Final = 2.0
"""A reading this late is late, s."""
_LAG_SUM: Final = 4.0
"""Movements are compared in sums over this time, so that noise does not count, s."""
_FAR_BETTER: Final = 0.3
"""Share of the squared error that is left by an explanation far better than another."""


class Effect:
    """Whether the drive acts on the plant."""

    def __init__(self, period: float, noise: float) -> None:
        """`period` in s, `noise` of a reading."""
        self._period, self._noise = period, noise
        self._spans = [max(2, round(s / period)) for s in _SPANS]
        self.restart()

    def restart(self) -> None:
        """Forget what was pushed."""
        self._sums: deque[tuple[float, float]] = deque([(0.0, 0.0)], maxlen=self._spans[-1] + 1)
        self._last = 0.0
        self.share = math.nan
        """Least share of the expected effect seen in a stretch that expects enough; NaN if none does."""
        self.length = 0
        """Samples of that stretch."""
        self.expected = 0.0
        """Movement expected in it of the drive alone."""

    @property
    def follows(self) -> bool:
        """Whether the newest stretches prove the drive to work."""
        return _FOLLOWS[0] <= self.share <= _FOLLOWS[1]

    def push(self, movement: Movement, roughness: float) -> None:
        """Take the movement of one period, and the roughness (per second) of the balance it comes from."""
        least = max(_LEAST_RATE * self._noise, _ROUGHNESS * roughness) * self._period
        left = movement.unexplained
        like = abs(self._last) > _LIKE * self._noise and left * self._last > 0
        lonely = abs(left) > _STEP * self._noise and not like
        self._last = left
        drive, rest = self._sums[-1]
        self._sums.append((drive + movement.drive, rest + (0.0 if lonely else left)))
        self.share = math.nan
        newest, known = self._sums[-1], len(self._sums) - 1
        for length in self._spans:
            if length > known:
                break
            then = self._sums[known - length]
            expected = newest[0] - then[0]
            if abs(expected) < _LEAST_EFFECT * self._noise + least * length:
                continue
            share = 1.0 + (newest[1] - then[1]) / expected
            if not share >= self.share:
                self.share, self.length, self.expected = share, length, expected


class Repeats:
    """Whether the sensor stands still."""

    def __init__(self, period: float, longest: float, noise: float, step: float = 0.0) -> None:
        """`longest` is the time that a reading may be repeated, s; `noise` and `step` are those of a reading.

        Where steps are coarser than the noise, a sensor stands still whenever the plant does.
        """
        self._noise = noise
        self._coarse = step > noise
        self._most = max(3, round(longest / period))
        self._often = self._lately = 0.1  # share of readings that repeat the one before: of 300, of 30
        self._change = 0.0  # mean change from reading to reading
        self._seen, self._moves = 10, 0  # readings and changes of them, the first as good as so many
        self._last = self._jitter = 0.0  # the change before, and by how much changes differ on average
        self._step = math.inf  # smallest change so far: that of a reading's last digit
        self.count = 0
        """How often the newest reading has been repeated."""
        self.expected = 0.0
        """Movement expected meanwhile."""

    def push(self, change: float, movement: Movement) -> None:
        """Take the newest change of the reading and the movement it belongs to."""
        if change == 0.0:
            self.count += 1
            self.expected += movement.drive + movement.passive
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
        self.count, self.expected = 0, 0.0

    @property
    def unusual(self) -> bool:
        """Whether the newest reading has been repeated so often that nothing else can be judged by it."""
        moved = not self._coarse or abs(self.expected) > _COARSELY * self._noise
        return self.count >= 3 and moved

    @property
    def stands(self) -> bool:
        """Whether the sensor is frozen."""
        if self.count + 1 < self._most:
            return False
        chance = max(self._often, self._lately, 0.02) ** self.count
        noisy = self._moves >= _LEAST_MOVES and self._change >= _LEAST_NOISE * self._noise
        # A reading whose noise is lost in its last digit stands still whenever the plant does.
        noisy = noisy and not self._coarse and self._jitter >= _STEPS * self._step
        return abs(self.expected) > _MOVED * self._noise or (noisy and chance < _CHANCE)


class Lag:
    """How late the readings come."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._size = round((_SPANS[-1] + _LONGEST_LAG + _LAG_SUM) / period) + 2
        self._sum = max(1, round(_LAG_SUM / period))
        self.restart()

    def restart(self) -> None:
        """Forget what was pushed."""
        self._past: deque[tuple[float, float]] = deque(maxlen=self._size)  # what drive did, what it should

    def push(self, movement: Movement) -> None:
        """Take the movement of one period."""
        self._past.append((movement.unexplained + movement.drive, movement.drive))

    def seconds(self, length: int) -> float | None:
        """The lag that explains the newest `length` readings, if one does far better than none and than a
        drive without effect."""
        most = round(_LONGEST_LAG / self._period)
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
        if not _LEAST_LAG / self._period <= best < most or late[best] > _FAR_BETTER * min(late[0], dead):
            return None
        return best * self._period
