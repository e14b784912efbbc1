"""A setting is declared once, where it is used: a field of a dataclass with meaning, unit and range.

ROS parameters, files of parameters and their documentation follow from that declaration.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any


def setting(
    default: Any,
    text: str,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
) -> Any:
    """A field of a dataclass that a user may set.

    Args:
        default: the default.
        text: what it means; like the unit it may name what depends on the plant, such as `{y}`.
        unit: its unit.
        low: least value a user may give.
        high: greatest such value.
    """
    return field(
        default=default, metadata={"text": text, "unit": unit, "low": low, "high": high}
    )
