"""The noise that weights the residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.dynamics import Plant
from twinmatch.fitting.bounds import MatchingError

__all__ = ["Noise"]


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations that weight the residuals.

    Raises:
        MatchingError: one is not finite and positive.
    """

    output: float
    """Standard deviation of the output, in its unit."""
    input: float
    """Standard deviation of the input in steady closed loop, in its unit."""

    def __post_init__(self) -> None:
        for name, value in (("output", self.output), ("input", self.input)):
            if not (math.isfinite(value) and value > 0):
                msg = f"noise: {name} is {value}; it must be finite and positive"
                raise MatchingError(msg)

    @classmethod
    def of(cls, plant: type[Plant]) -> Noise:
        """The noise that the plant file declares."""
        return cls(plant.output.noise, plant.drive.noise)
