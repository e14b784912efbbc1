"""A plant, its structures as models that can be run, and the values of their parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.declarations import (
    Declaration,
    Disturbance,
    Drive,
    Output,
    Parameter,
    PlantError,
    State,
    Structure,
)
from twinmatch.dynamics.definition import (
    PlantDefinition,
    require_consistent,
    require_structure,
)
from twinmatch.dynamics.store import kernels_of
from twinmatch.signals import FloatArray, finite

_Declared = TypeVar("_Declared", bound=Declaration)


class Plant(PlantDefinition):
    """One kind of plant. A subclass declares its quantities, its structures and its `equations`.

    Write the class in its own module. The compiled code of a plant (step, tangents, linearisation) is
    generated from its equations and kept on disk until that module changes.

    Raises:
        PlantError: the declarations contradict each other.
    """

    channel_of: ClassVar[tuple[type[Plant], int] | None] = None
    """The plant of several signals of which it is one channel, and which."""

    def __init_subclass__(cls, *, name: str | None = None, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        cls.name = cls.__name__.lower() if name is None else name
        cls.title = cls.title or cls.__name__
        declarations: dict[str, Declaration] = {}
        for base in reversed(cls.__mro__):
            declarations |= {
                n: v
                for n, v in vars(base).items()
                if isinstance(v, Declaration) and v.name == n
            }
        cls.declarations = declarations
        cls.states = cls._of(State)
        cls.parameters = cls._of(Parameter)
        cls.disturbances = cls._of(Disturbance)
        cls.drives = cls._of(Drive)
        cls.outputs = cls._of(Output)
        require_consistent(cls, Plant)

    @classmethod
    def model(cls, structure: str | None = None) -> Model:
        """The plant in one of its structures (default: the first), ready to run.

        Raises:
            PlantError: there is no such structure, or its equations cannot be used.
        """
        name = next(iter(cls.structures)) if structure is None else structure
        if name not in cls.structures:
            raise PlantError(
                f"plant {cls.name}: no structure {name!r}; it has {', '.join(cls.structures)}"
            )
        if (cls, name) not in _MODELS:
            _MODELS[cls, name] = Model(cls, name)
        return _MODELS[cls, name]

    @classmethod
    def adopt(cls, name: str, structure: Structure) -> Model:
        """Add an external structure; it replaces an external one of the same name.

        Raises:
            PlantError: a structure of the plant's file has that name, or it uses undeclared names.
        """
        before = cls.structures.get(name)
        if structure.external is None or (
            before is not None and before.external is None
        ):
            msg = f"plant {cls.name}: its file declares a structure {name!r}; give the new one another name"
            raise PlantError(msg)
        require_structure(cls, name, structure)
        cls.structures = {**cls.structures, name: structure}
        _MODELS.pop((cls, name), None)
        return cls.model(name)

    @classmethod
    def disown(cls, name: str) -> None:
        """Remove an adopted structure; an unknown name is ignored."""
        if name in cls.structures and cls.structures[name].external is not None:
            cls.structures = {n: s for n, s in cls.structures.items() if n != name}
            _MODELS.pop((cls, name), None)


_ALL_CORNERS = 8
"""States up to which all corners of their range are looked at; their number doubles with each."""
_SOME_CORNERS = 64


@cache
def channels(plant: type[Plant]) -> tuple[type[Plant], ...]:
    """Its outputs, each with the input in the same place (of fewer the last): what shows a single loop shows
    each. A plant with one input and one output is its only channel."""
    if plant.single:
        return (plant,)
    single_channels = []
    for k in range(max(len(plant.outputs), len(plant.drives))):
        alone: type[Plant] = type(
            plant.__name__, (plant,), {"title": plant.title}, name=plant.name
        )
        alone.channel_of = (plant, k)
        alone.outputs = _one_of(plant.outputs, k)
        alone.drives = _one_of(plant.drives, k)
        single_channels.append(alone)
    return tuple(single_channels)


def channel(plant: type[Plant], k: int) -> type[Plant]:
    """The k-th of these."""
    return channels(plant)[k]


def _one_of(declared: Mapping[str, _Declared], k: int) -> dict[str, _Declared]:
    """The k-th of several, called as its text says; of one that."""
    name, chosen = list(declared.items())[min(k, len(declared) - 1)]
    if len(declared) > 1:
        chosen = replace(chosen)
        chosen.__set_name__(type, chosen.text or name)
    return {name: chosen}


def corners_of(spans: Sequence[tuple[float, float]]) -> FloatArray:
    """Corners of a range, shape (m, n): all 2ⁿ for few states.

    For many: both extremes, those where one state is at the other end, and `_SOME_CORNERS` drawn with a fixed
    seed. In equations whose rates depend on a few states each, as in chains and grids, that shows every local
    combination.
    """
    n = len(spans)
    if n <= _ALL_CORNERS:
        return np.array(list(itertools.product(*spans)), dtype=np.float64)
    identity = np.eye(n, dtype=np.int64)
    none = np.zeros((1, n), dtype=np.int64)
    drawn = np.random.default_rng(n).integers(0, 2, (_SOME_CORNERS, n))
    is_upper = np.vstack([none, 1 - none, identity, 1 - identity, drawn]) == 1
    low, high = np.array(spans, dtype=np.float64).T
    return np.asarray(np.where(is_upper, high, low))


_MODELS: dict[tuple[type[Plant], str], Model] = {}


class Model:
    """Access to a plant's equations in one structure; there is one object per plant and structure."""

    def __init__(self, plant: type[Plant], structure_name: str) -> None:
        """Use `Plant.model`, which caches the objects."""
        self.plant = plant
        self.structure_name = structure_name
        self.structure: Structure = plant.structures[structure_name]
        self.key = (plant.name, structure_name)
        self.title = f"{plant.title}, {structure_name}"

    def __reduce__(self) -> tuple[Any, ...]:
        return self.plant.model, (self.structure_name,)

    def __repr__(self) -> str:
        return f"<{self.title}>"

    @cached_property
    def kernels(self) -> Any:
        """Its functions; compiled ones have tangents for all parameters free in structures with its parts."""
        if self.structure.external is not None:
            return self.structure.external.kernels_by(())
        parts = self.structure.parts
        sharing = [
            s
            for s in self.plant.structures.values()
            if s.parts == parts and s.external is None
        ]
        kernels = kernels_of(
            self.plant, parts, frozenset[str]().union(*(s.free for s in sharing))
        )
        if unused := [
            name for name in self.structure.free if name not in kernels.PARAMETERS
        ]:
            place = f"plant {self.plant.name}, structure {self.structure_name!r}"
            raise PlantError(
                f"{place}: {unused[0]} is free, but does not occur in the equations with the structure's "
                "parts; remove it from `free`, or add the part that uses it to `parts`"
            )
        return kernels

    @property
    def equations(self) -> str:
        """A digest of its equations, which changes only if they do; empty if they are external."""
        return (
            "" if self.structure.external is not None else str(self.kernels.EQUATIONS)
        )

    def kernels_by(self, names: Iterable[str]) -> Any:
        """Functions with tangents for these parameters."""
        if self.structure.external is not None:
            return self.structure.external.kernels_by(names)
        if set(names) <= set(self.kernels.UNKNOWN):
            return self.kernels
        return kernels_of(self.plant, self.structure.parts, frozenset(self.names))

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of this structure's states, in the order of every array of states."""
        return tuple(self.kernels.STATES)

    @cached_property
    def declared(self) -> Mapping[str, Parameter]:
        """The parameters that the equations of this structure depend on, in the order of every array."""
        external_parameters = (
            self.structure.external.parameters
            if self.structure.external is not None
            else {}
        )
        all_parameters = {**self.plant.parameters, **external_parameters}
        return {name: all_parameters[name] for name in self.kernels.PARAMETERS}

    @cached_property
    def declared_states(self) -> tuple[State, ...]:
        """The states, in the order of every array of states."""
        external_states = (
            self.structure.external.states
            if self.structure.external is not None
            else {}
        )
        all_states = {**self.plant.states, **external_states}
        return tuple(all_states[name] for name in self.states)

    @cached_property
    def instant(self) -> bool:
        """Whether an output depends on a drive at the same instant."""
        if self.is_external:
            return False
        vector = np.array(list(self.defaults.values()), dtype=np.float64)
        rows = (
            self.kernels.slopes_at(vector, self.corners[-1], u, self.disturbances)
            for u in self.drives
        )
        return any(bool(np.any(slopes[6])) for slopes in rows)

    @property
    def is_external(self) -> bool:
        """Whether its equations are not in the plant's file, so that they may fail in other ways."""
        return self.structure.external is not None

    @property
    def lost(self) -> str:
        """Why an external structure can no longer be run, in a sentence; empty while it can."""
        return "" if self.structure.external is None else self.structure.external.lost

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.declared)

    @cached_property
    def defaults(self) -> Mapping[str, float]:
        """Default values of the parameters."""
        fixed = self.structure.fixed
        return {
            name: fixed.get(name, declared.default)
            for name, declared in self.declared.items()
        }

    def parameters(self, **values: float) -> Parameters:
        """Parameters with these values; those not named have the structure's defaults.

        Raises:
            PlantError: as `Parameters`.
        """
        return Parameters(self, values)

    def typical(self) -> Parameters:
        """The typical values of the plant file, for the parameters of this structure."""
        values = {n: v for n, v in self.plant.typical.items() if n in self.declared}
        return Parameters(self, values)

    @cached_property
    def disturbances(self) -> FloatArray:
        """Defaults of the disturbances, shape (m,)."""
        return np.array(
            [d.default for d in self.plant.disturbances.values()], dtype=np.float64
        )

    def disturbance_row(self, values: ArrayLike | None) -> FloatArray:
        """One value per disturbance, shape (m,): the given ones, or the defaults.

        Raises:
            PlantError: the plant has another number of them, or one is not finite.
        """
        if values is None or (self.disturbances.size and np.size(values) == 0):
            return self.disturbances
        row = np.array(values, dtype=np.float64)
        if row.shape != self.disturbances.shape or not finite(row):
            raise PlantError(
                f"{self.title}: disturbances {row.tolist()} given; give {self.disturbances.size} finite "
                f"values ({', '.join(self.plant.disturbances) or 'none'})"
            )
        return row

    def disturbance_rows(self, values: ArrayLike | None, size: int) -> FloatArray:
        """One row per sample, shape (size, m): the given ones, or the defaults.

        Raises:
            PlantError: as `disturbance_row`.
        """
        if values is None or (self.disturbances.size and np.size(values) == 0):
            return np.full((size, self.disturbances.size), self.disturbances)
        rows = np.array(values, dtype=np.float64)
        if rows.shape != (size, self.disturbances.size) or not finite(rows):
            raise PlantError(
                f"{self.title}: disturbances of shape {rows.shape} given; give {self.disturbances.size} "
                f"finite values ({', '.join(self.plant.disturbances) or 'none'}) at each of {size} samples"
            )
        return rows

    def steps(self, vector: FloatArray, period: float) -> int:
        """Runge–Kutta steps per sample for these parameters: the fastest rate in the plant's range decides.

        Raises:
            PlantError: the plant is too fast for samples of this period.
        """
        if not (math.isfinite(period) and period > 0):
            raise PlantError(
                f"{self.title}: the period is {period} s; it must be finite and positive"
            )
        count = self._step_count(vector, period)
        if count > self.kernels.MAX_STEPS:
            raise PlantError(
                f"{self.title}: its shortest time constant is too short for a period of {period:g} s; "
                f"a sample would take more than {self.kernels.MAX_STEPS} steps"
            )
        return count

    def can_step(self, vector: FloatArray, period: float) -> bool:
        """Whether the plant with these parameters is slow enough for samples of this period, s."""
        return bool(self._step_count(vector, period) <= self.kernels.MAX_STEPS)

    def _step_count(self, vector: FloatArray, period: float) -> int:
        kernels = self.kernels
        count = kernels.step_count(
            vector,
            self.corners,
            self.drives,
            self.disturbances,
            float(period),
            kernels.RATE_LIMIT,
        )
        return int(count)

    @cached_property
    def corners(self) -> FloatArray:
        """Corners and centre of the range of the states, shape (m, n): see `corners_of`."""
        corners = corners_of([state.span for state in self.declared_states])
        return np.vstack([corners, corners.mean(axis=0)])

    @cached_property
    def drives(self) -> FloatArray:
        """Combinations of the drives' limits and rest values, shape (3ᵐ, m)."""
        levels = [(*drive.limits, drive.rest) for drive in self.plant.drives.values()]
        return np.array(list(itertools.product(*levels)), dtype=np.float64)

    @cached_property
    def rest(self) -> FloatArray:
        """Rest values of the drives, shape (m,)."""
        return np.array(
            [drive.rest for drive in self.plant.drives.values()], dtype=np.float64
        )

    @cached_property
    def noise(self) -> FloatArray:
        """Standard deviations of the readings, shape (o,)."""
        return np.array(
            [output.noise for output in self.plant.outputs.values()], dtype=np.float64
        )

    def row_of(self, what: str, values: ArrayLike) -> FloatArray:
        """One value for each of the plant's `what`: "inputs" or "outputs"; a single one may be a number.

        Raises:
            PlantError: the plant has another number of them, or one is not finite.
        """
        row = np.array(values, dtype=np.float64, ndmin=1)
        names = self.plant.drives if what == "inputs" else self.plant.outputs
        if row.shape != (len(names),) or not finite(row):
            shown = row.tolist() if row.size > 1 else row.item() if row.size else row
            name = "input" if what == "inputs" else "reading"
            if row.shape == (len(names),):
                raise PlantError(
                    f"{self.title}: the {name} is {shown}; only finite values can be used"
                )
            raise PlantError(
                f"{self.title}: {row.size} {what} given; give {', '.join(names)}"
            )
        return row


class Parameters(Mapping[str, float]):
    """An immutable mapping from parameter name to value, with the model to which the parameters belong.

    Raises:
        PlantError: a name that the structure does not have, or a value that is not possible.
    """

    __slots__ = ("_hash", "_steps", "_values", "model", "vector")

    def __init__(self, model: Model, values: Mapping[str, float]) -> None:
        """Give the values of some parameters; the others have the structure's defaults."""
        unknown = [name for name in values if name not in model.declared]
        if unknown:
            raise PlantError(
                f"{model.title}: no parameter {unknown[0]!r} in this structure; it has "
                f"{', '.join(model.names)}"
            )
        checked = {}
        for name, declared in model.declared.items():
            value = float(values.get(name, model.defaults[name]))
            if not declared.possible(value):
                msg = f"{model.title}: {name} is {value:g} {declared.unit}; it must be {declared.requirement}"
                raise PlantError(msg)
            checked[name] = value
        self.model = model
        self._values = checked
        self._hash = hash((model.key, tuple(checked.values())))
        self._steps: dict[float, int] = {}
        self.vector: FloatArray = np.array(list(checked.values()), dtype=np.float64)
        """The values in the model's order, shape (n,); not to be changed."""

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Parameters):
            return NotImplemented
        return self.model.key == other.model.key and self._values == other._values

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self._values.items())
        return f"<{self.model.title}: {values}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Parameters, (self.model, self._values)

    def steps(self, period: float) -> int:
        """Runge–Kutta steps per sample of this period, s; the same live and in replay.

        Raises:
            PlantError: the period is not positive, or the plant too fast for it.
        """
        if period not in self._steps:
            self._steps[period] = self.model.steps(self.vector, period)
        return self._steps[period]

    def can_step(self, period: float) -> bool:
        """Whether the plant with these parameters is slow enough for samples of this period, s."""
        return self.model.can_step(self.vector, period)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the values, in the model's order."""
        return tuple(declared.unit for declared in self.model.declared.values())

    def replace(self, **changes: float) -> Parameters:
        """A copy with some values changed.

        Raises:
            PlantError: as the constructor.
        """
        return Parameters(self.model, {**self._values, **changes})
