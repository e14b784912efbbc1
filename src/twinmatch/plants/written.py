"""Parameters as written in messages, documents and files: plant, structure, names, values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from twinmatch.dynamics import Parameters, Plant
from twinmatch.plants import Peltier, plant_named
from twinmatch.plants.absent import is_marked, stand_in

__all__ = ["parameters_from", "structure_of"]

_PARTS: Final = {"sink_heat_capacity": "sink with mass", "sensor_lag": "sensor lag", "seebeck_slope": "α(T)"}
"""The part that each of these values implies, in records without a structure."""
_HELD: Final = 1e12
"""Heat capacity of a sink at constant temperature, J/K, for parts that occur only with a sink's mass."""
_IMMEDIATE: Final = 0.05
"""Lag of a sensor without lag, s, likewise."""


def parameters_from(plant: str, structure: str, values: Mapping[str, float]) -> Parameters:
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
    kept = {n: v for n, v in values.items() if n in model.declared or n not in kind.parameters}
    if math.isinf(kept.get("sink_heat_capacity", 0.0)):
        kept["sink_heat_capacity"] = _HELD
    if not kept.get("sensor_lag", 1.0):
        kept["sensor_lag"] = _IMMEDIATE
    return model.parameters(**kept)


def structure_of(plant: type[Plant], values: Mapping[str, float]) -> str:
    """The first structure with all parts that the values imply: a heat capacity of the sink, a lag of the
    sensor, a slope of the Seebeck coefficient. Zero (for the sink, infinity) meant that the part is
    absent."""
    parts = {
        part
        for name, part in _PARTS.items()
        if part in plant.parts and values.get(name) and math.isfinite(values[name])
    }
    having = (name for name, structure in plant.structures.items() if parts <= structure.parts)
    return next(having, next(iter(plant.structures)))
