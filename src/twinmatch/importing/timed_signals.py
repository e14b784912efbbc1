"""A signal as messages tell it: values with times of their own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twinmatch.importing.resampling import bridged_up_to, held_means, usual_step
from twinmatch.sessions.files import RecordingError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

__all__ = ["Hole", "Loss", "TimedSignal", "rising_signal"]


class Periodic(Rule):
    """Which signals are periodic: those with enough messages, nine of ten of which come in regular steps."""

    fewest_messages: int = 10
    """Fewest messages that can be called periodic."""
    regular_share: float = 0.9
    """Least share of regular steps."""
    longest_regular: float = 1.5
    """Longest step that counts as regular, in usual steps."""


_PERIODIC: Final = Periodic()


class Loss(NamedTuple):
    """Messages that are not used."""

    messages: int
    why: str


class Hole(NamedTuple):
    """Where the messages of a signal stay away, s."""

    begin: float
    end: float


class TimedSignal(NamedTuple):
    """Values that apply from their times on."""

    times: FloatArray
    """s, increasing, shape (N,)."""
    values: FloatArray
    """Shape (N,)."""

    def interpolated(self, times: FloatArray) -> FloatArray:
        """The values at these times, linear in between."""
        return np.interp(times, self.times, self.values)

    @property
    def is_whole(self) -> bool:
        """Whether all values are whole numbers, as those of a state, a counter or a power of ten are."""
        return bool((self.values == np.round(self.values)).all())

    def held(self, times: FloatArray) -> FloatArray:
        """The last value at or before each of these times; before the first value, that one."""
        return self.values[
            np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)
        ]

    def newest(self, times: FloatArray) -> FloatArray:
        """The last value at or before each of these times; none of them may be before the first value."""
        return self.values[np.searchsorted(self.times, times, side="right") - 1]

    def means(self, times: FloatArray, longest: float | None) -> FloatArray:
        """Means from each of these times to the next; before a gap and at the end, over a median step.

        `longest` is the longest step that counts as covered, s; that of `bridged_up_to` if not given.
        """
        steps = np.diff(times)
        median_step = float(np.median(steps))
        ends = np.append(times[1:], times[-1] + median_step)
        before_gaps = np.flatnonzero(steps > bridged_up_to(times, longest))
        ends[before_gaps] = times[before_gaps] + median_step
        return held_means(self.times, self.values, times, ends, ends - times)

    def holes(self, reading_times: FloatArray, longest: float | None) -> Iterator[Hole]:
        """Where messages stay away longer than is bridged: from one usual step after a message to the next.

        A signal that is not periodic has none: it is published when it changes, and applies until then.
        `reading_times` are those of the readings, s; `longest` is as in `means`.
        """
        steps = np.diff(self.times)
        if self.times.size < _PERIODIC.fewest_messages or not self._is_periodic(
            steps, reading_times
        ):
            return
        usual = max(usual_step(steps), usual_step(np.diff(reading_times)))
        limit = bridged_up_to(np.array([0.0, usual]), longest)
        until_next = np.append(steps, reading_times[-1] - self.times[-1])
        next_times = np.append(self.times[1:], math.inf)
        for k in np.flatnonzero(until_next > limit).tolist():
            yield Hole(float(self.times[k]) + usual, float(next_times[k]))

    def _is_periodic(self, steps: FloatArray, reading_times: FloatArray) -> bool:
        longest_regular = max(
            _PERIODIC.longest_regular * usual_step(steps), bridged_up_to(reading_times)
        )
        return bool(np.quantile(steps, _PERIODIC.regular_share) <= longest_regular)


def rising_signal(
    path: Path, name: str, times: FloatArray, values: FloatArray
) -> tuple[TimedSignal, list[Loss]]:
    """The numbers of messages with rising times, and how many messages gave none, by reason.

    Messages are sorted by time, since some arrive out of order; of several at one time the last is kept.

    Raises:
        RecordingError: no message has a number.
    """
    is_number = np.isfinite(values)
    if not is_number.any():
        raise RecordingError(
            f"{path}: no message of {name} has a number; map another field"
        )
    order = np.argsort(times[is_number], kind="stable")
    sorted_times = times[is_number][order]
    sorted_values = values[is_number][order]
    is_last = np.append(np.diff(sorted_times) > 0, True)
    losses = [
        Loss(int((~is_number).sum()), "without a number"),
        Loss(int((~is_last).sum()), "at a time of another"),
    ]
    signal = TimedSignal(sorted_times[is_last], sorted_values[is_last])
    return signal, [loss for loss in losses if loss.messages]
