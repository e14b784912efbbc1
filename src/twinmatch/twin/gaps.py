"""Short gaps in the samples, filled with stand-ins, which are marked as not seen."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twinmatch.dynamics import Law, commands_of
from twinmatch.signals import FloatArray, Sample, Window

_PAST: Final = 60
"""Samples from which the law's state is found: many, since a PID at a limit does not show its integral."""


class GapFiller:
    """Fills short gaps in a stream of samples; after a longer gap, or a clock set back, it starts over.

    The loop is taken to have continued: set-points, inputs and disturbances are held, and the outputs are
    interpolated, so that what sums up its movements stays right. Where the law of the loop is known, it
    computes the lost inputs. A set-point may have moved at each of the lost samples, at the next one, or in a
    ramp: the moment is taken whose input at that next sample is nearest to the recorded one.
    """

    def __init__(self, law: Law | None, longest: int) -> None:
        """Begin without samples; `law` is None if the loop is not known, and at most `longest` samples in a
        row are replaced."""
        self._law = law
        self._longest = longest
        self._past: deque[Sample] = deque(maxlen=_PAST)

    def restart(self) -> None:
        """Fill nothing before the next sample."""
        self._past.clear()

    def take(self, sample: Sample) -> list[Sample]:
        """The stand-ins for the samples lost before this one, if they are few enough, and this one, oldest
        first."""
        lost: list[Sample] = []
        if self._past and not sample.follows(self._past[-1]):
            lost = self._interpolate(self._past[-1], sample)
            if not lost:
                self._past.clear()
        if lost and self._law is not None and len(self._past) == _PAST:
            lost = _fill_by_law(self._law, list(self._past), lost, sample)
        self._past.extend((*lost, sample))
        return [*lost, sample]

    def _interpolate(self, before: Sample, after: Sample) -> list[Sample]:
        """Stand-ins for the samples between two, oldest first; none if too many or a clock set back."""
        steps = after.index - before.index
        is_continued = after.stamp > before.stamp and before.shape == after.shape
        if not (is_continued and 1 < steps <= self._longest + 1):
            return []
        ends = list(zip(before.outputs, after.outputs, strict=True))
        return [
            replace(
                before,
                index=before.index + k,
                stamp=before.stamp + (after.stamp - before.stamp) * k // steps,
                outputs=tuple(y + (y_after - y) * k / steps for y, y_after in ends),
                seen=False,
            )
            for k in range(1, steps)
        ]


def _fill_by_law(
    law: Law, past: Sequence[Sample], lost: list[Sample], after: Sample
) -> list[Sample]:
    """The stand-ins with the set-points and inputs of the loop: of the courses that they may have had, that
    under which the law comes nearest to the commands after them."""
    if after.shape[:3] != (law.n_references, law.n_outputs, law.n_inputs):
        return lost
    state = law.state(Window.from_samples(past, law.period))
    for sample in past[2:]:
        references = np.array(sample.references)
        outputs = np.array(sample.outputs)
        state = law.follow(state, references, outputs, np.array(sample.inputs))
    stand_ins = lost
    nearest = np.inf
    for references, outputs in _courses(past[-1], [*lost, after]):
        inputs, _ = commands_of(law.code, state, references, outputs)
        distance = float(np.linalg.norm(inputs[-1] - after.inputs))
        if distance <= nearest:
            nearest = distance
            stand_ins = _with_course(lost, references, outputs, inputs)
    return stand_ins


def _with_course(
    lost: Sequence[Sample],
    references: FloatArray,
    outputs: FloatArray,
    inputs: FloatArray,
) -> list[Sample]:
    """The lost samples with these set-points, outputs and inputs.

    Their last row is for the sample after the lost ones, and is not used.
    """
    samples = []
    for k, sample in enumerate(lost):
        samples.append(
            replace(
                sample,
                references=tuple(references[k].tolist()),
                outputs=tuple(outputs[k].tolist()),
                inputs=tuple(inputs[k].tolist()),
            )
        )
    return samples


def _courses(
    before: Sample, behind: Sequence[Sample]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Courses that the N samples `behind` one may have had: set-points, shape (N, r), and outputs, (N, p).

    First the set-point moves in a ramp, then it steps at each of the samples in turn. An output moves only
    after the step that moves it.
    """
    old = np.array(before.references)
    new = np.array(behind[-1].references)
    outputs = np.array([sample.outputs for sample in behind])
    last = len(behind)
    steps = np.arange(1.0, last + 1)
    yield old + (new - old) * (steps / last)[:, None], outputs
    if np.array_equal(old, new):
        return
    for first in range(1, last):
        share = np.clip((steps - first) / (last - first), 0.0, 1.0)[:, None]
        outputs_after_step = before.outputs + share * (outputs[-1] - before.outputs)
        yield np.where(steps[:, None] >= first, new, old), outputs_after_step
    yield np.where(steps[:, None] >= last, new, old), outputs
