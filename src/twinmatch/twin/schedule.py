"""The schedule: takes samples, returns triggers for judging a window.

A trigger depends on the samples alone, never on the time of day or on how fast they arrive, so a
replayed session triggers exactly where the live one did. There are two kinds:

* **excited**: a set-point regime (the stretch after a set-point step) has lasted long enough, or
  has just ended. The window reaches back over the regime before it, so that it holds two levels and
  the transition between them, which a match needs.
* **quiet**: nothing moved for `stride` samples. The window holds just those; it does not determine
  parameters, but shows the twin's residual.

Where the loop is not known, steps of the input take the place of the set-point's (`InputSchedule`).

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
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from twinmatch.comparing.models import LEAD
from twinmatch.dynamics import Plant
from twinmatch.dynamics.pace import plant_scale
from twinmatch.errors import TwinmatchError
from twinmatch.settings import setting
from twinmatch.signals import Sample, Window


class ScheduleError(TwinmatchError):
    """Settings that do not make a schedule."""


@dataclass(frozen=True)
class ScheduleSettings:
    """When windows are judged and how long they are; times are in samples.

    The defaults are for 100 samples in a time constant; `of` is for any plant.
    """

    scale: float = setting(1.0, "Factor on the defaults of all times and horizons below.", "", 0.05, 100.0)
    """Those follow the plant's time constant; what is given itself is not multiplied."""
    stride: int = setting(60, "Samples between two checks while nothing changes.", "samples", 4, 10000)
    min_step: float = setting(2.0, "Smallest set-point change that starts a regime.", "{y}", 1e-6, 1e6)
    min_input_step: float = setting(127.5, "Smallest input change that starts a regime.", "{u}", 1e-6, 1e6)
    """Used where the loop is not known."""
    min_span: int = setting(60, "A shorter regime is merged with the next one.", "samples", 10, 10000)
    span: int = setting(240, "A regime is judged this long after its step.", "samples", 20, 10000)
    """Or at its end, if that comes before."""
    lead: int = setting(LEAD, "Samples kept before the previous regime's step.", "samples", 1, 1000)
    """The steady state from which the window starts."""
    capacity: int = setting(720, "Longest window.", "samples", 40, 100000)
    gap: int = setting(5, "Most samples lost in a row that windows reach across.", "samples", 0, 1000)
    """Choose less than a tenth of the plant's main time constant."""

    @classmethod
    def of(cls, plant: type[Plant], period: float, scale: float = 1.0) -> ScheduleSettings:
        """Settings for a plant and a sample time, s: with 33 to 100 samples in a time constant as many as
        for the rig, otherwise in proportion, within the bounds of `plant_scale`."""
        pace = plant_scale(plant, period) / period
        factor = max(pace, min(3.0 * pace, 1.0)) * scale
        counts = {}
        for one in fields(cls):
            if one.metadata["unit"] == "samples":
                low, high = one.metadata["low"], one.metadata["high"]
                counts[one.name] = min(max(round(getattr(cls, one.name) * factor), low), high)
        y, u = plant.output, plant.drive
        return cls(scale, min_step=y.least_step, min_input_step=u.least_step, **counts)

    def __post_init__(self) -> None:
        for name in ("stride", "min_span", "span", "lead", "capacity"):
            if getattr(self, name) < 1:
                msg = f"schedule: {name} is {getattr(self, name)}; it must be at least 1 sample"
                raise ScheduleError(msg)
        if self.gap < 0:
            raise ScheduleError(f"schedule: gap is {self.gap}; it must not be negative")
        for name in ("min_step", "min_input_step"):
            if not getattr(self, name) > 0:
                msg = f"schedule: {name} is {getattr(self, name)}; it must be positive"
                raise ScheduleError(msg)
        if not self.min_span <= self.span < self.capacity:
            raise ScheduleError(
                f"schedule: min_span {self.min_span}, span {self.span} and capacity {self.capacity} samples; "
                "give them in increasing order"
            )


class Trigger(NamedTuple):
    """A window that is due to be judged."""

    sample: int
    """Index of the sample that triggered it."""
    window: Window
    excited: bool
    """Whether the window holds a step, so that parameters can be matched on it."""
    operating_point: float
    """Set-point at the window's end, or the output where the loop is not known; in the output's unit."""
    reason: str = ""
    """Why it is not excited, in a sentence."""


class Schedule:
    """Keeps the newest samples and triggers when a window is due."""

    def __init__(self, settings: ScheduleSettings | None = None, period: float = 1.0) -> None:
        """Begin without samples; `period` is the sample time in s."""
        self.settings = settings or ScheduleSettings()
        self.period = period
        self._samples: deque[Sample] = deque(maxlen=self.settings.capacity + 1)

    def push(self, sample: Sample) -> Trigger | None:
        """Take one sample; return its trigger, if any.

        A sample that does not follow the one before it (a gap, a clock set back) restarts the record: no
        window reaches across it.
        """
        if self._samples and not sample.follows(self._samples[-1]):
            self._samples.clear()
        if not self._samples:
            self._restart(sample)
        far = abs(self._moving(sample) - self._anchor) >= self._least
        trigger = self._on_step(sample) if far else None
        self._samples.append(sample)
        return trigger or self._on_count(sample)

    def _restart(self, sample: Sample) -> None:
        self._anchor = self._moving(sample)  # its value in this regime
        self._step: int | None = None  # index of the regime's first sample; None before the first step
        self._previous_step = sample.index
        self._judged = False
        self._judged_to = sample.index - 1  # last sample of the newest trigger's window

    def _moving(self, sample: Sample) -> float:
        """The signal whose steps begin regimes."""
        return sample.reference

    @property
    def _least(self) -> float:
        """The smallest of these steps."""
        return self.settings.min_step

    def _on_step(self, sample: Sample) -> Trigger | None:
        self._anchor = sample.reference
        if self._step is None:
            self._step = sample.index
            return None
        if not self._judged and sample.index - self._step < self.settings.min_span:
            return None
        trigger = None if self._judged else self._excited(sample.index, sample.index - 1)
        self._previous_step, self._step, self._judged = self._step, sample.index, False
        return trigger

    def _on_count(self, sample: Sample) -> Trigger | None:
        if self._step is not None and not self._judged and sample.index - self._step >= self.settings.span:
            self._judged = True
            return self._excited(sample.index, sample.index)
        if sample.index - self._judged_to >= self.settings.stride:
            window = self._window(self._judged_to + 1, sample.index)
            self._judged_to = sample.index
            return Trigger(sample.index, window, False, self._point(window), self._quiet())
        return None

    def _quiet(self) -> str:
        """Why the newest samples excite nothing."""
        return "the set-point did not move"

    def _point(self, window: Window) -> float:
        """The operating point at a window's end."""
        return float(window.reference[-1])

    def _begin(self, oldest: int) -> int:
        """First sample of an excited window that may reach back to `oldest`."""
        return max(self._previous_step - self.settings.lead, oldest)

    def _excited(self, index: int, last: int) -> Trigger:
        window = self._window(self._begin(last - self.settings.capacity + 1), last)
        self._judged_to = last
        return Trigger(index, window, True, self._point(window))

    def _window(self, first: int, last: int) -> Window:
        samples = [s for s in self._samples if first <= s.index <= last]
        return Window.from_samples(samples, self.period)


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
