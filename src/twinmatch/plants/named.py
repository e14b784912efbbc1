"""Descriptions of plants and parameters for messages, figures and files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.description import Description, Quantity
from twinmatch.dynamics import Parameters, Plant, PlantError
from twinmatch.plants.written import parameters_from

__all__ = ["Named", "description_of", "named", "parameters_of"]


def description_of(plant: type[Plant]) -> Description:
    """Names and units of a plant and its signals."""
    y, u = plant.output, plant.drive
    return Description(
        plant=plant.name,
        title=plant.title,
        reference=Quantity("set-point", f"set-point of {y.text or y.name}", y.unit),
        output=Quantity(y.name, y.text, y.unit, *y.span),
        input=Quantity(u.name, u.text, u.unit, *u.limits),
        disturbances=tuple(Quantity(d.name, d.text, d.unit) for d in plant.disturbances.values()),
        states=tuple(Quantity(s.name, s.text, s.unit, *s.span) for s in plant.states.values()),
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
    return Named(plant, structure, tuple(parameters), tuple(parameters.values()), parameters.units)


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
    return parameters_from(plant, structure, dict(zip(names, map(float, values), strict=True)))
