"""A candidate as the forecaster takes it, and the settings of the forecasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Parameters
from twinmatch.forecasting import HORIZONS, ForecastError, horizons_for, time_scale
from twinmatch.signals import FloatArray

__all__ = ["Entrant", "ForecastSettings"]


def _unknown(_: int) -> FloatArray | None:
    return None


@dataclass(frozen=True)
class ForecastSettings:
    """Horizons and intervals at which the candidates' forecasts are scored.

    Raises:
        ForecastError: a value is not positive.
    """

    horizons: tuple[float, ...] = HORIZONS
    """Forecast horizons, s."""
    every: float = 30.0
    """Time between two forecasts of all candidates, s."""
    memory: float = 1800.0
    """Time after which the weight of a forecast has fallen to 1/e, s."""

    @classmethod
    def of(cls, period: float) -> ForecastSettings:
        """Settings for a sample time, s: slow samples get longer horizons, with intervals in proportion."""
        factor = time_scale(period)
        return cls(horizons_for(period), cls.every * factor, cls.memory * factor)

    def __post_init__(self) -> None:
        for name, value in (("horizons", min(self.horizons)), ("every", self.every), ("memory", self.memory)):
            if not value > 0:
                raise ForecastError(f"forecasts: {name} is {value} s; it must be positive")


class Entrant(NamedTuple):
    """The data of a candidate that a forecast needs."""

    name: str
    parameters: Parameters
    samples: tuple[int, int]
    """First and last sample to which it was fitted."""
    free: tuple[str, ...] = ()
    covariance: FloatArray | None = None
    """Covariance of the free parameters."""
    states_at: Callable[[int], FloatArray | None] = _unknown
    """Returns its states at a sample, or None where they are unknown."""

    @classmethod
    def of(cls, candidate: Candidate, states_at: Callable[[int], FloatArray | None] = _unknown) -> Entrant:
        """Convert a candidate of the family; one that was given counts as exact."""
        window = candidate.window
        # Where a match left some combination unbounded, the other variances are unusable, too.
        # Then the parameters count as exact, and the width of the bands follows from past errors.
        known = len(candidate.covariance) > 0 and bool(np.isfinite(candidate.covariance).all())
        return cls(
            name=candidate.name,
            parameters=candidate.parameters,
            samples=(window.first, window.last) if window is not None else (0, -1),
            free=candidate.free,
            covariance=candidate.covariance if known else None,
            states_at=states_at,
        )
