"""Readings that run away: they move for seconds, and farther than their plant can.

A sensor that slips off its body, or whose amplifier fails, shows such a movement. As it comes in many small steps, each
reading is about where the one before was, so "no equations at all" explains it as well as anything.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray


class _Running(Rule):
    """From when on a reading has run away, and when it is back; times in s of a plant as fast as the rig."""

    lasts: float = 10.0
    """Time over which its movement is looked at."""
    farther: float = 2.5
    """Times as far as the equations have the plant move at most, as losses may become larger."""
    unseen: float = 2.0
    """Times as far as the reading has ever moved in that time."""
    noises: float = 8.0
    """Standard deviations of a reading that it moves at least: an offset is reported from there on."""
    at_once: float = 0.5
    """Share of the movement from which on it is a jump, if it comes within three samples."""
    late: float = 30.0
    """Time after which a movement counts as one that the reading is known to make: by then it is known whether it
    ran away."""
    returns: float = 30.0
    """Time within which one that is back has come back: a plant that cools down to where a lying sensor stands needs
    longer."""
    bands: float = 2.0
    """Bands of its estimate that a reading may be off when it is back."""
    off: float = 2.0
    """Times its tolerance that it was off before it came back."""
    left: float = 0.2
    """Share of how far it was off shortly before that may be left when it has come back: an estimate errs by a share
    of how far the plant has gone since, and bands are those of a plant that was held."""


RUNNING: Final = _Running()


class ReadingMovement(NamedTuple):
    """By how much a reading has moved lately, in its unit."""

    size: float
    is_beyond_known: bool
    """Whether it is far more than noise, no jump, and far more than the reading has been known to make."""


class NewestMovement:
    """The newest movement of one reading, and those that it is known to make."""

    _SAMPLES_AT_ONCE: Final = 3

    def __init__(self, second: float) -> None:
        """Begin with no movement; `second`: samples in a second of a plant as fast as the rig."""
        self._late = max(1, round(RUNNING.late * second))
        self._samples = max(2 * self._SAMPLES_AT_ONCE, round(RUNNING.lasts * second))
        self._farthest_fall = 0.0
        self._farthest_rise = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin again after a gap, keeping what is known."""
        self._readings = deque[float](maxlen=self._samples + 1)
        self._waiting = deque[float]()

    def take(self, value: float, noise: float, *, counts: bool) -> ReadingMovement:
        """Take a reading with the standard deviation of its noise, and whether it counts."""
        if not counts:
            self.restart()
            return ReadingMovement(0.0, is_beyond_known=False)
        self._readings.append(value)
        moved = value - self._readings[0]
        is_whole = len(self._readings) > self._samples
        is_far = is_whole and abs(moved) > RUNNING.noises * noise
        is_jump = is_far and self._comes_at_once(moved)
        self._waiting.append(0.0 if is_jump else moved)
        if len(self._waiting) > self._late:
            self._know(self._waiting.popleft())
        known = self._farthest_rise if moved > 0.0 else self._farthest_fall
        is_beyond_known = is_far and not is_jump and abs(moved) > RUNNING.unseen * known
        return ReadingMovement(moved, is_beyond_known)

    def _comes_at_once(self, moved: float) -> bool:
        values = np.array(self._readings)
        steps = values[self._SAMPLES_AT_ONCE :] - values[: -self._SAMPLES_AT_ONCE]
        return bool(np.abs(steps).max() >= RUNNING.at_once * abs(moved))

    def _know(self, moved: float) -> None:
        self._farthest_rise = max(self._farthest_rise, moved)
        self._farthest_fall = max(self._farthest_fall, -moved)


class Runaways:
    """Which readings of a plant run away."""

    def __init__(
        self,
        outputs: int,
        second: float,
        farthest_movements: Callable[[], tuple[FloatArray, FloatArray]],
    ) -> None:
        """Begin with none.

        Args:
            outputs: number of readings in a sample.
            second: samples in a second of a plant as fast as the rig.
            farthest_movements: by how much the plant lets each output fall and rise at most in the time over which
                movements are looked at, shape (o,) each; asked where a reading moves as it never has.
        """
        self.lasts = round(RUNNING.lasts * second)
        """Samples over which a movement is looked at."""
        self.moved = np.zeros(outputs)
        """By how much each reading has moved lately, in its unit."""
        self._movements = [NewestMovement(second) for _ in range(outputs)]
        self._samples = np.zeros(outputs, dtype=np.int64)
        """For how many samples in a row each reading has run away."""
        self._farthest_movements = farthest_movements

    def restart(self) -> None:
        """Begin again after a gap, keeping what is known."""
        for movement in self._movements:
            movement.restart()

    def take(self, values: FloatArray, counts: BoolArray, noise: FloatArray) -> None:
        """Take the readings of a sample, which of them count, and the standard deviations of their noise, shape (o,)
        each."""
        for output, newest in enumerate(self._movements):
            movement = newest.take(
                float(values[output]), float(noise[output]), counts=bool(counts[output])
            )
            self.moved[output] = movement.size
            if movement.is_beyond_known and self._is_beyond_plant(output, noise):
                self._samples[output] += 1
            else:
                self._samples[output] = 0

    def _is_beyond_plant(self, output: int, noise: FloatArray) -> bool:
        """Whether the plant cannot move an output as far as its reading has moved."""
        falls, rises = self._farthest_movements()
        farthest = float(falls[output]), float(rises[output])
        return runs_away(float(self.moved[output]), farthest, float(noise[output]))

    def lasting(self, samples: int, among: BoolArray) -> list[int]:
        """Those of some outputs, shape (o,), whose readings run away; none before one of them has done so for so many
        samples."""
        samples_of_those = np.where(among, self._samples, 0)
        if samples_of_those.max(initial=0) < samples:
            return []
        return [int(output) for output in np.flatnonzero(samples_of_those)]


class WayBack:
    """Whether a reading that ran away is back where it should be."""

    def __init__(self, second: float) -> None:
        """Begin while it is away; `second`: samples in a second of a plant as fast as the rig."""
        self._returns = max(1, round(RUNNING.returns * second))
        self._stays = max(1, round(RUNNING.lasts * second))
        self._newest_off = deque[float](maxlen=self._returns)
        self._readings_near: list[float] = []
        """Those since it has not been off."""
        self._samples_of_share = 0
        """For how many samples only a small share has been left of how far it was off."""

    def take(
        self, reading: float, expected: float, tolerance: float, least: float
    ) -> bool:
        """Take a reading and its estimate, how far it may be off from that, and how far noise takes it, all in its
        unit; whether it is back.

        It was far off shortly before, and has not been off since for a while, or by a small share of that only. Or
        it has not been off for longer, and has gone farther meanwhile than one does that stands where the plant
        happens to be.
        """
        off = abs(reading - expected)
        self._newest_off.append(off)
        farthest = max(self._newest_off)
        self._readings_near.append(reading)
        if off > tolerance:
            self._readings_near = []
        is_share = off <= RUNNING.left * farthest
        self._samples_of_share = self._samples_of_share + 1 if is_share else 0
        return (
            self._has_come_near(farthest, tolerance)
            or self._has_come(farthest, least)
            or self._has_followed(tolerance)
        )

    def _has_come_near(self, farthest: float, tolerance: float) -> bool:
        is_near = len(self._readings_near) >= self._stays
        return is_near and farthest > RUNNING.off * tolerance

    def _has_come(self, farthest: float, least: float) -> bool:
        stays = self._samples_of_share >= self._stays
        return stays and farthest > RUNNING.off * least

    def _has_followed(self, tolerance: float) -> bool:
        if len(self._readings_near) < self._returns:
            return False
        gone = max(self._readings_near) - min(self._readings_near)
        return gone > 2.0 * RUNNING.off * tolerance


def runs_away(moved: float, farthest: tuple[float, float], noise: float) -> bool:
    """Whether a movement is farther than a plant makes that falls and rises by `farthest` at most; `noise` is the
    standard deviation of a reading, all in its unit."""
    fall, rise = farthest
    possible = rise if moved > 0.0 else -fall
    return abs(moved) > RUNNING.farther * max(possible, 0.0) + RUNNING.noises * noise
