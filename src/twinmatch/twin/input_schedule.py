"""When to look at a plant whose loop is not known: where its input excites it.

Nobody says there what the plant is to do, so that no step of a set-point can be waited for. Two kinds of
input have to be served by one rule: a step test, whose input stands still for minutes between two levels, and
a controller that switches the drive on and off all the time.

A movement of the input by `min_input_step` or more begins a regime. As with set-points, it is judged when the
next movement ends it, provided that it began and ended with an input at rest (`min_span` samples without a
movement), so that the window holds two levels; or else `span` samples after it began. What moves meanwhile
belongs to it. A driven twin needs no levels that a loop holds, and every sample that is still remembered
tells it something, so the window reaches back as far as `capacity` allows. It prefers to begin `lead` samples
before a movement out of rest, where the plant stood as still as its input: the twin starts there from rest.
An input that never rests gives the newest `capacity` samples.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from twinmatch.signals import Sample, Window
from twinmatch.twin.schedule import Schedule, ScheduleSettings, Trigger

__all__ = ["InputSchedule"]


class InputSchedule(Schedule):
    """A schedule by the steps of the input; operating points are what the output came to."""

    def __init__(
        self, settings: ScheduleSettings | None = None, period: float = 1.0, width: float = 10.0
    ) -> None:
        """Begin with no samples.

        Args:
            settings: how many samples make a window, and how far the input has to move.
            period: sample time, s.
            width: of a regime, in the output's unit: operating points are rounded to a power of ten that is a
                tenth of it or less.
        """
        super().__init__(settings, period)
        self._decimals = -math.floor(math.log10(width / 10))

    def _restart(self, sample: Sample) -> None:
        super()._restart(sample)
        self._newest = sample.index  # of the movements
        self._from_rest = False  # whether the regime began out of rest
        # Movements out of rest; the record begins as if after one.
        self._rested: deque[int] = deque([sample.index + self.settings.lead])

    def _moving(self, sample: Sample) -> float:
        return sample.input

    @property
    def _least(self) -> float:
        return self.settings.min_input_step

    def _on_step(self, sample: Sample) -> Trigger | None:
        rested = sample.index - self._newest >= self.settings.min_span
        waits = self._step is not None and not self._judged
        ends = rested and waits and self._from_rest
        trigger = self._excited(sample.index, sample.index - 1) if ends else None
        if rested:
            self._rested.append(sample.index)
        self._anchor, self._newest = sample.input, sample.index
        if trigger is not None or not waits:
            self._step, self._judged, self._from_rest = sample.index, False, rested
        return trigger

    def _quiet(self) -> str:
        waits = self._step is not None and not self._judged
        return "the input moved; its window is not full yet" if waits else "the input did not move"

    def _point(self, window: Window) -> float:
        newest = window.output[-self.settings.min_span :]
        return round(float(np.mean(newest)), self._decimals) + 0.0  # no operating point of minus zero

    def _begin(self, oldest: int) -> int:
        lead = self.settings.lead
        while self._rested and self._rested[0] - lead < oldest:
            self._rested.popleft()
        return self._rested[0] - lead if self._rested else oldest
