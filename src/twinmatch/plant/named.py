"""The rig in the words that messages, figures and files share with every other plant.

This is the one place where `RigParameters` become named values with units, and named values become
`RigParameters`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from twinmatch.description import Description, Quantity
from twinmatch.plant.parameters import PARAMETER_NAMES, PlantError, RigParameters
from twinmatch.signals import PWM_LIMIT

__all__ = ["PLANT", "RIG", "STATE_NAMES", "Named", "named", "parameters_of"]

PLANT: Final = "peltier"
UNITS: Final = {
    "seebeck": "V/K",
    "resistance": "Ω",
    "conductance": "W/K",
    "heat_capacity": "J/K",
    "ambient": "K",
    "sink_heat_capacity": "J/K",
    "sink_convection": "W/K",
    "sensor_lag": "s",
    "seebeck_slope": "V/K²",
    "drive_ripple": "",
}
STATE_NAMES: Final = ("plate", "sink", "sensor")

RIG: Final = Description(
    plant=PLANT,
    title="Peltier rig",
    reference=Quantity("set-point", "temperature the plate is to have", "°C"),
    output=Quantity("temperature", "plate temperature, as the camera reads it", "°C", -60.0, 250.0),
    input=Quantity("control", "PWM command of the driver, positive heats", "PWM", -PWM_LIMIT, PWM_LIMIT),
    states=(
        Quantity("plate", "plate, side A of the module", "K", 0.0),
        Quantity("sink", "heat sink, side B of the module", "K", 0.0),
        Quantity("sensor", "what the camera sees of the plate", "K", 0.0),
    ),
)
"""The Peltier rig; whoever knows its structures adds them."""


class Named(NamedTuple):
    """Parameters as a message carries them."""

    plant: str = ""
    """Empty: there are no parameters."""
    structure: str = ""
    """Empty: the values say which parts there are."""
    names: tuple[str, ...] = ()
    values: tuple[float, ...] = ()
    units: tuple[str, ...] = ()


def named(parameters: RigParameters | None) -> Named:
    """Parameters by name with their units; of none, no names."""
    if parameters is None:
        return Named()
    values = tuple(float(getattr(parameters, name)) for name in PARAMETER_NAMES)
    return Named(PLANT, "", PARAMETER_NAMES, values, tuple(UNITS[name] for name in PARAMETER_NAMES))


def parameters_of(plant: str, names: Sequence[str], values: Sequence[float]) -> RigParameters | None:
    """The rig with these named values; None where there are no parameters.

    Raises:
        PlantError: another plant, a parameter the rig does not have, not one value for each name, or values
            no rig has.
    """
    if not plant and not names:
        return None
    if plant != PLANT:
        msg = f"parameters: are of the plant {plant!r}; this twin knows {PLANT!r}"
        raise PlantError(msg)
    unknown = [name for name in names if name not in PARAMETER_NAMES]
    if unknown:
        msg = f"parameters: {PLANT} has no {unknown[0]!r}; it has {', '.join(PARAMETER_NAMES)}"
        raise PlantError(msg)
    if len(names) != len(values):
        msg = f"parameters: {len(names)} names came with {len(values)} values; each needs one"
        raise PlantError(msg)
    return RigParameters(**dict(zip(names, map(float, values), strict=True)))
