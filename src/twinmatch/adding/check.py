"""Everything that can be said of a plant file without data."""

from __future__ import annotations

from collections.abc import Iterator

from twinmatch.adding.behaviour import in_bounds, misdeclared, pace, ranges
from twinmatch.adding.dimensions import Dimensions
from twinmatch.adding.findings import CheckedPlant, Finding
from twinmatch.adding.identifiable import inseparable
from twinmatch.dynamics import Model, Plant, PlantError

__all__ = ["check_plant"]


def check_plant(plant: type[Plant], period: float | None = None) -> CheckedPlant:
    """What is wrong with a plant, in words.

    Args:
        plant: the plant.
        period: sample time it is to be run with, s; that of its loop if it has one, else what depends on it
            is
            not looked at.
    """
    if period is None and plant.loop is not None:
        period = plant.loop.period
    findings: dict[str, Finding] = {}
    notes: list[str] = []
    try:
        for found, said in _steps(plant, period):
            findings |= {one.what: one for one in found}
            notes += [note for note in said if note not in notes]
    except PlantError as error:
        return CheckedPlant(plant.title, tuple(findings.values()), tuple(notes), str(error))
    return CheckedPlant(plant.title, tuple(findings.values()), tuple(notes))


def _steps(plant: type[Plant], period: float | None) -> Iterator[tuple[list[Finding], list[str]]]:
    looked = Dimensions(plant)
    for parts in dict.fromkeys(structure.parts for structure in plant.structures.values()):
        looked.look(parts)
    yield list(looked.findings.values()), _unit_notes(looked)
    yield _unused(plant), []
    for name in plant.structures:
        model = plant.model(name)
        yield misdeclared(model), []
        yield ranges(model), []
        yield pace(model, period)
        yield inseparable(model), []
        yield in_bounds(model), []


def _unit_notes(looked: Dimensions) -> list[str]:
    notes = []
    if looked.unknown_units:
        notes.append(
            f"units that no table knows are taken for plain numbers: {', '.join(looked.unknown_units)}"
        )
    if looked.unchecked:
        listed = ", ".join(sorted(looked.unchecked))
        notes.append(
            f"the units of what these numbers multiply were not checked: {listed}. Declared as a "
            f"Parameter that is "
            "in no `free`, a number has a unit"
        )
    return notes


def _unused(plant: type[Plant]) -> list[Finding]:
    models: list[Model] = [plant.model(name) for name in plant.structures]
    used = {name for model in models for name in model.declared}
    moving = {name for model in models for name in model.states}
    found = [
        Finding(f"parameter {name}: no structure depends on it", "remove it, or use it in the equations")
        for name in plant.parameters
        if name not in used
    ]
    found += [
        Finding(f"state {name}: no structure gives it a rate", "remove it, or give it a rate and a start")
        for name in plant.states
        if name not in moving
    ]
    return found
