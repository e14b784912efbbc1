"""Behavioral matching: the parameters with which the twin behaves like the plant in a window."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from twinmatch.dynamics import FILED, Closing, Parameters
from twinmatch.fitting.bounds import Bounds, checked_free, unknown_parameters
from twinmatch.fitting.estimation import Uncertainty, on_bounds, solve, starts_for
from twinmatch.fitting.gate import (
    Evidence,
    Limits,
    Status,
    first_excited,
    judge,
    undetermined,
)
from twinmatch.fitting.identifiability import Identified, identify, unidentified
from twinmatch.fitting.noise import Noise
from twinmatch.fitting.problem import Problem, checked_gains
from twinmatch.fitting.result import Fit, Match, without_fit
from twinmatch.signals import FloatArray, Window

__all__ = ["match"]


def match(
    window: Window,
    *,
    start: Parameters,
    free: Iterable[str] | None = None,
    incumbent: Parameters | None = None,
    bounds: Bounds | None = None,
    noise: Noise | None = None,
    gains: Closing = FILED,
    min_step: float | None = None,
    limits: Limits | None = None,
) -> Match:
    """Fit the twin to a window by nonlinear least squares.

    If the controller is known, the twin runs in closed loop on the window's set-points, and output and input
    are fitted. Otherwise it is driven by the recorded input, and the output is fitted.

    First a fit without the window's last part is tested on that part against `incumbent` (or, without
    one, `start`); the returned parameters are then fitted to the whole window. A parameter that the
    window does not determine is kept as near to its value in `incumbent` or `start` as the window allows.

    Args:
        window: recorded samples; should hold two levels and the transition between them.
        start: plant, structure, start of the search, and values of the parameters not free.
        free: names of the parameters to fit; default: those of the structure.
        incumbent: present parameters of this regime, of any structure of the plant.
        bounds: replacements for the plant's bounds, by name of a parameter or of a state with unknown start.
        noise: standard deviations that weight the residuals; default: the plant's.
        gains: the plant's controller, None if it is not known; default: the plant file's, at the window's
            period.
        min_step: least step of the set-point (for a driven twin, of the input) that excites the plant, in its
            unit; default: the declared `least_step`.
        limits: limits of the gate.

    Raises:
        MatchingError: names or bounds are invalid, or the controller has another period.
        PlantError: a bound is not a possible value of the parameter.
    """
    model, limits = start.model, limits or Limits()
    gains = checked_gains(model, window, gains)
    names = checked_free(model, free)
    unknown_parameters(model, names, bounds)
    problem = Problem(window, names, start, noise or Noise.of(model.plant), gains, bounds)
    split, missing = _split(problem, min_step, limits)
    if missing:
        return without_fit(window, problem.names, start, Status.NO_EXCITATION, missing)
    return _with_fit(problem, split, incumbent or start, limits)


def _split(problem: Problem, min_step: float | None, limits: Limits) -> tuple[int, str]:
    """Number of samples for the test fit, or the reason why none can be made."""
    window, plant = problem.window, problem.base.model.plant
    what, signal, unit, usual = "set-point", window.reference, plant.output.unit, plant.output.least_step
    if problem.gains is None:
        what, signal, unit, usual = "input", window.input, plant.drive.unit, plant.drive.least_step
    least = usual if min_step is None else min_step
    excited = first_excited(signal, least)
    if excited is None:
        return 0, f"the {what} did not move by {least:g} {unit} within the window's {len(window)} samples"
    split = max(int((1.0 - limits.held_back) * len(window)), excited + limits.least_samples)
    if len(window) - split < limits.least_samples:
        return 0, (
            f"the {what} moved at sample {window.first + excited}, too near to the window's end at "
            f"{window.last} for a fit and its test"
        )
    return split, ""


def _with_fit(problem: Problem, split: int, rival: Parameters, limits: Limits) -> Match:
    window = problem.window
    seen = replace(problem, window=window.part(window.first, window.first + split - 1))
    starts = starts_for(problem, problem.base)
    test = solve(seen, starts)
    best = solve(problem, [test.values, *starts])
    explained = best.converged and best.chi2 <= limits.chi2

    def stands(known: Uncertainty, values: FloatArray) -> bool:
        errors = np.sqrt(np.diag(known.covariance))
        loose = undetermined(problem.unknowns, values, errors, known.condition, limits)
        return not loose and not on_bounds(problem, values)

    found = identify(problem, best, rival, stands) if explained else unidentified(problem, best)
    held = split - (len(window) - problem.measured.shape[1])
    tested = problem.residuals(test.values).reshape(problem.outputs, -1)[:, held:]
    standing = _residuals_of(problem, seen, rival)[:, held:]
    final, known, fit = found.estimate, found.known, _fit(problem, found.estimate.residuals)
    free = [i for i, name in enumerate(problem.names) if name != found.kept]
    bounds_hit = tuple(n for n in on_bounds(problem, final.values) if n != found.kept)
    evidence = Evidence(
        free=tuple(problem.unknowns[i] for i in free),
        values=final.values[free],
        standard_errors=np.sqrt(np.diag(found.others.covariance)),
        condition=found.others.condition,
        bounds_hit=bounds_hit,
        converged=final.converged,
        chi2=final.chi2,
        held_back_chi2=float(np.mean(np.square(tested))),
        incumbent_chi2=float(np.mean(np.square(standing))),
        kept=_kept_sentence(problem, found),
    )
    status, reason = judge(evidence, limits)
    return Match(
        parameters=problem.parameters_at(final.values),
        free=problem.names,
        starts=problem.starts_at(final.values),
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


def _kept_sentence(problem: Problem, found: Identified) -> str:
    if not found.kept:
        return ""
    place = problem.names.index(found.kept)
    low, high = found.intervals[place]
    return f"{found.kept} at {found.estimate.values[place]:.3g} (possible: {low:.2g} to {high:.2g})"


def _residuals_of(problem: Problem, seen: Problem, rival: Parameters) -> FloatArray:
    """Residuals of given parameters on the window, with initial states fitted to the part before the test."""
    alone = replace(seen, free=(), base=rival)
    values = alone.values_of(rival)
    if values.size:
        values = solve(alone, [values]).values
    whole = replace(problem, free=(), base=rival)
    return whole.weigh(whole.experiment.simulate(values))


def _fit(problem: Problem, residuals: FloatArray) -> Fit:
    """NRMSE over the last samples of the window, as many as there are residuals."""
    count = residuals.shape[1]
    figures = []
    for measured, left, weight in zip(problem.measured, residuals, problem.weights[:, 0], strict=True):
        values = measured[-count:]
        spread = float(np.linalg.norm(values - np.mean(values)))
        found = 1.0 - np.linalg.norm(left) / weight / spread if spread > 0 else math.nan
        figures.append(float(found))
    return Fit(*figures, *[float("nan")] * (2 - len(figures)))
