"""What a forecaster has to know of a candidate, and how it holds candidates to their forecasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twinmatch.discrimination import Candidate
from twinmatch.dynamics import Parameters
from twinmatch.forecasting import HORIZONS, ForecastError
from twinmatch.signals import FloatArray

__all__ = ["Entrant", "ForecastSettings"]


def _unknown(_: int) -> FloatArray | None:
    return None


@dataclass(frozen=True)
class ForecastSettings:
    """How far and how often the candidates are held to their forecasts.

    Raises:
        ForecastError: a value is not positive.
    """

    horizons: tuple[float, ...] = HORIZONS
    """s"""
    every: float = 30.0
    """s between two samples from which all candidates foretell."""
    memory: float = 1800.0
    """s after which a forecast counts for a share of 1/e."""

    def __post_init__(self) -> None:
        for name, value in (("horizons", min(self.horizons)), ("every", self.every), ("memory", self.memory)):
            if not value > 0:
                raise ForecastError(f"forecasts: {name} is {value} s; it must be positive")


class Entrant(NamedTuple):
    """A candidate as the forecaster takes it."""

    name: str
    parameters: Parameters
    samples: tuple[int, int]
    """First and last sample it was fitted to."""
    free: tuple[str, ...] = ()
    covariance: FloatArray | None = None
    """Of the free parameters."""
    states_at: Callable[[int], FloatArray | None] = _unknown
    """Its states at a sample, where they are known."""

    @classmethod
    def of(cls, candidate: Candidate, states_at: Callable[[int], FloatArray | None] = _unknown) -> Entrant:
        """A candidate of the family; one that was given counts as exact."""
        window = candidate.window
        # Where a match saw no end of some combination, what it says of the others cannot be told from that.
        # Then the parameters count as exact, and the bands are as wide as the errors have been.
        known = len(candidate.covariance) > 0 and bool(np.isfinite(candidate.covariance).all())
        return cls(
            name=candidate.name,
            parameters=candidate.parameters,
            samples=(window.first, window.last) if window is not None else (0, -1),
            free=candidate.free,
            covariance=candidate.covariance if known else None,
            states_at=states_at,
        )
