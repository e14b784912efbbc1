"""What a law on trial is to do: bands for its readings while the set-points are held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from twinmatch.controllers.answer import (
    ControllerAnswer,
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    try_controller,
)
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.dynamics import Law
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

DRAWS: Final = 80
"""Draws of the parameters over all twins, so that an operator waits for two seconds."""


class _TrialBands(Rule):
    """The bands of a law on trial, wider than those of nine draws in ten: it is taken back for what hardly
    any sound law does. Outputs that still move under the law that runs would not be told from its effects."""

    factor: float = 1.5
    """Factor on the half widths."""
    noise: float = 8.0
    """What is added on both sides, in the outputs' noise: what a sensor does not resolve."""
    still: float = 10.0
    """How far outputs may still move before another law is tried, in their noise."""


_BANDS: Final = _TrialBands()


class TrialAnswer(NamedTuple):
    """Whether a law may be run now, and where its readings are to be if it is."""

    answer: ControllerAnswer
    low: FloatArray
    """Shape (N, o)."""
    high: FloatArray


def try_now(
    members: Sequence[TriedTwin], law: Law, holding: Holding, before: FloatArray
) -> TrialAnswer:
    """Try a law on twins as they are now, with the set-points held for as long as the plant takes to settle.

    The bands of a law that is safe are its own. One that is not is to do as well as the one that runs: its
    own bands would allow what makes it unsafe.

    Raises:
        ControllerError: there is no twin, the law that runs is not known, or the outputs have not settled.
        PlantError: the law is for another number of signals.
    """
    if holding.law is None:
        raise ControllerError(
            "controller: the law that runs is not known, so none could be given back"
        )
    references = np.tile(before, (holding.samples, 1))
    answer = try_controller(
        members, ControllerQuestion(law, references, before, holding, DRAWS)
    )
    noise = members[0].parameters.model.noise
    running = answer.running
    if (
        running is not None
        and (np.ptp(running.outputs[1], axis=0) > _BANDS.still * noise).any()
    ):
        raise ControllerError(
            "controller: the outputs have not settled yet; wait until they rest"
        )
    is_safe = answer.decision is ControllerDecision.SAFE
    courses = answer.courses if is_safe or running is None else running
    low, median, high = courses.outputs
    half = (
        _BANDS.factor * np.maximum(high - median, median - low) + _BANDS.noise * noise
    )
    return TrialAnswer(answer, median - half, median + half)
