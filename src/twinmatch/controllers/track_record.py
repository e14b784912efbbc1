"""The track record of predictions: what was predicted of a law, and what was measured when it ran.

Predicted costs that lay in their bands leave the next ones as they are. Otherwise the bands become so wide
that nine in ten of the kept comparisons would have been inside: the conformal quantile of how far each was
off, in half widths of its band (Lei et al. 2018, doi:10.1080/01621459.2017.1307116).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from twinmatch.controllers.answer import (
    CONFIDENCE,
    ControllerAnswer,
    ControllerDecision,
    Courses,
)
from twinmatch.controllers.responses import LOAD
from twinmatch.signals import FloatArray

COST: Final = "mean squared error"
"""Name of the figure that is compared."""
MIN_COMPARISONS: Final = 3
"""Comparisons from which on a record says something."""
_NORMAL: Final = 1.645
"""Half width of a normal distribution's band of nine in ten, standard deviations."""
_HELD: Final = 2.0
"""Largest error of a loop that is stable, in steps of its set-points."""


@dataclass(frozen=True)
class LawComparison:
    """What was predicted of a law over one session, beside what was measured there."""

    session: str
    """Digest of the session in which it ran."""
    name: str
    plant: str
    rig: str
    """Which of several plants of this kind; empty if not named."""
    law: str
    """Name of the law's file."""
    learned: str
    """Names of the sessions from which it was predicted."""
    signal: str
    """Output of which this is the cost, or all."""
    unit: str
    low: float
    """Lower end of the predicted cost's band."""
    median: float
    high: float
    measured: float
    """The measured cost, less the noise of the readings."""
    share: float
    """Share of the readings in their bands."""
    decision: str
    """The answer, as a word."""
    stable: bool
    """Whether the measured loop was stable."""
    error: float
    """Largest measured distance from a set-point, over all outputs."""
    predicted_error: float
    """Median of the predicted one."""

    @property
    def off(self) -> float:
        """Distance of the measured cost from the predicted one, in half widths of its band on that side."""
        width = (
            self.high - self.median
            if self.measured > self.median
            else self.median - self.low
        )
        distance = abs(self.measured - self.median)
        if width > 0:
            return distance / width
        return math.inf if distance > 0 else 0.0

    @property
    def inside(self) -> bool:
        """Whether the measured cost lies in its band."""
        return self.low <= self.measured <= self.high

    @property
    def as_said(self) -> bool | None:
        """Whether it was stable if called safe, and unstable if it was to fail; None: it was undecided."""
        if self.decision == ControllerDecision.UNDECIDED.value:
            return None
        return self.stable == (self.decision == ControllerDecision.SAFE.value)


def compared(
    answer: ControllerAnswer, readings: FloatArray, seen: FloatArray, noise: FloatArray
) -> dict[str, Any]:
    """The measured part of a comparison, by its names in `LawComparison`.

    Args:
        answer: that of the law over the set-points of the session in which it ran.
        readings: shape (N, o).
        seen: whether each sample was recorded, shape (N,).
        noise: standard deviations of the readings, shape (o,).
    """
    is_seen = seen.astype(bool)
    recorded = readings[is_seen]
    errors = recorded - answer.references[is_seen]
    costs = [
        (figure, spread)
        for figure, spread in answer.courses.figures.items()
        if figure.name == COST
    ]
    cost, spread = costs[-1]  # that of all outputs follows those of each
    columns = [
        j
        for j, name in enumerate(answer.plant.outputs)
        if cost.signal in {name, "all outputs"}
    ]
    of_noise = noise[columns] ** 2
    measured = float(np.sum(np.mean(errors[:, columns] ** 2, axis=0) - of_noise))
    predicted = answer.courses.outputs[:, is_seen]
    predicted_errors = predicted[1] - answer.references[is_seen]
    return {
        "signal": cost.signal,
        "unit": cost.unit,
        **spread._asdict(),
        "measured": max(measured, 0.0),
        "share": _share_in_bands(recorded, predicted, noise),
        "stable": _was_stable(answer, recorded, errors),
        "error": float(np.abs(errors).max()),
        "predicted_error": float(np.abs(predicted_errors).max()),
        "decision": answer.decision.value,
    }


def _share_in_bands(
    recorded: FloatArray, predicted: FloatArray, noise: FloatArray
) -> float:
    """Share of readings, shape (N, o), within low, median and high of the outputs, shape (3, N, o), widened
    by their noise."""
    low, median, high = predicted
    room = _NORMAL * noise
    below = np.hypot(low - median, room)
    above = np.hypot(high - median, room)
    return float(np.mean((recorded >= median - below) & (recorded <= median + above)))


def _was_stable(
    answer: ControllerAnswer, recorded: FloatArray, errors: FloatArray
) -> bool:
    """Whether readings stayed where it is safe and, in the last third, near the set-points; both (N, o)."""
    outputs = answer.plant.outputs.values()
    steps = np.abs(np.diff(answer.references, axis=0)).max(axis=0, initial=0.0)
    spans = np.array([np.ptp(output.set_points or output.span) for output in outputs])
    largest = np.max([steps, np.abs(errors[0]), LOAD * spans], axis=0)
    last_errors = np.abs(errors[-(len(errors) // 3) :])
    safe_low, safe_high = np.array([output.safe for output in outputs]).T
    is_safe = (recorded > safe_low) & (recorded < safe_high)
    return bool(is_safe.all() and (last_errors <= _HELD * largest).all())


def widening_of(comparisons: Iterable[LawComparison]) -> tuple[float, int]:
    """The factor on the half widths of predicted costs that these comparisons show to be needed, 1 or more;
    and on how many of them it rests: those with a finite band, of laws that were not to fail."""
    not_to_fail = [
        c for c in comparisons if c.decision != ControllerDecision.FAILS.value
    ]
    distances = sorted(c.off for c in not_to_fail if math.isfinite(c.off))
    number = len(distances)
    if number < MIN_COMPARISONS:
        return 1.0, number
    rank = min(math.ceil(CONFIDENCE * (number + 1)), number)
    return max(distances[rank - 1], 1.0), number


def widened(
    answer: ControllerAnswer, comparisons: Iterable[LawComparison]
) -> ControllerAnswer:
    """The answer with bands of its costs as wide as the track record asks for, and a note that says so."""
    factor, number = widening_of(comparisons)
    if factor == 1.0:
        return answer
    note = (
        f"the bands of the {COST}s are {factor:.2g} times as wide as the recordings alone would have them: "
        f"of {number} sessions in which laws ran, nine in ten had theirs within {factor:.2g} half widths"
    )
    running = None if answer.running is None else _wider(answer.running, factor)
    courses = _wider(answer.courses, factor)
    return replace(
        answer,
        courses=courses,
        running=running,
        widening=factor,
        notes=(*answer.notes, note),
    )


def _wider(courses: Courses, factor: float) -> Courses:
    """The courses of a law with the bands of its costs widened by a factor."""
    figures = {
        figure: spread.widened(factor) if figure.name == COST else spread
        for figure, spread in courses.figures.items()
    }
    return replace(courses, figures=figures)
