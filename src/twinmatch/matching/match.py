"""Behavioral matching: the rig parameters that make the twin behave as the plant did in a window."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from twinmatch.matching.bounds import (
    SINK_START,
    Bounds,
    MatchingError,
    checked_bounds,
    checked_free,
)
from twinmatch.matching.estimation import Uncertainty, on_bounds, solve, starts_for
from twinmatch.matching.gate import (
    Evidence,
    Limits,
    Status,
    first_excited,
    judge,
    undetermined,
    worst_stretch,
)
from twinmatch.matching.health import fault_in_signals
from twinmatch.matching.identifiability import Identified, identify, unidentified
from twinmatch.matching.problem import Noise, Problem
from twinmatch.matching.result import Fit, Match, without_fit
from twinmatch.plant import Driver, PidGains, RigParameters
from twinmatch.signals import FloatArray, Window

__all__ = ["FREE", "match"]

FREE = ("seebeck", "conductance", "heat_capacity")
"""What the paper matches."""


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
    one, against `start`); the parameters returned are then fitted to the whole window. One that the
    window leaves quite open is kept as near to its value in `incumbent` or `start` as the window allows.

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
        return without_fit(window, names, start, Status.PLANT_FAULT_SUSPECTED, fault)
    split, missing = _split(window, min_step, limits)
    if missing:
        return without_fit(window, names, start, Status.NO_EXCITATION, missing)
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
    best = solve(problem, [test.values, *starts])
    explained = best.converged and best.chi2 <= limits.chi2

    def stands(known: Uncertainty, values: FloatArray) -> bool:
        errors = np.sqrt(np.diag(known.covariance))
        loose = undetermined(problem.free, values, errors, known.condition, limits)
        return not loose and not on_bounds(problem, values)

    found = identify(problem, best, rival, stands) if explained else unidentified(problem, best)
    held = split - (len(window) - problem.output.size)
    tested = problem.residuals(test.values).reshape(2, -1)[:, held:]
    standing = _residuals_of(problem, seen, rival)[:, held:]
    final, known, fit = found.estimate, found.known, _fit(problem, found.estimate.residuals)
    free = [i for i, name in enumerate(problem.free) if name != found.kept]
    bounds_hit = tuple(n for n in on_bounds(problem, final.values) if n != found.kept)
    evidence = Evidence(
        free=tuple(problem.free[i] for i in free),
        values=final.values[free],
        standard_errors=np.sqrt(np.diag(found.others.covariance)),
        condition=found.others.condition,
        bounds_hit=bounds_hit,
        converged=final.converged,
        chi2=final.chi2,
        stretch_chi2=worst_stretch(final.residuals, limits.stretch),
        fit_y=fit.y,
        held_back_chi2=float(np.mean(np.square(tested))),
        incumbent_chi2=float(np.mean(np.square(standing))),
        kept=_kept_words(problem, found),
    )
    sink = problem.sink_start_at(final.values)
    status, reason = judge(evidence, limits)
    return Match(
        parameters=problem.parameters_at(final.values),
        free=problem.free,
        starts={} if sink is None else {"sink": sink},
        covariance=known.covariance,
        fisher=known.fisher,
        eigenvalues=known.eigenvalues,
        condition=known.condition,
        bounds_hit=bounds_hit,
        fit=fit,
        held_back=_fit(problem, tested),
        chi2=final.chi2,
        samples=(window.first, window.last),
        status=status,
        reason=reason,
        directions=known.directions,
        intervals=found.intervals,
        believed=found.believed,
        determined=found.determined,
        suggestion=found.suggestion,
    )


def _kept_words(problem: Problem, found: Identified) -> str:
    if not found.kept:
        return ""
    place = problem.free.index(found.kept)
    low, high = found.intervals[place]
    return (
        f"{found.kept} at {found.estimate.values[place]:.3g} (anything from {low:.2g} to {high:.2g} will do)"
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
    scales = (problem.noise.output, problem.noise.input)
    figures = []
    for measured, left, scale in zip((problem.output, problem.input), residuals, scales, strict=True):
        values = measured[-count:]
        spread = float(np.linalg.norm(values - np.mean(values)))
        figures.append(1.0 - scale * float(np.linalg.norm(left)) / spread if spread > 0 else float("nan"))
    return Fit(*figures)
