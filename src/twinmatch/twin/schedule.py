"""The schedule: takes samples, returns triggers for judging a window.

A trigger depends on the samples alone, never on the time of day or on how fast they arrive, so a
replayed session triggers exactly where the live one did. There are two kinds:

* **excited**: the window may determine parameters. A movement begins a regime, and the regime is judged when
  the next movement ends it, provided that both came after a rest of `min_span` samples (in a loop: that it
  has lasted for so long), or `span` samples after it began; earlier if there are many samples and they
  determine the parameters already.
* **quiet**: `stride` samples without such a window. It holds just those, and shows the twin's residual.

What counts is how far the output is expected to move: by the set-point where the loop is known, otherwise by
the inputs, through the plant's equations. A movement is one by `min_step`, or a lesser one that has lasted:
the sum of squares determines a gain, and many small movements say as much as a large one. Where the samples
show that the inputs move the output far more than the defaults in those equations say, the samples count.

In a loop that is known, the twin starts from rest, so the window begins `lead` samples before the regime
before: it holds two levels and the transition between them. A driven twin needs no levels, and every sample
is informative: the window reaches as far back as `capacity` allows. If possible it begins before a movement
out of a rest, so that the twin can start from equilibrium, too.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing.models import LEAD
from twinmatch.dynamics import Plant
from twinmatch.dynamics.movement import ExpectedMovement, InputEffect
from twinmatch.dynamics.pace import plant_scale
from twinmatch.errors import TwinmatchError
from twinmatch.fitting.excitation import unexpected_movement
from twinmatch.settings import setting
from twinmatch.signals import (
    FloatArray,
    OperatingPoint,
    Sample,
    Signals,
    Window,
    point_of,
)

_LEAVING: Final = 0.1
"""Share of a least movement from which the output counts as on its way."""
_ENOUGH: Final = 240
"""Samples after which a window that determines the parameters is judged before `span`. With fewer, a twin
that lacks something fits what is left."""


class ScheduleError(TwinmatchError):
    """Settings that do not make a schedule."""


@dataclass(frozen=True)
class ScheduleSettings:
    """When windows are judged and how long they are; times are in samples.

    The defaults are for 100 samples in a time constant; `of` is for any plant.
    """

    scale: float = setting(
        1.0, "Factor on the defaults of all times and horizons below.", "", 0.05, 100.0
    )
    """Those follow the plant's time constant; what is given itself is not multiplied."""
    stride: int = setting(
        60, "Samples between two checks while nothing changes.", "samples", 4, 10000
    )
    min_step: float = setting(
        2.0, "Smallest movement that starts a regime.", "{y}", 1e-6, 1e6
    )
    """Where the loop is not known, of the output as the inputs are expected to move it. Of several outputs of
    the first; of the others in proportion to the noise."""
    min_span: int = setting(
        60, "A shorter regime is merged with the next one.", "samples", 10, 10000
    )
    span: int = setting(
        240, "A regime is judged this long after its step.", "samples", 20, 10000
    )
    """Or at its end, if that comes before."""
    lead: int = setting(
        LEAD, "Samples kept before the previous regime's step.", "samples", 1, 1000
    )
    """The steady state from which the window starts."""
    capacity: int = setting(720, "Longest window.", "samples", 40, 100000)
    gap: int = setting(
        5, "Most samples lost in a row that windows reach across.", "samples", 0, 1000
    )
    """Choose less than a tenth of the plant's main time constant."""

    @classmethod
    def of(
        cls, plant: type[Plant], period: float, scale: float = 1.0
    ) -> ScheduleSettings:
        """Settings for a plant and a sample time, s: with 33 to 100 samples in a time constant as many as
        for the rig, otherwise in proportion, within the bounds of `plant_scale`."""
        pace = plant_scale(plant, period) / period
        factor = max(pace, min(3.0 * pace, 1.0)) * scale
        counts = {}
        for declared in fields(cls):
            if declared.metadata["unit"] == "samples":
                count = round(getattr(cls, declared.name) * factor)
                at_least = max(count, declared.metadata["low"])
                counts[declared.name] = min(at_least, declared.metadata["high"])
        first_output = next(iter(plant.outputs.values()))
        return cls(scale, min_step=first_output.least_step, **counts)

    def __post_init__(self) -> None:
        for name in ("stride", "min_span", "span", "lead", "capacity"):
            if getattr(self, name) < 1:
                msg = f"schedule: {name} is {getattr(self, name)}; it must be at least 1 sample"
                raise ScheduleError(msg)
        if self.gap < 0:
            raise ScheduleError(f"schedule: gap is {self.gap}; it must not be negative")
        if not self.min_step > 0:
            raise ScheduleError(
                f"schedule: min_step is {self.min_step}; it must be positive"
            )
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
    operating_point: OperatingPoint
    """Set-points at the window's end, or the outputs where the loop is not known; in the outputs' units."""
    reason: str = ""
    """Why it is not excited, in a sentence."""


class _Reach:
    """Whether movements have come far enough, or have lasted; in units of the least movement."""

    def __init__(self, index: int, lasting: int) -> None:
        """Begin at rest at a sample; `lasting` is the sum of squares from which lesser movements count."""
        self._lasting = lasting
        self._moving = 0.0
        self._away = index

    def push(self, index: int, far: float) -> int | None:
        """Take how far the output is away at a sample; return the index of the first sample of the movement
        that counts now, if any."""
        if far < _LEAVING:
            self._away = index + 1
        self._moving += far * far
        if far < 1.0 and self._moving < self._lasting:
            return None
        return min(self._away, index)


class Movements:
    """Movements of the expected outputs, or of the set-points.

    Each is found as soon as it is far enough or, if it is a lesser one, has lasted.
    """

    def __init__(
        self,
        settings: ScheduleSettings,
        effect: InputEffect | None,
        units: Signals = (1.0,),
    ) -> None:
        """Begin without samples.

        Args:
            settings: the least movement, and how long a lesser one has to last.
            effect: what the inputs do to the outputs; None: the set-points count.
            units: those of the outputs, in that of the first: so much larger is the least step of each.
        """
        self._least = settings.min_step * np.array(units)
        self._lasting = settings.min_span
        self._expected = None if effect is None else ExpectedMovement(effect)

    def rest(self, sample: Sample) -> None:
        """Count from this sample."""
        self._anchor = sample.references
        self._reach = _Reach(sample.index, self._lasting)
        if self._expected is not None:
            self._expected.rest()
            self._expected.take(np.array(sample.inputs))

    def push(self, sample: Sample) -> int | None:
        """Take a sample; return the index of the first one of the movement that counts now, if any."""
        far = 0.0
        if self._expected is not None:
            far = float(
                np.max(
                    np.abs(self._expected.take(np.array(sample.inputs))) / self._least
                )
            )
        elif sample.references != self._anchor:
            far = float(
                np.max(
                    np.abs(np.subtract(sample.references, self._anchor)) / self._least
                )
            )
        began = self._reach.push(sample.index, far)
        if began is not None:
            self.rest(sample)
        return began


class Schedule:
    """Keeps the newest samples and triggers when a window is due."""

    def __init__(
        self,
        settings: ScheduleSettings | None = None,
        period: float = 1.0,
        effect: InputEffect | None = None,
        width: float = 10.0,
        *,
        units: Signals = (1.0,),
        undetermined: Callable[[Window], str] = lambda _: "",
        unmoved: Callable[[Window], str] = lambda _: "the input did not move",
        unexpected: Callable[[Window, InputEffect], FloatArray] = unexpected_movement,
    ) -> None:
        """Begin without samples.

        Args:
            settings: how many samples make a window, and the least movement.
            period: sample time, s.
            effect: what the inputs do to the outputs; None: the set-points count, the loop being known.
            width: width of a regime, in the output's unit: where the loop is not known, operating points are
                rounded to a power of ten of at most a tenth of it.
            units: those of the outputs, in that of the first, in which least step and width are given.
            undetermined: says in words what a window does not determine yet; empty if nothing is left.
            unmoved: says in words why a quiet window of a loop that is not known is one.
            unexpected: gives the movement in a window, shape (N, o), of which `effect` expects far less.
        """
        self.settings = settings or ScheduleSettings()
        self._least = self.settings.min_step * np.array(units)
        self._unmoved = unmoved
        self._unexpected = unexpected
        self.period = period
        self._movements = Movements(self.settings, effect, units)
        self._effect = effect
        self._driven = effect is not None
        self._decimals = [-math.floor(math.log10(width * unit / 10)) for unit in units]
        self._undetermined = undetermined
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
        moved = self._movements.push(sample)
        trigger = None if moved is None else self._on_movement(sample, moved)
        self._samples.append(sample)
        if (
            self._effect is not None
            and trigger is None
            and self._is_due(sample)
            and not self._waits
        ):
            shown = self._movement_shown(sample, self._effect)
            if shown is not None:
                self._on_movement(sample, shown)
        return trigger or self._on_count(sample)

    def _is_due(self, sample: Sample) -> bool:
        """Whether the plant is to be judged even if nothing has moved."""
        return sample.index - self._judged_to >= self.settings.stride

    def _movement_shown(self, sample: Sample, effect: InputEffect) -> int | None:
        """The first sample of a movement since the newest excited window that the samples show although the
        inputs' expected effect is far less, if any."""
        window = self._window(sample.index - self.settings.capacity + 1, sample.index)
        movement = self._unexpected(window, effect)
        began = max(self._quiet_since, window.first)
        since = movement[began - window.first :]
        reach = _Reach(began, self.settings.min_span)
        far_at = np.max(np.abs(since - since[0]) / self._least, axis=1)
        for index, far in enumerate(far_at.tolist(), start=began):
            first = reach.push(index, far)
            if first is not None:
                return first
        return None

    def _restart(self, sample: Sample) -> None:
        self._regime_step: int | None = None
        """The first sample of the regime; None before the first movement."""
        self._regime_start = sample.index
        """The same, but no sample of an earlier excited window."""
        self._previous_step = sample.index
        """The first sample of the regime before."""
        self._newest_movement = sample.index
        """The first sample of the newest movement; not each begins a regime."""
        self._judged = False
        """Whether the regime is judged."""
        self._from_rest = False
        """Whether it began out of rest."""
        self._judged_to = sample.index - 1
        """Last sample of the newest trigger's window."""
        self._quiet_since = sample.index
        """The first sample behind the newest excited window."""
        self._movements_from_rest: deque[int] = deque(
            [sample.index + self.settings.lead]
        )
        """First samples of movements out of rest; the start of the record counts as one."""
        self._movements.rest(sample)

    def _on_movement(self, sample: Sample, began: int) -> Trigger | None:
        """The trigger for the regime that a movement ends, if that is to be judged; the next one begins."""
        is_from_rest = began - self._newest_movement >= self.settings.min_span
        is_steady = is_from_rest and self._from_rest
        if not self._driven:  # a controller holds what it follows: time is enough
            is_steady = began - self._regime_start >= self.settings.min_span
        regime_start = max(began, self._judged_to + 1)
        trigger = (
            self._excited(sample.index, regime_start - 1)
            if is_steady and self._waits
            else None
        )
        if is_from_rest:
            self._movements_from_rest.append(began)
        self._newest_movement = began
        # else it is one of the regime that waits
        begins_regime = trigger is not None or not self._waits
        if begins_regime:
            if self._regime_step is not None:
                self._previous_step = self._regime_step
            self._regime_step = began
            self._regime_start = regime_start
            self._judged = False
            self._from_rest = is_from_rest
        return trigger

    @property
    def _waits(self) -> bool:
        """Whether a regime has begun that is not judged yet."""
        return self._regime_step is not None and not self._judged

    def _on_count(self, sample: Sample) -> Trigger | None:
        """The trigger that is due because enough samples have come, if any."""
        settings = self.settings
        is_due = self._is_due(sample)
        missing = ""
        if self._waits:
            lasted = sample.index - self._regime_start
            is_full = lasted >= settings.span
            if is_due and not is_full:
                missing = self._undetermined(
                    self._window(self._begin(sample.index), sample.index)
                )
                is_full = not missing and lasted >= _ENOUGH
            if is_full:
                self._judged = True
                return self._excited(sample.index, sample.index)
            missing = f"the window is not full yet{missing and ': '}{missing}"
        if not is_due:
            return None
        window = self._window(self._judged_to + 1, sample.index)
        self._judged_to = sample.index
        if not self._waits:
            missing = (
                self._unmoved(window) if self._driven else "the set-point did not move"
            )
        return Trigger(
            sample.index,
            window,
            excited=False,
            operating_point=self._point(window),
            reason=missing,
        )

    def _point(self, window: Window) -> OperatingPoint:
        """The operating point at a window's end."""
        if not self._driven:
            return point_of(window.references[-1])
        newest = window.outputs[-self.settings.min_span :].T
        rounded = [
            round(float(np.mean(y)), decimals)
            for y, decimals in zip(newest, self._decimals, strict=True)
        ]
        # which makes minus zero zero
        return point_of([level + 0.0 for level in rounded])

    def _begin(self, last: int) -> int:
        """First sample of an excited window that ends with `last`."""
        oldest = last - self.settings.capacity + 1
        lead = self.settings.lead
        if not self._driven:
            return max(self._previous_step - lead, oldest)
        while (
            self._movements_from_rest and self._movements_from_rest[0] - lead < oldest
        ):
            self._movements_from_rest.popleft()
        return (
            self._movements_from_rest[0] - lead if self._movements_from_rest else oldest
        )

    def _excited(self, index: int, last: int) -> Trigger:
        """The trigger at sample `index` for the excited window that ends with `last`."""
        window = self._window(self._begin(last), last)
        self._judged_to = last
        self._quiet_since = last + 1
        return Trigger(index, window, excited=True, operating_point=self._point(window))

    def _window(self, first: int, last: int) -> Window:
        return Window.from_samples(
            [s for s in self._samples if first <= s.index <= last], self.period
        )
