"""The base class of every plant file: a plant is defined by its equations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from twinmatch.dynamics.consistent import require_consistent, require_structure
from twinmatch.dynamics.declarations import (
    Declaration,
    Disturbance,
    Drive,
    Output,
    Parameter,
    State,
    Structure,
)
from twinmatch.dynamics.errors import PlantError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from twinmatch.dynamics.equations import Equations
    from twinmatch.dynamics.model import Model
    from twinmatch.dynamics.pid import PidGains
    from twinmatch.dynamics.sensor import Sensor

__all__ = ["Plant", "PlantType"]

_Declared = TypeVar("_Declared", bound=Declaration)


class PlantType(type):
    """Metaclass of plants: a separate type, so that a plant can define how it is pickled for another
    process."""


class Plant(metaclass=PlantType):
    """One kind of plant. A subclass declares its quantities, its structures and its `equations`.

    Write the class in its own module. The compiled code of a plant (step, tangents, linearisation) is
    generated from its equations and kept on disk until that module changes.

    Raises:
        PlantError: the declarations contradict each other.
    """

    title: ClassVar[str] = ""
    """Displayed name."""
    parts: ClassVar[tuple[str, ...]] = ()
    """Names of optional parts; `equations` gets those that are included."""
    structures: ClassVar[Mapping[str, Structure]] = {}
    """Structures by name, simple ones first. The first is the one matched to single windows."""
    loop: ClassVar[PidGains | None] = None
    """The controller that runs the plant, if known; without one the twin is driven by u."""
    sensor: ClassVar[Sensor | None] = None
    """Sensor model for simulated plants; without one, readings are exact."""

    typical: ClassVar[Mapping[str, float]] = {}
    """Typical parameters of plants of this kind, if not the defaults; used before the first match."""
    followed: ClassVar[str] = ""
    """Structure in which a running plant is tracked to detect changes; the first if empty."""
    surroundings: ClassVar[str] = "what surrounds the plant"
    """What to check if something changes slowly."""

    name: ClassVar[str]
    declarations: ClassVar[Mapping[str, Declaration]]
    states: ClassVar[Mapping[str, State]]
    parameters: ClassVar[Mapping[str, Parameter]]
    disturbances: ClassVar[Mapping[str, Disturbance]]
    drive: ClassVar[Drive]
    output: ClassVar[Output]

    def __init_subclass__(cls, *, name: str | None = None, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        cls.name = cls.__name__.lower() if name is None else name
        cls.title = cls.title or cls.__name__
        found: dict[str, Declaration] = {}
        for base in reversed(cls.__mro__):
            found |= {n: v for n, v in vars(base).items() if isinstance(v, Declaration) and v.name == n}
        cls.declarations = found
        cls.states = cls._of(State)
        cls.parameters = cls._of(Parameter)
        cls.disturbances = cls._of(Disturbance)
        cls.drive = cls._one(Drive)
        cls.output = cls._one(Output)
        require_consistent(cls, Plant)

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002 (subclasses use them)
        """Rates, output and start, in terms of the plant's own symbols (`self.name_of_a_quantity`)."""
        msg = f"plant {self.name}: it has no equations; write the method `equations`"
        raise PlantError(msg)

    @classmethod
    def model(cls, structure: str | None = None) -> Model:
        """The plant in one of its structures (default: the first), ready to run.

        Raises:
            PlantError: there is no such structure, or its equations cannot be used.
        """
        name = next(iter(cls.structures)) if structure is None else structure
        if name not in cls.structures:
            msg = f"plant {cls.name}: no structure {name!r}; it has {', '.join(cls.structures)}"
            raise PlantError(msg)
        return _model(cls, name)

    @classmethod
    def adopt(cls, name: str, structure: Structure) -> Model:
        """Add an external structure; it replaces an external one of the same name.

        Raises:
            PlantError: a structure of the plant's file has that name, or it uses undeclared names.
        """
        before = cls.structures.get(name)
        if structure.elsewhere is None or (before is not None and before.elsewhere is None):
            msg = f"plant {cls.name}: its file declares a structure {name!r}; give the new one another name"
            raise PlantError(msg)
        require_structure(cls, name, structure)
        cls.structures = {**cls.structures, name: structure}
        _MODELS.pop((cls, name), None)
        return cls.model(name)

    @classmethod
    def disown(cls, name: str) -> None:
        """Remove an adopted structure; an unknown name is ignored."""
        if name in cls.structures and cls.structures[name].elsewhere is not None:
            cls.structures = {n: s for n, s in cls.structures.items() if n != name}
            _MODELS.pop((cls, name), None)

    @classmethod
    def _of(cls, kind: type[_Declared]) -> dict[str, _Declared]:
        return {n: v for n, v in cls.declarations.items() if isinstance(v, kind)}

    @classmethod
    def _one(cls, kind: type[_Declared]) -> _Declared:
        held = list(cls._of(kind).values())
        if len(held) != 1:
            msg = f"plant {cls.name}: declares {len(held)} of {kind.__name__}; declare exactly one"
            raise PlantError(msg)
        return held[0]


_MODELS: dict[tuple[type[Plant], str], Model] = {}


def _model(plant: type[Plant], structure: str) -> Model:
    from twinmatch.dynamics.model import Model  # noqa: PLC0415 (a plant file needs no compiled code)

    if (plant, structure) not in _MODELS:
        _MODELS[plant, structure] = Model(plant, structure)
    return _MODELS[plant, structure]
