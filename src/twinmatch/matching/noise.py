"""How much a residual weighs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.dynamics import Plant
from twinmatch.matching.bounds import MatchingError

__all__ = ["Noise"]


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations by which residuals are weighed.

    Raises:
        MatchingError: one is not finite and positive.
    """

    output: float
    """Of the output, in its unit."""
    input: float
    """Of the input in steady closed loop, in its unit."""

    def __post_init__(self) -> None:
        for name, value in (("output", self.output), ("input", self.input)):
            if not (math.isfinite(value) and value > 0):
                msg = f"noise: {name} is {value}; it must be finite and positive"
                raise MatchingError(msg)

    @classmethod
    def of(cls, plant: type[Plant]) -> Noise:
        """As the plant file declares it."""
        return cls(plant.output.noise, plant.drive.noise)
