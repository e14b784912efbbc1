"""Triggers for a plant whose loop is not known: where its input excites it.

There is no set-point, so steps of the input start the regimes. One rule has to serve two kinds of input: a
step test, with a constant input for minutes between two levels, and a controller that switches the drive on
and off all the time.

A movement of the input by `min_input_step` or more begins a regime. As with set-points, it is judged when the
next movement ends it, provided that it began and ended with a constant input (`min_span` samples without a
movement), so that the window holds two levels; or else `span` samples after it began. Movements in between
belong to it. A driven twin needs no steady levels, and every sample still kept is informative, so the window
reaches back as far as `capacity` allows. If possible it begins `lead` samples before a movement out of a
constant input, where the plant is at rest, too, and the twin can start from equilibrium. An input that is
never constant gives the newest `capacity` samples.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from twinmatch.signals import Sample, Window
from twinmatch.twin.schedule import Schedule, ScheduleSettings, Trigger

__all__ = ["InputSchedule"]


class InputSchedule(Schedule):
    """A schedule by the steps of the input; operating points are the outputs at the windows' ends."""

    def __init__(
        self, settings: ScheduleSettings | None = None, period: float = 1.0, width: float = 10.0
    ) -> None:
        """Begin without samples.

        Args:
            settings: how many samples make a window, and the least movement of the input.
            period: sample time, s.
            width: width of a regime, in the output's unit: operating points are rounded to a power of ten of
                at most a tenth of it.
        """
        super().__init__(settings, period)
        self._decimals = -math.floor(math.log10(width / 10))

    def _restart(self, sample: Sample) -> None:
        super()._restart(sample)
        self._newest = sample.index  # newest movement
        self._from_rest = False  # whether the regime began out of rest
        # Movements out of rest; the start of the record counts as one.
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
        return "the input moved; the window is not full yet" if waits else "the input did not move"

    def _point(self, window: Window) -> float:
        newest = window.output[-self.settings.min_span :]
        return round(float(np.mean(newest)), self._decimals) + 0.0  # avoids an operating point of minus zero

    def _begin(self, oldest: int) -> int:
        lead = self.settings.lead
        while self._rested and self._rested[0] - lead < oldest:
            self._rested.popleft()
        return self._rested[0] - lead if self._rested else oldest
