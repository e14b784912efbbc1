"""The error of limits under which nothing is protected, and the checks they share."""

from __future__ import annotations

import math
from collections.abc import Mapping

from twinmatch.errors import TwinmatchError


class SafetyError(TwinmatchError):
    """Limits under which nothing is protected."""


def within_a_minute(place: str, **times: float) -> None:
    """Check that times, s, are positive and at most a minute.

    Raises:
        SafetyError: one is not.
    """
    for name, time in times.items():
        if not 0 < time <= 60:
            raise SafetyError(
                f"{place} limits: {name} is {time} s; it must be within 0 to 60 s"
            )


def positive(place: str, limits: Mapping[str, float]) -> None:
    """Check that limits, by name, are positive and finite.

    Raises:
        SafetyError: one is not.
    """
    for name, value in limits.items():
        if not (math.isfinite(value) and value > 0):
            raise SafetyError(f"{place} limits: {name} is {value}; it must be positive")
