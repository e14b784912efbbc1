"""Faults that the recorded signals show by themselves, before any model is asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.signals import Window

__all__ = ["fault_in_signals"]

_COLDEST, _HOTTEST = -60.0, 250.0
"""Temperatures that neither this plate nor its camera can have, °C."""
_FROZEN_SAMPLES = 10
"""Identical readings in a row that no working camera gives; in seven hours of the rig at most 5."""
_FROZEN_PWM = 7.0
"""PWM that must have varied meanwhile (standard deviation): the control's ordinary noise."""
_AGAINST_SAMPLES = 15
"""Length of a saturated stretch in which the plate must have followed its sense."""
_AGAINST_CHANGE = 2.0
"""Change of temperature against the sense of the saturated control, °C: twenty times the noise."""


def fault_in_signals(window: Window, limit: float) -> str | None:
    """One sentence on an impossible or frozen temperature or on a plate that moves against a saturated
    control; None if there is nothing of the kind.

    `limit` is the magnitude of the saturated PWM.
    """
    impossible = np.flatnonzero((window.output < _COLDEST) | (window.output > _HOTTEST))
    if impossible.size:
        k = int(impossible[0])
        return (
            f"the temperature was {window.output[k]:g} °C at sample {window.first + k}, "
            "which no plate can be: look at the camera"
        )
    for first, last in _stretches(np.diff(window.output) == 0.0):
        if last - first + 1 >= _FROZEN_SAMPLES and np.std(window.input[first : last + 1]) > _FROZEN_PWM:
            return (
                f"the temperature stood still at {window.output[first]:g} °C from sample "
                f"{window.first + first} to {window.first + last} while the control moved: look at the camera"
            )
    saturated = np.abs(window.input) >= limit
    for first, last in _stretches(saturated[1:] & saturated[:-1] & (np.diff(window.input) == 0.0)):
        change = float(window.output[last] - window.output[first])
        against = -change * np.sign(window.input[first])
        if last - first + 1 >= _AGAINST_SAMPLES and against > _AGAINST_CHANGE:
            return (
                f"the control was saturated at {window.input[first]:+.0f} from sample {window.first + first} "
                f"to {window.first + last} while the plate went {change:+.1f} °C: look at the drive"
            )
    return None


def _stretches(joined: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last sample of each run in which every sample is joined to the next."""
    edges = np.diff(np.concatenate([[False], joined, [False]]).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))
