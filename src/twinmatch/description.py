"""Names and units of a plant and its signals, for messages, figures, tables and pages."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Quantity:
    """A signal or a state of a plant."""

    name: str
    """Name in code and files."""
    text: str
    """Short description."""
    unit: str = ""
    low: float = -math.inf
    """Lowest possible value."""
    high: float = math.inf

    @property
    def decimals(self) -> int:
        """Decimal places that resolve a ten-thousandth of its span; three without a span."""
        span = self.high - self.low
        return min(9, max(0, 4 - math.floor(math.log10(span)))) if 0 < span < math.inf else 3

    @property
    def label(self) -> str:
        """Name and unit, as on an axis; only the unit if both are equal, as for PWM."""
        if self.name.lower() == self.unit.lower():
            return self.unit
        return f"{self.name} / {self.unit}" if self.unit else self.name


@dataclass(frozen=True, slots=True)
class Description:
    """A plant with one loop: the reference has the unit of the output."""

    plant: str
    """Name, such as peltier."""
    title: str
    """Displayed name."""
    reference: Quantity
    output: Quantity
    input: Quantity
    disturbances: tuple[Quantity, ...] = ()
    states: tuple[Quantity, ...] = ()
    """States of a twin, in the order of messages."""
    structures: tuple[str, ...] = ()
    """Names of the plant's structures."""


UNDESCRIBED = Description(
    plant="",
    title="",
    reference=Quantity("set-point", "set-point of the output"),
    output=Quantity("output", "measured output"),
    input=Quantity("input", "commanded input"),
)
"""Placeholder for a plant that has not published its description yet."""
