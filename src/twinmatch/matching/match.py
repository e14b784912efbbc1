"""Behavioral matching: the rig parameters that make the twin behave as the plant did in a window."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from twinmatch.matching.bounds import (
    SINK_START,
    Bounds,
    MatchingError,
    checked_bounds,
    checked_free,
)
from twinmatch.matching.estimation import on_bounds, solve, starts_for, uncertainty
from twinmatch.matching.gate import Evidence, Limits, Status, first_excited, judge, worst_stretch
from twinmatch.matching.health import fault_in_signals
from twinmatch.matching.problem import Noise, Problem
from twinmatch.plant import Driver, PidGains, RigParameters
from twinmatch.signals import FloatArray, Window

__all__ = ["FREE", "Fit", "Match", "match"]

FREE = ("seebeck", "conductance", "heat_capacity")
"""What the paper matches."""


class Fit(NamedTuple):
    """NRMSE 1 − ‖measured − simulated‖/‖measured − mean‖: 1 is perfect, 0 no better than the mean."""

    y: float
    """Of the temperature."""
    u: float
    """Of the PWM."""


_NO_FIT = Fit(float("nan"), float("nan"))


@dataclass(frozen=True, eq=False)
class Match:
    """Rig parameters matched to a window, how well they are known, and whether they may be used.

    When no fit was made (the status says why) the parameters are the start values and all figures of
    the fit are NaN.
    """

    parameters: RigParameters
    free: tuple[str, ...]
    """Names of the fitted parameters in canonical order; arrays below are in this order. For a sink
    with mass the last is `sink_start`, the sink's temperature at the window's third sample."""
    sink_start: float | None
    """That temperature, K; None for a sink without mass."""
    covariance: FloatArray
    """Of the fitted parameters, shape (n, n), their own units."""
    fisher: FloatArray
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
    """Mean squared residual of both outputs in units of the noise variance."""
    samples: tuple[int, int]
    """Session indices of the window's first and last sample."""
    status: Status
    reason: str
    """One sentence on the status."""
    directions: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """Eigenvectors of the information in units of the parameters' scales, shape (n, n): column j belongs
    to `eigenvalues[j]`, so column 0 is the combination of parameters that the window shows least."""
    intervals: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Profile-likelihood interval (95 %) of each parameter, its own unit, shape (n, 2); an end is
    infinite where the interval is open and NaN where no fit was made."""
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

    @property
    def correlation(self) -> FloatArray:
        """Of the fitted parameters, shape (n, n)."""
        errors = self.standard_errors
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / np.outer(errors, errors), dtype=np.float64)


def match(
    window: Window,
    *,
    free: Iterable[str] = FREE,
    start: RigParameters | None = None,
    incumbent: RigParameters | None = None,
    bounds: Bounds | None = None,
    noise: Noise | None = None,
    gains: PidGains | None = None,
    driver: Driver | None = None,
    min_step: float = 2.0,
    limits: Limits | None = None,
) -> Match:
    """Fit the closed-loop twin to a window by nonlinear least squares on temperature and PWM.

    First a fit without the window's last part is tested on that part against `incumbent` (or, without
    one, against `start`); the parameters returned are then fitted to the whole window.

    Args:
        window: recorded samples; should hold two set-point levels and the way between them.
        free: names of the rig parameters to fit; the others keep their value in `start`.
        start: where the search begins.
        incumbent: parameters that stand for this regime so far.
        bounds: replace some of `BOUNDS`.
        noise: standard deviations by which the residuals are weighed.
        gains: the plant's controller.
        driver: the plant's driver.
        min_step: least movement of the set-point that excites the loop, °C.
        limits: where the gate closes.

    Raises:
        MatchingError: the names or bounds have no meaning, or the controller has another period.
        PlantError: bounds reach where no rig can be.
    """
    start, limits = start or RigParameters(), limits or Limits()
    gains = gains or PidGains(period=window.period)
    if gains.period != window.period:
        msg = (
            f"matching: the controller runs every {gains.period} s but the window's samples come every "
            f"{window.period} s; give both the same period"
        )
        raise MatchingError(msg)
    names, limited = checked_free(free, start), checked_bounds(bounds)
    fault = fault_in_signals(window, gains.limit)
    if fault:
        return _without_fit(window, names, start, Status.PLANT_FAULT_SUSPECTED, fault)
    split, missing = _split(window, min_step, limits)
    if missing:
        return _without_fit(window, names, start, Status.NO_EXCITATION, missing)
    problem = Problem(window, names, start, noise or Noise(), gains, driver or Driver(), limited)
    return _with_fit(problem, split, incumbent or start, limits)


def _split(window: Window, min_step: float, limits: Limits) -> tuple[int, str]:
    """How many samples the test fit sees, or what is missing for one."""
    excited = first_excited(window, min_step)
    if excited is None:
        return 0, f"the set-point did not move by {min_step:g} °C within the window's {len(window)} samples"
    split = max(int((1.0 - limits.held_back) * len(window)), excited + limits.least_samples)
    if len(window) - split < limits.least_samples:
        return 0, (
            f"the set-point moved at sample {window.first + excited}, too near to the window's end at "
            f"{window.last} for a fit and its test"
        )
    return split, ""


def _with_fit(problem: Problem, split: int, rival: RigParameters, limits: Limits) -> Match:
    window = problem.window
    seen = replace(problem, window=window.part(window.first, window.first + split - 1))
    starts = starts_for(problem, problem.base)
    test = solve(seen, starts)
    final = solve(problem, [test.values, starts[0]])
    known = uncertainty(problem, final)
    held = split - (len(window) - problem.temperature.size)
    tested = problem.residuals(test.values).reshape(2, -1)[:, held:]
    standing = _residuals_of(problem, seen, rival)[:, held:]
    hit, fit = on_bounds(problem, final.values), _fit(problem, final.residuals)
    evidence = Evidence(
        free=problem.free,
        values=final.values,
        standard_errors=np.sqrt(np.diag(known.covariance)),
        condition=known.condition,
        bounds_hit=hit,
        converged=final.converged,
        chi2=final.chi2,
        stretch_chi2=worst_stretch(final.residuals, limits.stretch),
        fit_y=fit.y,
        held_back_chi2=float(np.mean(np.square(tested))),
        incumbent_chi2=float(np.mean(np.square(standing))),
    )
    status, reason = judge(evidence, limits)
    return Match(
        parameters=problem.parameters_at(final.values),
        free=problem.free,
        sink_start=problem.sink_start_at(final.values),
        covariance=known.covariance,
        fisher=known.fisher,
        eigenvalues=known.eigenvalues,
        condition=known.condition,
        bounds_hit=hit,
        fit=fit,
        held_back=_fit(problem, tested),
        chi2=final.chi2,
        samples=(window.first, window.last),
        status=status,
        reason=reason,
    )


def _residuals_of(problem: Problem, seen: Problem, rival: RigParameters) -> FloatArray:
    """Residuals of given parameters on the window; their sink's unknown start is fitted to the seen part."""
    sink = None
    if rival.sink_has_mass:
        alone = replace(seen, free=(SINK_START,), base=rival)
        sink = alone.sink_start_at(solve(alone, [alone.values_of(rival)]).values)
    return problem.weigh(problem.simulate(rival, sink))


def _fit(problem: Problem, residuals: FloatArray) -> Fit:
    """NRMSE over the last samples of the window, as many as there are residuals."""
    count = residuals.shape[1]
    scales = (problem.noise.temperature, problem.noise.pwm)
    figures = []
    for measured, left, scale in zip((problem.temperature, problem.pwm), residuals, scales, strict=True):
        values = measured[-count:]
        spread = float(np.linalg.norm(values - np.mean(values)))
        figures.append(1.0 - scale * float(np.linalg.norm(left)) / spread if spread > 0 else float("nan"))
    return Fit(*figures)


def _without_fit(
    window: Window, free: tuple[str, ...], start: RigParameters, status: Status, reason: str
) -> Match:
    n = len(free)
    unknown = np.full((n, n), np.nan)
    return Match(
        parameters=start,
        free=free,
        sink_start=start.ambient if SINK_START in free else None,
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
    )
