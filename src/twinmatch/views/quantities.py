"""The rig parameters as people write them: symbol, unit, and a number short enough to read."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.matching import SINK_START
from twinmatch.signals import KELVIN

__all__ = ["QUANTITIES", "Quantity", "number", "quantity"]


class Quantity(NamedTuple):
    """One rig parameter and how it is shown."""

    name: str
    symbol: str
    unit: str
    """Unit it is shown in."""
    words: str
    factor: float = 1.0
    """From its own unit to the one it is shown in."""
    offset: float = 0.0
    """Added after that."""
    decimals: int = 2

    @property
    def label(self) -> str:
        """Symbol and unit, as on an axis."""
        return f"{self.symbol} / ({self.unit})" if "/" in self.unit else f"{self.symbol} / {self.unit}"

    def shown(self, value: float) -> float:
        """The value in the unit it is shown in."""
        return value * self.factor + self.offset

    def text(self, value: float) -> str:
        """The value in that unit, without the unit; a dash where it is not known."""
        return number(self.shown(value), self.decimals)

    def error_text(self, value: float) -> str:
        """A standard error, in the same unit and with a digit more."""
        return number(value * self.factor, self.decimals + 1)


QUANTITIES: tuple[Quantity, ...] = (
    Quantity("seebeck", "α", "mV/K", "Seebeck coefficient of the Peltier module", 1000.0, decimals=1),
    Quantity("resistance", "R", "Ω", "electrical resistance of the module"),
    Quantity("conductance", "K", "W/K", "heat conducted from one side to the other", decimals=3),
    Quantity("heat_capacity", "C", "J/K", "heat capacity of the plate", decimals=1),
    Quantity("ambient", "T_amb", "°C", "temperature of the surroundings", offset=-KELVIN, decimals=1),
    Quantity("sink_heat_capacity", "C_sink", "J/K", "heat capacity of the heat sink", decimals=0),
    Quantity("sink_convection", "h_sink", "W/K", "heat the sink gives to the air", decimals=2),
    Quantity("sensor_lag", "τ", "s", "time constant with which the camera follows the plate", decimals=2),
    Quantity("seebeck_slope", "dα/dT", "µV/K²", "change of α with temperature, about 25 °C", 1e6, decimals=1),
    Quantity("drive_ripple", "ρ", "1", "share of the bridge's switching that reaches the module"),
    Quantity(
        SINK_START, "T_sink(0)", "°C", "temperature of the sink at the start", offset=-KELVIN, decimals=1
    ),
)
"""Every parameter of `RigParameters` and the sink's start, in their canonical order."""

_BY_NAME = {q.name: q for q in QUANTITIES}


def quantity(name: str) -> Quantity:
    """The parameter of this name; one that is not known here is shown as it is."""
    return _BY_NAME.get(name) or Quantity(name, name, "–", name, decimals=4)


def number(value: float | None, decimals: int = 2, *, plus: bool = False) -> str:
    """A number with a true minus sign; a dash where it is not known, ∞ where it has no bound."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:{'+' if plus else ''}.{decimals}f}"
    if float(text) == 0:
        text = text.replace("-", "")
    return text.replace("-", "−")
