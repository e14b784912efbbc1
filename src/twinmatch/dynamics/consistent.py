"""Checks of a plant's class: names, structures and values that contradict each other."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from twinmatch.dynamics.declarations import Declaration, Structure
from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.numbers import require_text

if TYPE_CHECKING:
    from twinmatch.dynamics.plant import Plant

__all__ = ["require_consistent", "require_structure"]

_OF_TABLES = ("time", "reference", "output", "input")
"""Names of signals in the map of a table's columns."""


def require_consistent(plant: type[Plant], base: type[Plant]) -> None:
    """Check a plant's class; `base` is the class of which all plants are.

    Raises:
        PlantError: it contradicts itself.
    """
    _require_names(plant, base)
    if not isinstance(plant.structures, Mapping):
        kind = type(plant.structures).__name__
        msg = (
            f"plant {plant.name}: `structures` is of type {kind}; write a dictionary of names and Structures"
        )
        raise PlantError(msg)
    if not plant.structures:
        raise PlantError(f"plant {plant.name}: has no structure; declare at least one in `structures`")
    if plant.followed and plant.followed not in plant.structures:
        raise PlantError(f"plant {plant.name}: `followed` is {plant.followed!r}; name one of its structures")
    _require_names_of(
        plant, "typical", "parameter", _table(plant, "`typical`", plant.typical), plant.parameters
    )
    _require_values(plant, "typical", plant.typical, plant.parameters)
    for name, structure in plant.structures.items():
        require_structure(plant, name, structure)
    for attribute, has, wanted in (("loop", "period", "PidGains"), ("sensor", "realise", "Sensor")):
        value = getattr(plant, attribute)
        if value is not None and not hasattr(value, has):
            raise PlantError(f"plant {plant.name}: `{attribute}` is {value!r}; give a {wanted}(…)")


def require_structure(plant: type[Plant], name: str, structure: Structure) -> None:
    """Check that a structure has known names and possible values.

    Raises:
        PlantError: it has others.
    """
    require_text(f"name of a structure of {plant.name}", name)
    if not isinstance(structure, Structure):
        msg = f"plant {plant.name}, structure {name!r}: is {structure!r}; write Structure(free=(…))"
        raise PlantError(msg)
    place = f"structure {name!r}"
    elsewhere = structure.elsewhere
    own_parameters, own_states = (elsewhere.parameters, elsewhere.states) if elsewhere else ({}, {})
    parameters = {**plant.parameters, **own_parameters}
    _require_names_of(plant, place, "part", structure.parts, plant.parts)
    _require_names_of(plant, place, "parameter", structure.free, parameters)
    _require_names_of(plant, place, "state", structure.free_starts, {**plant.states, **own_states})
    for what, names in (("free", structure.free), ("free_starts", structure.free_starts)):
        twice = [name for k, name in enumerate(names) if name in names[:k]]
        if twice:
            raise PlantError(f"plant {plant.name}, {place}: `{what}` names {twice[0]!r} twice; name it once")
    for what, values in (("`fixed`", structure.fixed), *(("`starts`", start) for start in structure.starts)):
        here = f"{place}, {what}"
        _require_names_of(plant, here, "parameter", _table(plant, here, values), parameters)
        _require_values(plant, here, values, parameters)


def _require_names(plant: type[Plant], base: type[Plant]) -> None:
    if not isinstance(plant.name, str) or not re.fullmatch(r"\w[\w-]*", plant.name):
        msg = f'plant {plant.name!r}: is not a valid name; use letters, digits and _, such as name="tank"'
        raise PlantError(msg)
    own = {**vars(base), **base.__annotations__}
    for name, declared in vars(plant).items():
        if isinstance(declared, Declaration) and name in own and declared not in (plant.output, plant.drive):
            msg = f"plant {plant.name}: {name!r} is an attribute of every plant; rename this quantity"
            raise PlantError(msg)
    for attribute in ("title", "followed", "surroundings"):
        require_text(f"{attribute} of {plant.name}", getattr(plant, attribute))
    if isinstance(plant.parts, str) or not all(isinstance(part, str) for part in plant.parts):
        raise PlantError(f'plant {plant.name}: `parts` is {plant.parts!r}; write texts in a tuple: ("…",)')
    if not callable(plant.equations):
        raise PlantError(f"plant {plant.name}: `equations` is not a method; write def equations(self, parts)")
    if len(inspect.signature(plant.equations).parameters) != 2:
        raise PlantError(
            f"plant {plant.name}: `equations` takes other arguments; write def equations(self, parts)"
        )
    for name in plant.disturbances:
        if name in _OF_TABLES:
            msg = f"plant {plant.name}: a disturbance is called {name!r}, like a signal of every recording"
            raise PlantError(f"{msg}; rename it")


def _require_names_of(
    plant: type[Plant], place: str, kind: str, names: Iterable[str], known: Iterable[str]
) -> None:
    unknown = sorted({str(name) for name in names} - set(known))
    if unknown:
        msg = f"plant {plant.name}, {place}: no {kind} {unknown[0]!r}"
        raise PlantError(f"{msg}; the plant has {', '.join(known) or 'none'}")


def _require_values(
    plant: type[Plant], place: str, values: Mapping[str, Any], known: Mapping[str, Any]
) -> None:
    for name, value in values.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not known[name].possible(value):
            msg = f"plant {plant.name}, {place}: {name} is {value!r}; it must be {known[name].requirement}"
            raise PlantError(msg)


def _table(plant: type[Plant], place: str, values: Any) -> Mapping[str, Any]:
    if not isinstance(values, Mapping):
        raise PlantError(
            f"plant {plant.name}, {place}: is {values!r}; write a dictionary of names and values"
        )
    return values
