"""A setting is declared once, where it is used: a field of a dataclass with meaning, unit and range.

ROS parameters, files of parameters and their documentation follow from that declaration. The numbers of one
rule that nobody sets are a `Rule`.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any


class Rule:
    """Numbers that belong to one rule: the class has their values and says why, its instance cannot be changed.

    A frozen dataclass is that, too. But to write and compile the methods of one takes a millisecond, and half
    of what importing twinmatch takes beside its libraries was spent on those of dataclasses.
    """

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__}.{name} cannot be changed")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"{type(self).__name__}.{name} cannot be removed")


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
