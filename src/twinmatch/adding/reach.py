"""What acts on what, read from the equations: drive, states and parts that nothing would show."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from twinmatch.adding.findings import Finding
from twinmatch.dynamics import Equations, Plant
from twinmatch.dynamics.equations import written_equations

__all__ = ["idle_disturbances", "unreached"]


def unreached(plant: type[Plant]) -> list[Finding]:
    """Drive and states that do not act on the output, and parts that change nothing.

    Raises:
        PlantError: the equations cannot be used.
    """
    equations = _equations(plant)
    found = []
    for name, written in equations.items():
        place = f"structure {name!r}"
        seen = _acting(written)
        drive = plant.drive.name
        if drive not in _names(written.rates[state] for state in written.rates if str(state) in seen):
            what = f"{place}: the drive {drive} does not act on the output"
            found.append(Finding(what, f"use self.{drive} in the rate of a state that the output depends on"))
        for state in written.rates:
            if str(state) not in seen:
                what = f"{place}: state {state} does not act on the output, so no recording can show it"
                todo = "remove it, or use it in the output or in another rate"
                found.append(Finding(what, todo))
    return [*found, *_same(plant, equations), *_unused_parts(plant)]


def idle_disturbances(plant: type[Plant]) -> list[str]:
    """Names of disturbances that are in no equation.

    Raises:
        PlantError: the equations cannot be used.
    """
    used: set[str] = set()
    for written in _equations(plant).values():
        used |= _names([*written.rates.values(), written.output, *written.start.values()])
    return [name for name in plant.disturbances if name not in used]


def _equations(plant: type[Plant]) -> dict[str, Equations]:
    """By structure; FMUs have none here."""
    own = {name: held.parts for name, held in plant.structures.items() if held.external is None}
    return {name: written_equations(plant(), parts) for name, parts in own.items()}


def _acting(written: Equations) -> set[str]:
    """States that act on the output, at once or through others."""
    states = {str(state): rate for state, rate in written.rates.items()}
    seen = _names([written.output]) & set(states)
    while more := (_names(states[name] for name in seen) & set(states)) - seen:
        seen |= more
    return seen


def _same(plant: type[Plant], equations: dict[str, Equations]) -> list[Finding]:
    """Structures with other parts but the same equations."""
    found, held = [], list(equations.items())
    for k, (name, one) in enumerate(held):
        for other, before in held[:k]:
            parts = plant.structures[name].parts ^ plant.structures[other].parts
            if parts and (one.rates, one.output, one.start) == (before.rates, before.output, before.start):
                listed = " and ".join(sorted(parts))
                what = f"structures {other!r} and {name!r} have the same equations: {listed} changes nothing"
                found.append(Finding(what, "use the part in `equations`, or remove one of the structures"))
    return found


def _unused_parts(plant: type[Plant]) -> list[Finding]:
    used = frozenset().union(*(structure.parts for structure in plant.structures.values()))
    return [
        Finding(f"part {part!r}: no structure has it", "remove it, or add a structure with it")
        for part in plant.parts
        if part not in used
    ]


def _names(expressions: Iterable[Any]) -> set[str]:
    return {str(s) for e in expressions for s in getattr(e, "free_symbols", ())}
