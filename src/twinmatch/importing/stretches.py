"""The stretches of a bag between the moments at which its clock was set back, put one after another."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from twinmatch.importing.resampling import usual_step
from twinmatch.signals import FloatArray

__all__ = ["APART", "PlacedTimes", "Stretches"]

APART: Final = 1e7
"""Time between two stretches while they are put one after another, s; no hole is half as long."""
_BACK: Final = 3.0
"""Steps back in time by so many usual steps are those of a clock; shorter ones are messages out of order."""


class PlacedTimes(NamedTuple):
    """The messages of a channel, in the order of recording."""

    places: FloatArray
    """Place of each among the messages of the bag, shape (N,)."""
    times: FloatArray
    """s, shape (N,)."""

    def steps_back(self, usual: float) -> Iterator[_StepBack]:
        """Where two messages in a row are far before the one before, by the usual step (s) at least."""
        if self.times.size < 3:
            return
        allowed = _BACK * max(usual_step(np.diff(self.times)), usual)
        earliest = self.times[:-2] - allowed
        both_before = (self.times[1:-1] < earliest) & (self.times[2:] < earliest)
        for k in np.flatnonzero(both_before).tolist():
            yield _StepBack(float(self.places[k]), float(self.places[k + 1]))


class _StepBack(NamedTuple):
    """Places between which a clock was set back."""

    after: float
    until: float


class Stretches(NamedTuple):
    """What adds to the times of each stretch, so that it follows the one before."""

    places: FloatArray
    """Place of the first message of each."""
    begins: FloatArray
    """Time at which each begins, once it is put, s."""
    shifts: FloatArray
    """What that adds to its times, s."""

    @classmethod
    def of(cls, channels: Sequence[PlacedTimes], usual: float) -> Stretches:
        """Find them in the messages of all channels; `usual` is the usual step of the readings, s.

        A clock that is set back shows in each channel between two of its messages. As few moments are taken
        as explain all of them.
        """
        steps_back = (step for channel in channels for step in channel.steps_back(usual))
        places = np.array([-math.inf, *_fewest_moments(steps_back)])
        all_places = np.concatenate([channel.places for channel in channels])
        all_times = np.concatenate([channel.times for channel in channels])
        stretch_of_message = _stretch_of(places, all_places)
        shifts = [0.0]
        begins = [-math.inf]
        for stretch in range(1, len(places)):
            last_before = float(all_times[stretch_of_message == stretch - 1].max())
            first = float(all_times[stretch_of_message == stretch].min())
            begins.append(last_before + shifts[-1] + APART)
            shifts.append(begins[-1] - first)
        return cls(places, np.array(begins), np.array(shifts))

    def put(self, channel: PlacedTimes) -> FloatArray:
        """The times of a channel's messages where their stretches are put."""
        return np.asarray(channel.times + self.shifts[_stretch_of(self.places, channel.places)])

    def taken_back(self, times: FloatArray) -> FloatArray:
        """The times of the clock, of times in stretches that are put one after another."""
        return np.asarray(times - self.shifts[_stretch_of(self.begins, times)])


def _fewest_moments(steps_back: Iterable[_StepBack]) -> list[float]:
    """Places at which the clock was set back, increasing: each step back has one of them inside."""
    moments = [-math.inf]
    for step in sorted(steps_back, key=lambda step: step.until):
        if moments[-1] <= step.after:
            moments.append(step.until)
    return moments[1:]


def _stretch_of(first: FloatArray, positions: FloatArray) -> np.ndarray:
    """Which stretch each of these is in, by what is first in each."""
    return np.searchsorted(first, positions, side="right") - 1
