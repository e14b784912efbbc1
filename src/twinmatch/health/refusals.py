"""Which readings are refused: those that the plant cannot have, or cannot have reached since the last one."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters, PlantError
from twinmatch.health.settings import HealthSettings
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Sample, Signals


class _Implausible(Rule):
    """Which movements a plant cannot have made."""

    reach: float = 1.2
    """Factor by which drive and surroundings may move the plant further than the twin says. Where a large
    movement is expected, its absence is a drive fault, not an implausible reading."""
    guessed: float = 20.0
    """Factor by which the plant may move further than the defaults of a new plant file say, before there
    is a twin: so far may they be off."""
    sure: float = 6.0
    """A movement below `jump` by this factor is never implausible: what is missing of the expected
    movement is then within its reach."""
    late: int = 5
    """Samples by which the plant may answer later than the twin."""
    recurs: int = 3
    """Times that readings have continued from a refused step, from which on such steps are the plant's:
    a spike comes back, and a sensor that has shifted does so once."""
    like: float = 1.5
    """Times a usual movement up to which a step is like it."""


_IMPLAUSIBLE: Final = _Implausible()


GAP: Final = 3.0
"""Time between two samples that counts as a gap: so many seconds, and so many periods. Half the shortest
stretch over which the drive is judged, so that a late sample or two change nothing."""


def stamps_apart(before: Sample, after: Sample, period: float) -> bool:
    """Whether the stamps of two samples show a gap, also where the index continues.

    A process that was stopped, or a machine that slept, may continue the index where it was.
    """
    elapsed = (after.stamp - before.stamp) / 1e9
    return elapsed < 0 or elapsed > GAP * max(1.0, period) * max(
        after.index - before.index, 1
    )


class UsualSteps:
    """How far readings usually move in one sample, and how often a step of that size was refused."""

    def __init__(self) -> None:
        """Begin without any."""
        self._largest = [0.0] * _IMPLAUSIBLE.recurs
        """The largest movements in a sample between two readings that were taken, the largest last."""
        self._refused = 0

    @property
    def usual(self) -> float:
        """A movement that readings have made several times."""
        return self._largest[0]

    @property
    def recur(self) -> bool:
        """Whether steps that were refused are the plant's."""
        return self._refused >= _IMPLAUSIBLE.recurs

    def take(self, moved: float) -> None:
        """Take a movement between two readings that were taken."""
        if abs(moved) > self._largest[0]:
            self._largest = sorted([*self._largest[1:], abs(moved)])

    def refuse(self, moved: float, samples: int) -> None:
        """Take a movement from whose refused beginning the readings continue, over so many samples."""
        self._refused += self._is_like_usual(moved, samples)

    def include(self, moved: float, samples: int) -> bool:
        """Whether a movement over so many samples is one of those that recur."""
        return self.recur and self._is_like_usual(moved, samples)

    def _is_like_usual(self, moved: float, samples: int) -> bool:
        return abs(moved) <= samples * _IMPLAUSIBLE.like * self.usual


class Refusals:
    """Refuses implausible readings of one plant, sample by sample.

    A refused reading is replaced by what the twin expects there, for as many samples in a row as may be lost;
    further ones are not usable. After those, a reading is taken again if it agrees with the one before it,
    even at another level: then it is the sensor that has shifted.
    """

    def __init__(self, settings: HealthSettings, longest: int) -> None:
        """Begin without samples; at most `longest` in a row are replaced."""
        plant = settings.reference.model.plant
        self._spans = [output.readable for output in plant.outputs.values()]
        self._defaults = settings.reference
        self._twin = settings.reference if plant.typical else None
        self._period = settings.period
        self._longest = longest
        self._jump = settings.jump * max(1.0, settings.pace)
        # the newest accepted sample, and what was refused after it
        self._since: list[Sample] = []
        self._cut = False  # whether the first of these is not usable
        # inputs of accepted samples
        self._earlier: deque[float] = deque(maxlen=_IMPLAUSIBLE.late)
        self.steps = UsualSteps()

    @property
    def taught(self) -> bool:
        """Whether there is a twin by which movements are judged."""
        return self._twin is not None

    def know(self, parameters: Parameters) -> None:
        """Judge movements by this twin if the plant file declares no typical one."""
        self._twin = self._twin or parameters

    def settle(self, sample: Sample) -> Sample:
        """The sample, its reading replaced if it is refused."""
        if self._since and self._apart(self._since[-1], sample):
            self._since = []
            self._cut = False
            self._earlier.clear()
        if self._possible(sample) and not (
            self._since and self._is_refused_step(sample)
        ):
            if (
                len(self._since) == 1
                and sample.follows(self._since[0])
                and not self._cut
            ):
                self.steps.take(sample.outputs[0] - self._since[0].outputs[0])
            self._since = [sample]
            self._cut = False
            self._earlier.extend(sample.inputs[:1])
            return sample
        return self._refused(sample)

    def _apart(self, before: Sample, sample: Sample) -> bool:
        """Whether the samples before say nothing about this one."""
        steps = sample.index - before.index
        comparable = sample.shape == before.shape and 1 <= steps <= self._longest + 1
        return not comparable or stamps_apart(before, sample, self._period)

    def _possible(self, sample: Sample) -> bool:
        """Whether the plant can have these values."""
        for (low, high), y in zip(self._spans, sample.outputs, strict=False):
            if not low <= y <= high:
                return False
        commands = (*sample.references, *sample.inputs, *sample.disturbances)
        return all(map(math.isfinite, commands))

    def _is_refused_step(self, sample: Sample) -> bool:
        """Whether a reading is refused for where it has moved; counts those from which readings continue."""
        if not self._leaps(sample):
            return False
        before = self._since[0]
        moved = sample.output - before.output
        samples = sample.index - before.index
        is_second = len(self._since) == 2 and not self._cut
        if is_second and self._continues(sample):
            self.steps.refuse(moved, samples)
        return not self.steps.include(moved, samples)

    def _continues(self, sample: Sample) -> bool:
        """Whether a reading is on the side of the newest accepted one to which the refused one has moved."""
        before, last = self._since
        return (
            bool(last.refused)
            and (sample.output - before.output) * (last.refused[0] - before.output)
            > 0.0
        )

    def _leaps(self, sample: Sample) -> bool:
        """Whether the plant cannot have moved there since the newest accepted sample."""
        before = self._since[0]
        if len(sample.outputs) != 1 or len(sample.inputs) != 1:
            return False
        if self._cut and not self._possible(before):
            return False
        moved = sample.output - before.output
        if abs(moved) <= self._jump / _IMPLAUSIBLE.sure:
            return False
        inputs = [None, *self._earlier]  # the plant may answer later than the twin
        twin, reach = (
            (self._twin, _IMPLAUSIBLE.reach)
            if self._twin
            else (self._defaults, _IMPLAUSIBLE.guessed)
        )
        expected = (
            self._movement(twin, sample.index, earlier_input)
            for earlier_input in inputs
        )
        return all(
            abs(moved - movement) > max(self._jump, reach * size)
            for movement, size in expected
        )

    def _movement(
        self, twin: Parameters, index: int, constant_input: float | None = None
    ) -> tuple[float, float]:
        """Expected movement from the newest accepted sample to an index, and the sum of its parts' sizes;
        under a `constant_input`, if there is one."""
        model = twin.model
        steps = twin.steps(self._period)
        states: FloatArray = np.full(len(model.states), np.nan)
        y = self._since[0].output
        size = 0.0
        ends = [*(sample.index for sample in self._since), index]
        try:
            for sample, (begin, end) in zip(self._since, pairwise(ends), strict=True):
                row = model.disturbance_row(sample.disturbances or None)
                u = float(sample.input if constant_input is None else constant_input)
                for _ in range(end - begin):
                    drive, passive, states = model.kernels.parts(
                        twin.vector,
                        y,
                        states,
                        u,
                        float(model.plant.drive.rest),
                        row,
                        self._period,
                        steps,
                    )
                    y = y + drive + passive
                    size = size + abs(drive) + abs(passive)
        except PlantError:
            return 0.0, math.inf
        return (
            (y - self._since[0].output, size) if math.isfinite(y) else (0.0, math.inf)
        )

    def _refused(self, sample: Sample) -> Sample:
        """The sample with a stand-in for its reading, or marked as not usable."""
        cut = (
            self._cut
            or not self._since
            or sample.index - self._since[0].index > self._longest
        )
        before = self._since[-1] if self._since else None
        read = sample.outputs
        settled = replace(
            sample,
            references=_finite(sample.references, before.references if before else ()),
            outputs=self._nearest(read)
            if cut or before is None
            else self._expected(before, sample.index),
            inputs=_finite(sample.inputs, before.inputs if before else ()),
            disturbances=_finite(
                sample.disturbances, before.disturbances if before else ()
            ),
            seen=False,
            refused=read,
            usable=not cut,
        )
        if cut:  # the next reading is compared with this one
            self._since = [replace(settled, outputs=read)]
            self._cut = True
        else:
            self._since.append(settled)
        return settled

    def _expected(self, before: Sample, index: int) -> Signals:
        """The outputs that the twin expects at an index, or those of the sample before."""
        if self._twin is None or len(before.outputs) != 1 or len(before.inputs) != 1:
            return before.outputs
        moved, _ = self._movement(self._twin, index)
        return self._nearest((self._since[0].output + moved,))

    def _nearest(self, outputs: Signals) -> Signals:
        """The possible values nearest to these; in the middle of the span for what is not a number."""
        spans = [
            *self._spans,
            *[(-math.inf, math.inf)] * (len(outputs) - len(self._spans)),
        ]
        return tuple(
            sum(span) / 2 if math.isnan(y) else min(max(y, span[0]), span[1])
            for y, span in zip(outputs, spans, strict=False)
        )


def _finite(values: Signals, last_finite: Signals) -> Signals:
    """These values; for those that are not finite, the ones before."""
    last_finite = last_finite or (0.0,) * len(values)
    return tuple(
        v if math.isfinite(v) else before
        for v, before in zip(values, last_finite, strict=True)
    )
