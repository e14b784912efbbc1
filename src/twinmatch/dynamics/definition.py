"""What a plant's file defines, and checks of names, structures and values that contradict each other."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

from twinmatch.dynamics.declarations import (
    Declaration,
    Disturbance,
    Drive,
    Output,
    Parameter,
    PlantError,
    State,
    Structure,
    is_number,
    require_text,
    shown,
)
from twinmatch.dynamics.loop import Law
from twinmatch.dynamics.sensor import Sensor

Expression = Any
"""A SymPy expression; SymPy has no types of its own for mypy."""

_Declared = TypeVar("_Declared", bound=Declaration)
_OF_TABLES = ("time", "reference", "output", "input")
"""Names of signals in the map of a table's columns."""


@dataclass(frozen=True)
class Equations:
    """The return value of a plant's `equations`."""

    rates: Mapping[Expression, Expression]
    """Time derivative of each state that the structure has, in its unit per second."""
    output: Expression | Mapping[Expression, Expression]
    """The quantity that the sensor measures, a smooth function of states and other quantities; for several,
    that of each."""
    start: Mapping[Expression, Expression]
    """Initial value of each state, from the output, the drive until then, disturbances and parameters."""
    quantities: Mapping[str, Expression] = field(default_factory=dict)
    """Other quantities of interest, by name: currents, heat flows."""

    def expression_of(self, output: Expression) -> Expression:
        """What an output measures, however `output` is written; it has to be the only one, or to be in it."""
        return self.output[output] if isinstance(self.output, Mapping) else self.output

    def driven(self, drive: Expression, by: Expression) -> Equations:
        """These equations with `by` in place of a drive in the rates, such as what is left of it."""
        import sympy  # noqa: PLC0415

        return replace(
            self,
            rates={
                s: sympy.sympify(rate).subs(drive, by) for s, rate in self.rates.items()
            },
        )


class PlantType(type):
    """Metaclass of plants: a separate type, so that a plant can define how it is pickled for another
    process; and what is asked of a plant with one input and one output only."""

    name: str
    declarations: Mapping[str, Declaration]
    drives: Mapping[str, Drive]
    outputs: Mapping[str, Output]

    @property
    def drive(cls) -> Drive:
        """The only input."""
        return cls._only("input", cls.drives)

    @property
    def output(cls) -> Output:
        """The only output."""
        return cls._only("output", cls.outputs)

    @property
    def single(cls) -> bool:
        """Whether it has one input and one output."""
        return len(cls.drives) == len(cls.outputs) == 1

    def called(cls, name: str) -> str:
        """One of several quantities as it is shown: as its text says."""
        return (cls.declarations[name].text or name).replace("_", " ")

    def _only(cls, what: str, declared: Mapping[str, _Declared]) -> _Declared:
        if len(declared) != 1:
            raise PlantError(
                f"plant {cls.name}: it has {len(declared)} {what}s ({', '.join(declared)}); this is for "
                "plants with one input and one output"
            )
        return next(iter(declared.values()))


class PlantDefinition(metaclass=PlantType):
    """Quantities, structures and equations of one kind of plant, without what runs them."""

    title: ClassVar[str] = ""
    """Displayed name."""
    parts: ClassVar[tuple[str, ...]] = ()
    """Names of optional parts; `equations` gets those that are included."""
    structures: ClassVar[Mapping[str, Structure]] = {}
    """Structures by name, simple ones first. The first is the one matched to single windows."""
    loop: ClassVar[Law | None] = None
    """The controller that runs the plant, if known; without one the twin is driven by u."""
    sensor: ClassVar[Sensor | None] = None
    """Sensor model for simulated plants; without one, readings are exact."""

    typical: ClassVar[Mapping[str, float]] = {}
    """Typical parameters of plants of this kind, if not the defaults; used before the first match."""
    followed: ClassVar[str] = ""
    """Structure in which a running plant is tracked to detect changes; the first if empty."""
    time_constant: ClassVar[float] = 0.0
    """Time constant that windows, horizons, … follow, s; 0: the slowest one of the linearised equations."""
    surroundings: ClassVar[str] = "what surrounds the plant"
    """What to check if something changes slowly."""

    name: ClassVar[str]
    declarations: ClassVar[Mapping[str, Declaration]]
    states: ClassVar[Mapping[str, State]]
    parameters: ClassVar[Mapping[str, Parameter]]
    disturbances: ClassVar[Mapping[str, Disturbance]]
    drives: ClassVar[Mapping[str, Drive]]
    outputs: ClassVar[Mapping[str, Output]]

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Rates, output and start, in terms of the plant's own symbols (`self.name_of_a_quantity`)."""
        raise PlantError(
            f"plant {self.name}: it has no equations; write the method `equations`"
        )

    @classmethod
    def _of(cls, kind: type[_Declared]) -> dict[str, _Declared]:
        return {n: v for n, v in cls.declarations.items() if isinstance(v, kind)}


def require_consistent(
    plant: type[PlantDefinition], base: type[PlantDefinition]
) -> None:
    """Check a plant's class; `base` is the class of which all plants are.

    Raises:
        PlantError: it contradicts itself.
    """
    _require_names(plant, base)
    for kind, signals in ((Drive, plant.drives), (Output, plant.outputs)):
        if not signals:
            raise PlantError(
                f"plant {plant.name}: declares no {kind.__name__}; declare at least one"
            )
    if not isinstance(plant.structures, Mapping):
        kind = type(plant.structures).__name__
        raise PlantError(
            f"plant {plant.name}: `structures` is of type {kind}; write a dictionary of names and Structures"
        )
    if not plant.structures:
        raise PlantError(
            f"plant {plant.name}: has no structure; declare at least one in `structures`"
        )
    if not (is_number(plant.time_constant) and 0.0 <= plant.time_constant < math.inf):
        raise PlantError(
            f"plant {plant.name}: `time_constant` is {shown(plant.time_constant)}; give seconds"
        )
    if plant.followed and plant.followed not in plant.structures:
        raise PlantError(
            f"plant {plant.name}: `followed` is {plant.followed!r}; name one of its structures"
        )
    _require_names_of(
        plant,
        "typical",
        "parameter",
        _table(plant, "`typical`", plant.typical),
        plant.parameters,
    )
    _require_values(plant, "typical", plant.typical, plant.parameters)
    for name, structure in plant.structures.items():
        require_structure(plant, name, structure)
    for attribute, has, wanted in (
        ("loop", "period", "PidGains"),
        ("sensor", "realise", "Sensor"),
    ):
        value = getattr(plant, attribute)
        if value is not None and not hasattr(value, has):
            raise PlantError(
                f"plant {plant.name}: `{attribute}` is {value!r}; give a {wanted}(…)"
            )


def require_structure(
    plant: type[PlantDefinition], name: str, structure: Structure
) -> None:
    """Check that a structure has known names and possible values.

    Raises:
        PlantError: it has others.
    """
    require_text(f"name of a structure of {plant.name}", name)
    if not isinstance(structure, Structure):
        msg = f"plant {plant.name}, structure {name!r}: is {structure!r}; write Structure(free=(…))"
        raise PlantError(msg)
    place = f"structure {name!r}"
    external = structure.external
    own_parameters, own_states = (
        (external.parameters, external.states) if external else ({}, {})
    )
    parameters = {**plant.parameters, **own_parameters}
    _require_names_of(plant, place, "part", structure.parts, plant.parts)
    _require_names_of(plant, place, "parameter", structure.free, parameters)
    _require_names_of(
        plant, place, "state", structure.free_starts, {**plant.states, **own_states}
    )
    for table_name, names in (
        ("free", structure.free),
        ("free_starts", structure.free_starts),
    ):
        twice = [name for k, name in enumerate(names) if name in names[:k]]
        if twice:
            raise PlantError(
                f"plant {plant.name}, {place}: `{table_name}` names {twice[0]!r} twice; name it once"
            )
    for table_name, values in (
        ("`fixed`", structure.fixed),
        *(("`starts`", start) for start in structure.starts),
    ):
        where_in_structure = f"{place}, {table_name}"
        _require_names_of(
            plant,
            where_in_structure,
            "parameter",
            _table(plant, where_in_structure, values),
            parameters,
        )
        _require_values(plant, where_in_structure, values, parameters)
    if not (structure.free or external):
        msg = f"plant {plant.name}, {place}: `free` is empty; name the parameters that a match may change"
        raise PlantError(msg)


def _require_names(plant: type[PlantDefinition], base: type[PlantDefinition]) -> None:
    if not isinstance(plant.name, str) or not re.fullmatch(r"\w[\w-]*", plant.name):
        msg = f'plant {plant.name!r}: is not a valid name; use letters, digits and _, such as name="tank"'
        raise PlantError(msg)
    _require_no_name_of_plants(plant, base)
    for attribute in ("title", "followed", "surroundings"):
        require_text(f"{attribute} of {plant.name}", getattr(plant, attribute))
    if isinstance(plant.parts, str) or not all(
        isinstance(part, str) for part in plant.parts
    ):
        raise PlantError(
            f'plant {plant.name}: `parts` is {plant.parts!r}; write texts in a tuple: ("…",)'
        )
    _require_methods(plant, base)
    for name in plant.disturbances:
        if name in _OF_TABLES:
            msg = f"plant {plant.name}: a disturbance is called {name!r}, like a signal of every recording"
            raise PlantError(f"{msg}; rename it")


def _require_no_name_of_plants(
    plant: type[PlantDefinition], base: type[PlantDefinition]
) -> None:
    """Refuse a quantity with the name of an attribute of every plant, but for an output or a drive."""
    names_of_plants = {
        name
        for kind in base.__mro__
        for name in (*vars(kind), *vars(kind).get("__annotations__", ()))
    }
    for name, declared in vars(plant).items():
        is_quantity = isinstance(declared, Declaration)
        is_signal = isinstance(declared, Output | Drive)
        if is_quantity and not is_signal and name in names_of_plants:
            msg = f"plant {plant.name}: {name!r} is an attribute of every plant; rename this quantity"
            raise PlantError(msg)


def _require_methods(plant: type[PlantDefinition], base: type[PlantDefinition]) -> None:
    """Check that a plant is made as every plant is, and that its equations can be asked for."""
    if plant.__init__ is not base.__init__ or plant.__new__ is not base.__new__:
        raise PlantError(
            f"plant {plant.name}: has its own __init__ or __new__; declare what it needs"
        )
    if not callable(plant.equations):
        raise PlantError(
            f"plant {plant.name}: `equations` is not a method; write def equations(self, parts)"
        )
    if len(inspect.signature(plant.equations).parameters) != 2:
        raise PlantError(
            f"plant {plant.name}: `equations` takes other arguments; write def equations(self, parts)"
        )


def _require_names_of(
    plant: type[PlantDefinition],
    place: str,
    kind: str,
    names: Iterable[str],
    known: Iterable[str],
) -> None:
    unknown = sorted({str(name) for name in names} - set(known))
    if unknown:
        msg = f"plant {plant.name}, {place}: no {kind} {unknown[0]!r}"
        raise PlantError(f"{msg}; the plant has {', '.join(known) or 'none'}")


def _require_values(
    plant: type[PlantDefinition],
    place: str,
    values: Mapping[str, Any],
    known: Mapping[str, Any],
) -> None:
    for name, value in values.items():
        if not is_number(value) or not known[name].possible(value):
            required = known[name].requirement
            raise PlantError(
                f"plant {plant.name}, {place}: {name} is {shown(value)}; it must be {required}"
            )


def _table(plant: type[PlantDefinition], place: str, values: Any) -> Mapping[str, Any]:
    if not isinstance(values, Mapping):
        raise PlantError(
            f"plant {plant.name}, {place}: is {values!r}; write a dictionary of names and values"
        )
    return values
