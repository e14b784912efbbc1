"""What a match returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.matching.gate import Status
from twinmatch.signals import FloatArray, Window

__all__ = ["Fit", "Match", "without_fit"]


class Fit(NamedTuple):
    """NRMSE 1 − ‖measured − simulated‖/‖measured − mean‖: 1 is perfect, 0 no better than the mean."""

    y: float
    """Of the output."""
    u: float
    """Of the input; NaN for a twin that is driven by it."""


_NO_FIT = Fit(float("nan"), float("nan"))


@dataclass(frozen=True, eq=False)
class Match:
    """Parameters of a plant matched to a window, how well they are known, and whether they may be used.

    When no fit was made (the status says why) the parameters are the start values and all figures of
    the fit are NaN.
    """

    DERIVED: ClassVar = ("standard_errors",)
    """Recorded beside the fields."""

    parameters: Parameters
    free: tuple[str, ...]
    """Names of what was fitted, in the order of the arrays below: parameters in the model's order, then the
    states whose value at the window's third sample was unknown."""
    starts: Mapping[str, float]
    """Those states' values, by name; empty where the structure leaves none open."""
    covariance: FloatArray = field(metadata={"columns": -1})
    """Of the fitted parameters, shape (n, n), their own units."""
    fisher: FloatArray = field(metadata={"columns": -1})
    """Information JᵀJ of the weighed residuals, shape (n, n)."""
    eigenvalues: FloatArray
    """Of the information in units of the parameters' scales, ascending, shape (n,)."""
    condition: float
    """Condition number of the scaled Jacobian."""
    bounds_hit: tuple[str, ...]
    fit: Fit
    """On the window."""
    held_back: Fit
    """Of a fit made without the window's last part, on that part."""
    chi2: float
    """Mean squared residual of the signals compared in units of the noise variance."""
    samples: tuple[int, int]
    """Session indices of the window's first and last sample."""
    status: Status
    reason: str
    """One sentence on the status."""
    directions: FloatArray = field(default_factory=lambda: np.empty((0, 0)), metadata={"columns": -1})
    """Eigenvectors of the information in units of the parameters' scales, shape (n, n): column j belongs
    to `eigenvalues[j]`, so column 0 is the combination of parameters that the window shows least."""
    intervals: FloatArray = field(default_factory=lambda: np.empty((0, 2)), metadata={"columns": 2})
    """Profile-likelihood interval (95 %) of each parameter, its own unit, shape (n, 2); an end is
    infinite where a bound of the search cuts the interval off, zero where physics does, and NaN where no
    fit was made or it does not explain the window."""
    believed: tuple[str, ...] = ()
    """Names of the parameters that this window determines."""
    determined: str = ""
    """One sentence: which combination of the parameters the window determines."""
    suggestion: str = ""
    """One sentence: which set-point step would determine what this window leaves open; or nothing."""

    @property
    def accepted(self) -> bool:
        """Whether the parameters may be used."""
        return self.status is Status.ACCEPTED

    @property
    def standard_errors(self) -> FloatArray:
        """Of the fitted parameters, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    def of_parameters(self) -> tuple[tuple[str, ...], FloatArray]:
        """Names of the fitted parameters without the states that were fitted too, and their covariance."""
        names = tuple(name for name in self.free if name in self.parameters)
        places = [self.free.index(name) for name in names]
        return names, self.covariance[np.ix_(places, places)]

    @property
    def correlation(self) -> FloatArray:
        """Of the fitted parameters, shape (n, n)."""
        errors = self.standard_errors
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / np.outer(errors, errors), dtype=np.float64)


def without_fit(
    window: Window, free: tuple[str, ...], start: Parameters, status: Status, reason: str
) -> Match:
    """A match whose status says why no fit was made; its unknown starts are NaN."""
    n = len(free)
    unknown = np.full((n, n), np.nan)
    return Match(
        parameters=start,
        free=free,
        starts={name: float("nan") for name in free if name not in start},
        covariance=unknown,
        fisher=unknown,
        eigenvalues=np.full(n, np.nan),
        condition=float("nan"),
        bounds_hit=(),
        fit=_NO_FIT,
        held_back=_NO_FIT,
        chi2=float("nan"),
        samples=(window.first, window.last),
        status=status,
        reason=reason,
        directions=unknown,
        intervals=np.full((n, 2), np.nan),
    )
