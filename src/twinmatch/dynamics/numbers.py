"""Checks of the numbers in a plant file."""

from __future__ import annotations

import math
from typing import Any

from twinmatch.dynamics.errors import PlantError

__all__ = ["require_number", "require_range"]


def require_number(what: str, value: Any, *, above: float = -math.inf) -> None:
    """Check that a value is a finite number above `above`.

    Raises:
        PlantError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not above < value < math.inf:
        least = f" above {above:g}" if above > -math.inf else ""
        msg = f"plant: {what} is {value!r}; give a finite number{least}"
        raise PlantError(msg)


def require_range(what: str, ends: Any) -> None:
    """Check that a value is a pair of finite numbers, the smaller one first.

    Raises:
        PlantError: it is none.
    """
    numbers = isinstance(ends, tuple | list) and len(ends) == 2
    if numbers and all(isinstance(e, int | float) and math.isfinite(e) for e in ends) and ends[0] < ends[1]:
        return
    msg = f"plant: {what} is {ends!r}; give two finite numbers, the smaller first, such as (0.0, 100.0)"
    raise PlantError(msg)
