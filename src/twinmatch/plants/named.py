"""Plants and parameters in the words that messages, figures and files share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.description import Description, Quantity
from twinmatch.dynamics import Parameters, Plant, PlantError
from twinmatch.plants.written import parameters_from

__all__ = ["Named", "description_of", "named", "parameters_of"]


def description_of(plant: type[Plant]) -> Description:
    """What a plant and its signals are called."""
    y, u = plant.output, plant.drive
    return Description(
        plant=plant.name,
        title=plant.title,
        reference=Quantity("set-point", f"what {y.text or y.name} is to be", y.unit),
        output=Quantity(y.name, y.text, y.unit, *y.span),
        input=Quantity(u.name, u.text, u.unit, *u.limits),
        disturbances=tuple(Quantity(d.name, d.text, d.unit) for d in plant.disturbances.values()),
        states=tuple(Quantity(s.name, s.text, s.unit, *s.span) for s in plant.states.values()),
        structures=tuple(plant.structures),
    )


class Named(NamedTuple):
    """Parameters as a message carries them."""

    plant: str = ""
    """Empty: there are no parameters."""
    structure: str = ""
    """Empty: the values say which parts there are, as before structures had names."""
    names: tuple[str, ...] = ()
    values: tuple[float, ...] = ()
    units: tuple[str, ...] = ()


def named(parameters: Parameters | None) -> Named:
    """Parameters by name with their units; of none, no names."""
    if parameters is None:
        return Named()
    plant, structure = parameters.model.key
    return Named(plant, structure, tuple(parameters), tuple(parameters.values()), parameters.units)


def parameters_of(
    plant: str, structure: str, names: Sequence[str], values: Sequence[float]
) -> Parameters | None:
    """The parameters with these names and values; None where there are none.

    Raises:
        PlantError: a plant, structure or parameter that is not known, not one value for each name, or values
            that no plant has.
    """
    if not plant and not names:
        return None
    if len(names) != len(values):
        msg = f"parameters: {len(names)} names came with {len(values)} values; each needs one"
        raise PlantError(msg)
    return parameters_from(plant, structure, dict(zip(names, map(float, values), strict=True)))
