"""A plant is its equations: the base class of every plant file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

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
    """What plants are classes of: a type of its own, so that a plant may say how it travels to another
    process."""


class Plant(metaclass=PlantType):
    """One kind of plant. A subclass declares its quantities, its structures and its `equations`.

    Write the class in a module of its own. Everything that is computed from a plant (step, tangents,
    linearisation) is made from its equations and kept on disk until a line of that module changes.

    Raises:
        PlantError: the declarations contradict one another.
    """

    title: ClassVar[str] = ""
    """What people call it."""
    parts: ClassVar[tuple[str, ...]] = ()
    """Names of what may or may not be there; `equations` is told which are."""
    structures: ClassVar[Mapping[str, Structure]] = {}
    """By name, simpler ones first. The first is the one whose parameters are matched to single windows."""
    loop: ClassVar[PidGains | None] = None
    """The controller that runs the plant, if it is known; without one the twin is driven by u."""
    sensor: ClassVar[Sensor | None] = None
    """What the sensor adds, for simulated plants; without one it adds nothing."""

    typical: ClassVar[Mapping[str, float]] = {}
    """Parameters amid those that plants of this kind had, if not the defaults; a guess before any match."""
    followed: ClassVar[str] = ""
    """Structure in which a running plant is followed to tell what changed of it; the first if empty."""
    surroundings: ClassVar[str] = "what surrounds the plant"
    """Where to look if something changes slowly."""

    name: ClassVar[str]
    declarations: ClassVar[Mapping[str, Declaration]]
    states: ClassVar[Mapping[str, State]]
    parameters: ClassVar[Mapping[str, Parameter]]
    disturbances: ClassVar[Mapping[str, Disturbance]]
    drive: ClassVar[Drive]
    output: ClassVar[Output]

    def __init_subclass__(cls, *, name: str | None = None, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        cls.name = name or cls.__name__.lower()
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
        cls._check_names()
        cls._check_structures()

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002 (subclasses use them)
        """Rates, output and start, in terms of the plant's own symbols (`self.name_of_a_quantity`)."""
        msg = f"plant {self.name}: it has no equations; write the method `equations`"
        raise PlantError(msg)

    @classmethod
    def model(cls, structure: str | None = None) -> Model:
        """The plant in one of its structures (the first, if none is named), ready to be run.

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
        """Take in one more structure, whose equations are elsewhere; one of the same name gives way.

        Raises:
            PlantError: the plant's own structure has that name, or it speaks of what is not declared.
        """
        before = cls.structures.get(name)
        if structure.elsewhere is None or (before is not None and before.elsewhere is None):
            msg = f"plant {cls.name}: structure {name!r} is its file's; give the other one another name"
            raise PlantError(msg)
        cls._check_structure(name, structure)
        cls.structures = {**cls.structures, name: structure}
        _MODELS.pop((cls, name), None)
        return cls.model(name)

    @classmethod
    def disown(cls, name: str) -> None:
        """Let a structure go that was adopted; one that is not there is no mistake."""
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
            msg = f"plant {cls.name}: declares {len(held)} of {kind.__name__}; it needs one"
            raise PlantError(msg)
        return held[0]

    @classmethod
    def _check_names(cls) -> None:
        own = {**vars(Plant), **Plant.__annotations__}
        for name in cls.declarations:
            if name in own and cls.declarations[name] not in (cls.output, cls.drive):
                msg = f"plant {cls.name}: {name!r} is a word of every plant; call this quantity otherwise"
                raise PlantError(msg)

    @classmethod
    def _check_structures(cls) -> None:
        if not cls.structures:
            raise PlantError(f"plant {cls.name}: has no structure; name at least one in `structures`")
        if cls.followed and cls.followed not in cls.structures:
            raise PlantError(f"plant {cls.name}: no structure {cls.followed!r} to follow it in")
        for name, structure in cls.structures.items():
            cls._check_structure(name, structure)

    @classmethod
    def _check_structure(cls, name: str, structure: Structure) -> None:
        elsewhere = structure.elsewhere
        own_parameters, own_states = (elsewhere.parameters, elsewhere.states) if elsewhere else ({}, {})
        for kind, names, known in (
            ("part", structure.parts, cls.parts),
            (
                "parameter",
                (*structure.free, *structure.fixed, *cls.typical),
                (*cls.parameters, *own_parameters),
            ),
            ("state", structure.free_starts, (*cls.states, *own_states)),
        ):
            unknown = sorted(set(names) - set(known))
            if unknown:
                msg = (
                    f"plant {cls.name}, structure {name!r}: no {kind} {unknown[0]!r}; the plant has "
                    f"{', '.join(known) or 'none'}"
                )
                raise PlantError(msg)


_MODELS: dict[tuple[type[Plant], str], Model] = {}


def _model(plant: type[Plant], structure: str) -> Model:
    from twinmatch.dynamics.model import Model  # noqa: PLC0415 (a plant file needs no compiled code)

    if (plant, structure) not in _MODELS:
        _MODELS[plant, structure] = Model(plant, structure)
    return _MODELS[plant, structure]
