"""The result of a match."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.fitting.gate import Status
from twinmatch.signals import FloatArray, Window

__all__ = ["Fit", "Match", "without_fit"]


class Fit(NamedTuple):
    """NRMSE 1 − ‖measured − simulated‖/‖measured − mean‖: 1 is perfect, 0 no better than the mean."""

    y: float
    """Fit of the output."""
    u: float
    """Fit of the input; NaN for a driven twin."""


_NO_FIT = Fit(float("nan"), float("nan"))


@dataclass(frozen=True, eq=False)
class Match:
    """Parameters of a plant matched to a window, how well they are known, and whether they may be used.

    If no fit was made (see the status) the parameters are the start values and all figures of the fit
    are NaN.
    """

    DERIVED: ClassVar = ("standard_errors",)
    """Recorded beside the fields."""

    parameters: Parameters
    free: tuple[str, ...]
    """Names of the unknowns, in the order of the arrays below: parameters in the model's order, then the
    states with unknown value at the window's third sample."""
    starts: Mapping[str, float]
    """Values of those states, by name; empty if the structure has none."""
    covariance: FloatArray = field(metadata={"columns": -1})
    """Covariance of the fitted parameters, shape (n, n), in their own units."""
    fisher: FloatArray = field(metadata={"columns": -1})
    """Information JᵀJ of the weighted residuals, shape (n, n)."""
    eigenvalues: FloatArray
    """Eigenvalues of the information in units of the parameters' scales, ascending, shape (n,)."""
    condition: float
    """Condition number of the scaled Jacobian."""
    bounds_hit: tuple[str, ...]
    fit: Fit
    """Fit on the window."""
    held_back: Fit
    """Fit on the window's last part, for parameters fitted without it."""
    chi2: float
    """Mean squared residual of the compared signals, in units of the noise variance."""
    samples: tuple[int, int]
    """Session indices of the window's first and last sample."""
    status: Status
    reason: str
    """One sentence on the status."""
    directions: FloatArray = field(default_factory=lambda: np.empty((0, 0)), metadata={"columns": -1})
    """Eigenvectors of the information in units of the parameters' scales, shape (n, n): column j belongs
    to `eigenvalues[j]`, so column 0 is the combination of parameters that the window determines least."""
    intervals: FloatArray = field(default_factory=lambda: np.empty((0, 2)), metadata={"columns": 2})
    """Profile-likelihood interval (95 %) of each parameter, in its own unit, shape (n, 2); an end is
    infinite where a bound of the search cuts the interval off, zero where zero is a physical limit, and NaN
    if no fit was made or it does not explain the window."""
    believed: tuple[str, ...] = ()
    """Names of the parameters that this window determines."""
    determined: str = ""
    """A sentence on which combination of the parameters the window determines."""
    suggestion: str = ""
    """A sentence on which set-point step would determine what this window leaves open; or empty."""

    @property
    def accepted(self) -> bool:
        """Whether the parameters may be used."""
        return self.status is Status.ACCEPTED

    @property
    def standard_errors(self) -> FloatArray:
        """Standard errors of the fitted parameters, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    def of_parameters(self) -> tuple[tuple[str, ...], FloatArray]:
        """Names of the fitted parameters, without fitted states, and their covariance."""
        names = tuple(name for name in self.free if name in self.parameters)
        places = [self.free.index(name) for name in names]
        return names, self.covariance[np.ix_(places, places)]

    @property
    def correlation(self) -> FloatArray:
        """Correlation of the fitted parameters, shape (n, n)."""
        errors = self.standard_errors
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / np.outer(errors, errors), dtype=np.float64)


def without_fit(
    window: Window, free: tuple[str, ...], start: Parameters, status: Status, reason: str
) -> Match:
    """A match without fit, with the status that says why; its unknown initial states are NaN."""
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
