"""Values of the parameters of one structure of one plant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.dynamics.errors import PlantError
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from twinmatch.dynamics.model import Model

__all__ = ["Parameters"]


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
            msg = (
                f"{model.title}: no parameter {unknown[0]!r} in this structure; it has "
                f"{', '.join(model.names)}"
            )
            raise PlantError(msg)
        held = {}
        for name, declared in model.declared.items():
            value = float(values.get(name, model.defaults[name]))
            if not declared.possible(value):
                msg = f"{model.title}: {name} is {value:g} {declared.unit}; it must be {declared.requirement}"
                raise PlantError(msg)
            held[name] = value
        self.model = model
        self._values = held
        self._hash = hash((model.key, tuple(held.values())))
        self._steps: dict[float, int] = {}
        self.vector: FloatArray = np.array(list(held.values()), dtype=np.float64)
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
