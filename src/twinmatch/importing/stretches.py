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
"""Usual steps by which a clock that is set back goes at least; by less, messages are out of order."""


class PlacedTimes(NamedTuple):
    """The messages of a channel, in the order of recording."""

    places: FloatArray
    """Place of each among the messages of the bag, shape (N,)."""
    times: FloatArray
    """s, shape (N,)."""

    def steps_back(self, least_step: float) -> Iterator[_StepBack]:
        """Where the clock was set back: two messages in a row are earlier than the one before them, by far.

        Far is some usual steps of the channel, each of `least_step`, s, at least.
        """
        if self.times.size < 3:
            return
        allowed = _BACK * max(usual_step(np.diff(self.times)), least_step)
        earliest = self.times[:-2] - allowed
        both_before = (self.times[1:-1] < earliest) & (self.times[2:] < earliest)
        for k in np.flatnonzero(both_before).tolist():
            yield _StepBack(float(self.places[k]), float(self.places[k + 1]))


class _StepBack(NamedTuple):
    """Places between which a clock was set back."""

    after: float
    until: float


class Stretches(NamedTuple):
    """Where stretches lie once they are put one after another; each array has one value for each stretch."""

    places: FloatArray
    """Place in the bag of its first message."""
    begins: FloatArray
    """Time at which it begins there, s."""
    shifts: FloatArray
    """Difference between a time there and the same time by the clock, s."""

    @classmethod
    def of(cls, channels: Sequence[PlacedTimes], usual: float) -> Stretches:
        """Find them in the messages of all channels; `usual` is the usual step of the readings, s.

        A clock that is set back shows in each channel between two of its messages. The clock is taken to have
        been set back as rarely as explains the steps back of all channels.
        """
        steps_back = (
            step for channel in channels for step in channel.steps_back(usual)
        )
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
        """The times of a channel's messages once the stretches are put one after another."""
        return np.asarray(
            channel.times + self.shifts[_stretch_of(self.places, channel.places)]
        )

    def taken_back(self, times: FloatArray) -> FloatArray:
        """The times by the clock that belong to times given by `put`."""
        return np.asarray(times - self.shifts[_stretch_of(self.begins, times)])


def _fewest_moments(steps_back: Iterable[_StepBack]) -> list[float]:
    """Places of the first messages after the clock was set back, increasing: each step back has one inside.

    Of steps that overlap, the one that ends first decides, so that one moment explains as many as possible.
    """
    moments = [-math.inf]
    for step in sorted(steps_back, key=lambda step: step.until):
        if moments[-1] <= step.after:
            moments.append(step.until)
    return moments[1:]


def _stretch_of(starts: FloatArray, values: FloatArray) -> np.ndarray:
    """Numbers of the stretches in which these places or times lie, by those at which stretches start."""
    return np.searchsorted(starts, values, side="right") - 1
