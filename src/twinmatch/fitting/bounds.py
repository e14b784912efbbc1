"""The unknowns of a match and their bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from twinmatch.dynamics import Model, PlantError
from twinmatch.errors import TwinmatchError

__all__ = ["Bounds", "MatchingError", "Unknown", "checked_free", "unknown_parameters", "unknown_starts"]


class MatchingError(TwinmatchError):
    """A match that cannot be made: unknown names, or invalid bounds or noise."""


Bounds = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Unknown:
    """A parameter or initial state that a match estimates, as the plant file declares it."""

    name: str
    unit: str
    bounds: tuple[float, float]
    scale: float
    """Typical size (of a difference where zero is arbitrary)."""
    relative: bool
    """Whether its error is relative to its value; otherwise to its scale."""


def checked_free(model: Model, free: Iterable[str] | None) -> tuple[str, ...]:
    """The free parameters, in the model's order; default: the structure's.

    Raises:
        MatchingError: no name, an unknown or repeated one, or one that this structure does not have.
    """
    names = tuple(model.structure.free if free is None else free)
    unknown = [name for name in names if name not in model.names]
    if unknown:
        msg = (
            f"matching: {unknown[0]!r} cannot be free in {model.title}; choose from {', '.join(model.names)}"
        )
        raise MatchingError(msg)
    if not names or len(set(names)) != len(names):
        msg = f"matching: free is {names}; give at least one parameter and none twice"
        raise MatchingError(msg)
    return tuple(name for name in model.names if name in names)


def unknown_parameters(
    model: Model, names: Iterable[str], bounds: Bounds | None = None
) -> tuple[Unknown, ...]:
    """The named parameters as the plant declares them, with some bounds replaced.

    Raises:
        MatchingError: bounds of an unknown name, or a pair that is not finite and in order.
        PlantError: a bound is not a possible value of the parameter.
    """
    given = dict(bounds or {})
    known = (*model.names, *model.states)
    for name, (low, high) in given.items():
        if name not in known:
            msg = f"matching: bounds for {name!r}, which is unknown; choose from {', '.join(known)}"
            raise MatchingError(msg)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            msg = f"matching: the bounds of {name} are {low} and {high}; give two finite numbers, lower first"
            raise MatchingError(msg)
        declared = model.declared.get(name)
        for end in (low, high):
            if declared is not None and not declared.possible(end):
                msg = f"{model.title}: {name} is {end:g} {declared.unit}; it must be {declared.requirement}"
                raise PlantError(msg)
    found = []
    for name in names:
        parameter = model.declared[name]
        limits = given.get(name, parameter.bounds)
        found.append(Unknown(name, parameter.unit, limits, parameter.scale, parameter.relative))
    return tuple(found)


def unknown_starts(model: Model, bounds: Bounds | None = None) -> tuple[Unknown, ...]:
    """The states whose initial value is unknown in this structure."""
    found = []
    for name in model.structure.free_starts:
        state = model.declared_states[model.states.index(name)]
        limits = (bounds or {}).get(name) or state.start_bounds or state.span
        found.append(Unknown(name, state.unit, limits, state.scale, relative=False))
    return tuple(found)
