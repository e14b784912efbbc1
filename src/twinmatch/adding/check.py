"""All checks of a plant file that need no data."""

from __future__ import annotations

from collections.abc import Iterator

from twinmatch.adding.behaviour import coarse, in_bounds, misdeclared, pace, ranges
from twinmatch.adding.dimensions import Dimensions
from twinmatch.adding.findings import CheckedPlant, Finding
from twinmatch.adding.identifiable import inseparable
from twinmatch.adding.reach import idle_disturbances, unreached
from twinmatch.dynamics import Model, Plant, PlantError

__all__ = ["check_plant"]


def check_plant(plant: type[Plant], period: float | None = None) -> CheckedPlant:
    """Check a plant.

    Args:
        plant: the plant.
        period: sampling period, s; by default that of its loop. Without either, checks that depend on it are
            skipped.
    """
    if period is None and plant.loop is not None:
        period = plant.loop.period
    findings: dict[str, Finding] = {}
    notes: list[str] = []
    try:
        for found, remarks in _steps(plant, period):
            findings |= {one.what: one for one in found}
            notes += [note for note in remarks if note not in notes]
    except PlantError as error:
        return CheckedPlant(plant.title, tuple(findings.values()), tuple(notes), str(error))
    return CheckedPlant(plant.title, tuple(findings.values()), tuple(notes))


def _steps(plant: type[Plant], period: float | None) -> Iterator[tuple[list[Finding], list[str]]]:
    dimensions = Dimensions(plant)
    for parts in dict.fromkeys(structure.parts for structure in plant.structures.values()):
        dimensions.check(parts)
    yield list(dimensions.findings.values()), _unit_notes(dimensions)
    yield unreached(plant), [f"disturbance {n}: in no equation" for n in idle_disturbances(plant)]
    yield coarse(plant), []
    yield _unused(plant), []
    for name in plant.structures:
        model = plant.model(name)
        yield misdeclared(model), []
        yield ranges(model), []
        yield pace(model, period)
        yield inseparable(model), []
        yield in_bounds(model), []


def _unit_notes(dimensions: Dimensions) -> list[str]:
    notes = []
    if dimensions.unknown_units:
        notes.append(f"unknown units are treated as plain numbers: {', '.join(dimensions.unknown_units)}")
    if dimensions.unchecked:
        listed = ", ".join(sorted(dimensions.unchecked))
        notes.append(
            f"units were not checked where these numbers multiply: {listed}. To give such a number a unit, "
            "declare it as a Parameter that is in no `free`"
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
