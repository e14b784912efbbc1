"""The numbers that make one rig, and the state it is in."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Final

from twinmatch.errors import TwinmatchError

__all__ = ["PARAMETER_NAMES", "SEEBECK_REFERENCE", "PlantError", "PlantState", "RigParameters"]


class PlantError(TwinmatchError):
    """Numbers no rig can have, or signals the plant cannot be run on."""


PARAMETER_NAMES: Final = (
    "seebeck",
    "resistance",
    "conductance",
    "heat_capacity",
    "ambient",
    "sink_heat_capacity",
    "sink_convection",
    "sensor_lag",
    "seebeck_slope",
    "drive_ripple",
)
"""Names of the rig parameters in their canonical order; each may be matched to a window."""

SEEBECK_REFERENCE: Final = 298.15
"""Temperature at which a module has its nominal Seebeck coefficient, K; data sheets use it too."""

_MAY_BE_ZERO = frozenset({"seebeck", "conductance", "sink_convection", "sensor_lag", "drive_ripple"})
_MAY_BE_NEGATIVE = frozenset({"seebeck_slope"})
_COLDEST, _HOTTEST = 150.0, 600.0


def require_kelvin(name: str, value: float) -> float:
    """Return a temperature that can be one of this rig in kelvin.

    Raises:
        PlantError: it is not finite or lies outside 150 to 600 K, as a value in °C would.
    """
    if not _COLDEST <= value <= _HOTTEST:
        msg = f"{name} is {value} K; give kelvin between {_COLDEST:g} and {_HOTTEST:g}, not °C"
        raise PlantError(msg)
    return float(value)


@dataclass(frozen=True, slots=True)
class RigParameters:
    """One Peltier plate on its heat sink (paper, section III; start values of its table).

    Raises:
        PlantError: a value is not finite or has a sign or size that no rig has.
    """

    seebeck: float = 0.075
    """Seebeck coefficient α of the module at 298.15 K (everywhere, unless it has a slope), V/K."""
    resistance: float = 3.3
    """Electrical resistance R of the module, Ω."""
    conductance: float = 0.35
    """Thermal conductance K between the two sides, W/K."""
    heat_capacity: float = 15.0
    """Lumped heat capacity C of the plate (side A), J/K."""
    ambient: float = 296.0
    """Temperature of the surroundings, and of a sink without mass, K."""
    sink_heat_capacity: float = math.inf
    """Heat capacity of the sink (side B), J/K; infinite holds the sink at its first temperature."""
    sink_convection: float = 0.0
    """Convection from the sink to the surroundings, W/K; only a sink of finite capacity feels it."""
    sensor_lag: float = 0.0
    """Time constant τ with which what the camera sees follows the plate, s; 0: it sees the plate itself."""
    seebeck_slope: float = 0.0
    """Change of the Seebeck coefficient with temperature, α(T) = α + slope·(T − 298.15 K), V/K²."""
    drive_ripple: float = 0.0
    """Share of the bridge's switching that reaches the module, 0 to 1. At 1 the current follows every pulse
    of the PWM, and the Joule heat goes with the duty cycle; at 0 it is smoothed, and the heat goes with
    the square."""

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, float(getattr(self, field.name))
            object.__setattr__(self, name, value)
            least, valid = " and positive", value > 0
            if name in _MAY_BE_ZERO:
                least, valid = " and 0 or more", value >= 0
            elif name in _MAY_BE_NEGATIVE:
                least, valid = "", not math.isnan(value)
            if not valid or (math.isinf(value) and name != "sink_heat_capacity"):
                msg = f"rig parameters: {name} is {value}; it must be finite{least}"
                raise PlantError(msg)
        require_kelvin("rig parameters: ambient", self.ambient)
        if self.drive_ripple > 1.0:
            msg = f"rig parameters: drive_ripple is {self.drive_ripple}; it is a share between 0 and 1"
            raise PlantError(msg)

    @property
    def sink_has_mass(self) -> bool:
        """Whether the sink warms and cools (finite heat capacity)."""
        return math.isfinite(self.sink_heat_capacity)

    def replace(self, **changes: float) -> RigParameters:
        """The same rig with some parameters changed.

        Raises:
            PlantError: a name is not a rig parameter, or a value is not possible.
        """
        unknown = sorted(set(changes) - set(PARAMETER_NAMES))
        if unknown:
            msg = f"rig parameters: {unknown[0]!r} is none of {', '.join(PARAMETER_NAMES)}"
            raise PlantError(msg)
        values: dict[str, Any] = {name: getattr(self, name) for name in PARAMETER_NAMES}
        return RigParameters(**(values | changes))


@dataclass(frozen=True, slots=True)
class PlantState:
    """Where the plant is between two ticks.

    Raises:
        PlantError: a temperature is not finite and above 0 K.
    """

    plate: float
    """Temperature T_A of the controlled plate, K."""
    sink: float
    """Temperature T_B of the heat sink, K."""
    sensor: float = math.nan
    """Temperature the camera sees, K; NaN, if not given, becomes the plate's."""

    def __post_init__(self) -> None:
        if math.isnan(self.sensor):
            object.__setattr__(self, "sensor", self.plate)
        for name, value in (("plate", self.plate), ("sink", self.sink), ("sensor", self.sensor)):
            if not (math.isfinite(value) and value > 0):
                msg = f"plant state: {name} is {value} K; it must be finite and above absolute zero"
                raise PlantError(msg)
