"""Plants and parameters as written in messages, documents and files: plant, structure, names, values, units.

A structure may be external and absent in this process, such as a page that only displays it: then a stand-in
has its names. The name of an external structure ends in a mark, as in `the maker's (FMU 0ab36ba3)`, which
distinguishes it from an unknown name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, NoReturn

from twinmatch.description import Description, Quantity
from twinmatch.dynamics import (
    Parameter,
    Parameters,
    Plant,
    PlantError,
    State,
    Structure,
    StructureLostError,
)
from twinmatch.plants import Peltier, plant_named
from twinmatch.settings import Rule

MARK: Final = re.compile(r" \(FMU [0-9a-f]{8}\)$")
_ANYTHING: Final = (-1e300, 1e300)
_PARTS: Final = {
    "sink_heat_capacity": "sink with mass",
    "sensor_lag": "sensor lag",
    "seebeck_slope": "α(T)",
}
"""The part that each of these values implies, in records without a structure."""


class WithoutEffect(Rule):
    """Values with which a part has no effect, for records that have other parts only together with it."""

    sink_heat_capacity: float = 1e12
    """Of a sink at constant temperature, J/K."""
    sensor_lag: float = 0.05
    """Of a sensor that follows at once, s."""


_WITHOUT_EFFECT: Final = WithoutEffect()


def is_marked(structure: str) -> bool:
    """Whether this is the name of an external structure."""
    return MARK.search(structure) is not None


def stand_in(plant: type[Plant], structure: str, names: Sequence[str]) -> None:
    """Declare a structure by the names of its parameters; it cannot be run.

    Raises:
        PlantError: a structure of the plant's file has that name.
    """
    plant.adopt(
        structure,
        Structure(free=(), watched=False, external=_Absent(plant, structure, names)),
    )


class _Absent:
    """The source of such a structure."""

    def __init__(
        self, plant: type[Plant], structure: str, names: Sequence[str]
    ) -> None:
        self.lost = (
            f"{structure} is not loaded in this process; load its FMU with --allow-fmu"
        )
        self.states: Mapping[str, State] = {}
        self.parameters: Mapping[str, Parameter] = {
            name: Parameter(default=0.0, bounds=_ANYTHING, text=name)
            for name in names
            if name not in plant.parameters
        }
        self._kernels = _NoKernels(tuple(names), self.lost)

    def kernels_by(self, unknown: Iterable[str]) -> Any:  # noqa: ARG002
        """Names without kernels."""
        return self._kernels


class _NoKernels:
    """Kernels with names only."""

    STATES: tuple[str, ...] = ()
    QUANTITIES: tuple[str, ...] = ()

    def __init__(self, names: tuple[str, ...], why: str) -> None:
        self.PARAMETERS = self.UNKNOWN = names
        self._why = why

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("_"):
            raise AttributeError(name)
        raise StructureLostError(self._why)


def parameters_from(
    plant: str, structure: str, values: Mapping[str, float]
) -> Parameters:
    """The parameters of a record, by name.

    Without a structure, the values imply the parts: so in records from before plants had structures, when the
    Peltier rig was the only plant, and in short files. A structure that is an FMU need not be loaded in this
    process: its parameters then have names and values, but cannot be run.

    Raises:
        PlantError: no such plant, structure or parameter, or impossible values.
    """
    kind = plant_named(plant or Peltier.name)
    if structure:
        if structure not in kind.structures and is_marked(structure):
            stand_in(kind, structure, tuple(values))
        return kind.model(structure).parameters(**values)
    model = kind.model(structure_of(kind, values))
    known_values = {
        n: v
        for n, v in values.items()
        if n in model.declared or n not in kind.parameters
    }
    if math.isinf(known_values.get("sink_heat_capacity", 0.0)):
        known_values["sink_heat_capacity"] = _WITHOUT_EFFECT.sink_heat_capacity
    if not known_values.get("sensor_lag", 1.0):
        known_values["sensor_lag"] = _WITHOUT_EFFECT.sensor_lag
    return model.parameters(**known_values)


def structure_of(plant: type[Plant], values: Mapping[str, float]) -> str:
    """The first structure with all parts that the values imply: a heat capacity of the sink, a lag of the
    sensor, a slope of the Seebeck coefficient. Zero (for the sink, infinity) meant that the part is
    absent."""
    parts = {
        part
        for name, part in _PARTS.items()
        if part in plant.parts and values.get(name) and math.isfinite(values[name])
    }
    having = (
        name for name, structure in plant.structures.items() if parts <= structure.parts
    )
    return next(having, next(iter(plant.structures)))


_SET_POINT: Final = "set-point"


def description_of(plant: type[Plant]) -> Description:
    """Names and units of a plant and its signals."""
    outputs = plant.outputs.values()
    return Description(
        plant=plant.name,
        title=plant.title,
        references=tuple(
            Quantity(
                _SET_POINT if len(outputs) == 1 else f"{_SET_POINT} of {y.name}",
                f"{_SET_POINT} of {y.text or y.name}",
                y.unit,
            )
            for y in outputs
        ),
        outputs=tuple(Quantity(y.name, y.text, y.unit, *y.span) for y in outputs),
        inputs=tuple(
            Quantity(u.name, u.text, u.unit, *u.limits) for u in plant.drives.values()
        ),
        disturbances=tuple(
            Quantity(d.name, d.text, d.unit) for d in plant.disturbances.values()
        ),
        states=tuple(
            Quantity(s.name, s.text, s.unit, *s.span) for s in plant.states.values()
        ),
        structures=tuple(plant.structures),
    )


class Named(NamedTuple):
    """Parameters in the form of a message."""

    plant: str = ""
    """Name of the plant; empty if there are no parameters."""
    structure: str = ""
    """Name of the structure; empty in old records: the values then imply the parts."""
    names: tuple[str, ...] = ()
    values: tuple[float, ...] = ()
    units: tuple[str, ...] = ()


def named(parameters: Parameters | None) -> Named:
    """Parameters by name with their units; empty for None."""
    if parameters is None:
        return Named()
    plant, structure = parameters.model.key
    return Named(
        plant,
        structure,
        tuple(parameters),
        tuple(parameters.values()),
        parameters.units,
    )


def parameters_of(
    plant: str, structure: str, names: Sequence[str], values: Sequence[float]
) -> Parameters | None:
    """The parameters with these names and values; None if there are none.

    Raises:
        PlantError: an unknown plant, structure or parameter, not one value for each name, or impossible
            values.
    """
    if not plant and not names:
        return None
    if len(names) != len(values):
        msg = f"parameters: {len(names)} names with {len(values)} values; give one value for each name"
        raise PlantError(msg)
    return parameters_from(
        plant, structure, dict(zip(names, map(float, values), strict=True))
    )
