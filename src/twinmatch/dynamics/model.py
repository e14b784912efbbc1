"""A plant in one structure, ready to run."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.store import kernels_of
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from twinmatch.dynamics.declarations import Parameter, State, Structure
    from twinmatch.dynamics.plant import Plant

__all__ = ["Model"]


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
        if self.structure.elsewhere is not None:
            return self.structure.elsewhere.kernels
        parts = self.structure.parts
        every = self.plant.structures.values()
        free = (s.free for s in every if s.parts == parts and s.elsewhere is None)
        return kernels_of(self.plant, parts, frozenset().union(*free))

    def kernels_by(self, names: Iterable[str]) -> Any:
        """Functions with tangents for these parameters."""
        if self.structure.elsewhere is not None or set(names) <= set(self.kernels.UNKNOWN):
            return self.kernels
        return kernels_of(self.plant, self.structure.parts, frozenset(self.names))

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of this structure's states, in the order of every array of states."""
        return tuple(self.kernels.STATES)

    @cached_property
    def declared(self) -> Mapping[str, Parameter]:
        """The parameters that the equations of this structure depend on, in the order of every array."""
        own = self.structure.elsewhere.parameters if self.structure.elsewhere is not None else {}
        known = {**self.plant.parameters, **own}
        return {name: known[name] for name in self.kernels.PARAMETERS}

    @cached_property
    def declared_states(self) -> tuple[State, ...]:
        """The states, in the order of every array of states."""
        own = self.structure.elsewhere.states if self.structure.elsewhere is not None else {}
        known = {**self.plant.states, **own}
        return tuple(known[name] for name in self.states)

    @property
    def is_elsewhere(self) -> bool:
        """Whether its equations are not in the plant's file, so that they may fail in other ways."""
        return self.structure.elsewhere is not None

    @property
    def lost(self) -> str:
        """Why an external structure can no longer be run, in a sentence; empty while it can."""
        return "" if self.structure.elsewhere is None else self.structure.elsewhere.lost

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.declared)

    @cached_property
    def defaults(self) -> Mapping[str, float]:
        """Default values of the parameters."""
        fixed = self.structure.fixed
        return {name: fixed.get(name, declared.default) for name, declared in self.declared.items()}

    def parameters(self, **values: float) -> Parameters:
        """Parameters with these values; those not named have the structure's defaults.

        Raises:
            PlantError: as `Parameters`.
        """
        return Parameters(self, values)

    def typical(self) -> Parameters:
        """The typical values of the plant file, for the parameters of this structure."""
        known = {n: v for n, v in self.plant.typical.items() if n in self.declared}
        return Parameters(self, known)

    @cached_property
    def disturbances(self) -> FloatArray:
        """Defaults of the disturbances, shape (m,)."""
        return np.array([d.default for d in self.plant.disturbances.values()], dtype=np.float64)

    def disturbance_row(self, values: ArrayLike | None) -> FloatArray:
        """One value per disturbance, shape (m,): the given ones, or the defaults.

        Raises:
            PlantError: the plant has another number of them, or one is not finite.
        """
        if values is None or (self.disturbances.size and np.size(values) == 0):
            return self.disturbances
        row = np.array(values, dtype=np.float64)
        if row.shape != self.disturbances.shape or not np.isfinite(row).all():
            msg = (
                f"{self.title}: disturbances {row.tolist()} given; give {self.disturbances.size} finite "
                f"values ({', '.join(self.plant.disturbances) or 'none'})"
            )
            raise PlantError(msg)
        return row

    def disturbance_rows(self, values: ArrayLike | None, size: int) -> FloatArray:
        """One row per sample, shape (size, m): the given ones, or the defaults.

        Raises:
            PlantError: as `disturbance_row`.
        """
        if values is None or (self.disturbances.size and np.size(values) == 0):
            return np.tile(self.disturbances, (size, 1))
        rows = np.array(values, dtype=np.float64)
        if rows.shape != (size, self.disturbances.size) or not np.isfinite(rows).all():
            msg = (
                f"{self.title}: disturbances of shape {rows.shape} given; give {self.disturbances.size} "
                f"finite values ({', '.join(self.plant.disturbances) or 'none'}) at each of {size} samples"
            )
            raise PlantError(msg)
        return rows

    def steps(self, vector: FloatArray, period: float) -> int:
        """Runge–Kutta steps per sample for these parameters: the fastest rate in the plant's range decides.

        Raises:
            PlantError: the plant is too fast for samples of this period.
        """
        if not (math.isfinite(period) and period > 0):
            raise PlantError(f"{self.title}: the period is {period} s; it must be finite and positive")
        kernels = self.kernels
        count = kernels.step_count(
            vector, self.corners, self.drives, self.disturbances, float(period), kernels.RATE_LIMIT
        )
        if not count <= self.kernels.MOST_STEPS:
            msg = (
                f"{self.title}: its shortest time constant is too short for a period of {period:g} s; "
                f"a sample would take more than {self.kernels.MOST_STEPS} steps"
            )
            raise PlantError(msg)
        return int(count)

    @cached_property
    def corners(self) -> FloatArray:
        """Corners and centre of the range of the states, shape (m, n)."""
        spans = [state.span for state in self.declared_states]
        corners = np.array(list(itertools.product(*spans)), dtype=np.float64)
        return np.vstack([corners, corners.mean(axis=0)])

    @cached_property
    def drives(self) -> FloatArray:
        """Limits and rest value of the drive, shape (3,)."""
        drive = self.plant.drive
        return np.array([*drive.limits, drive.rest], dtype=np.float64)
