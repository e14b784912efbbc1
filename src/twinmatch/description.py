"""What a plant and its signals are called, and in which units: for messages, figures, tables and pages."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["UNDESCRIBED", "Description", "Quantity"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A signal or an inner state of a plant."""

    name: str
    """How code and files call it."""
    text: str
    """What it is, in a few words."""
    unit: str = ""
    low: float = -math.inf
    """Least value it can be given or can have."""
    high: float = math.inf

    @property
    def decimals(self) -> int:
        """Decimal places that tell a ten-thousandth of its span; three where it has none."""
        span = self.high - self.low
        return min(9, max(0, 4 - math.floor(math.log10(span)))) if 0 < span < math.inf else 3

    @property
    def label(self) -> str:
        """Name and unit, as on an axis; of a PWM in PWM the unit says all."""
        if self.name.lower() == self.unit.lower():
            return self.unit
        return f"{self.name} / {self.unit}" if self.unit else self.name


@dataclass(frozen=True, slots=True)
class Description:
    """A plant with one loop: the reference has the unit of the output."""

    plant: str
    """Name, such as peltier."""
    title: str
    """What people call it."""
    reference: Quantity
    output: Quantity
    input: Quantity
    disturbances: tuple[Quantity, ...] = ()
    states: tuple[Quantity, ...] = ()
    """Inner states of a twin, in the order in which messages carry them."""
    structures: tuple[str, ...] = ()
    """Which parts a model may take the plant to have, by name."""


UNDESCRIBED = Description(
    plant="",
    title="",
    reference=Quantity("set-point", "what the output is to be"),
    output=Quantity("output", "what is measured"),
    input=Quantity("input", "what is commanded"),
)
"""A plant that has not yet said what it is called."""
