"""Checks of the numbers and texts in a plant file."""

from __future__ import annotations

import math
from typing import Any

from twinmatch.dynamics.errors import PlantError

__all__ = ["require_number", "require_range", "require_text"]


def require_number(what: str, value: Any, *, above: float = -math.inf) -> None:
    """Check that a value is a finite number above `above`.

    Raises:
        PlantError: it is none.
    """
    if not _is_number(value) or not above < value < math.inf:
        least = f" above {above:g}" if above > -math.inf else ""
        msg = f"plant: {what} is {value!r}; give a finite number{least}"
        raise PlantError(msg)


def require_range(what: str, ends: Any, *, finite: bool = True) -> None:
    """Check that a value is a pair of numbers, the smaller one first; without `finite`, ±inf are allowed.

    Raises:
        PlantError: it is none.
    """
    if isinstance(ends, tuple | list) and len(ends) == 2 and all(map(_is_number, ends)):
        low, high = ends
        if low < high and (not finite or (math.isfinite(low) and math.isfinite(high))):
            return
    kind = "two finite numbers" if finite else "two numbers"
    msg = f"plant: {what} is {ends!r}; give {kind}, the smaller first, such as (0.0, 100.0)"
    raise PlantError(msg)


def require_text(what: str, value: Any) -> None:
    """Check that a value is one line of text.

    Raises:
        PlantError: it is none.
    """
    if not isinstance(value, str) or "\n" in value:
        raise PlantError(f"plant: {what} is {value!r}; give a short text in quotes")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
