"""Behavioral matching: the parameters with which the twin behaves like the plant in a window."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from types import MappingProxyType
from typing import Annotated, ClassVar, Final, NamedTuple

import numpy as np

from twinmatch.dynamics import FROM_PLANT_FILE, Law, LoopLaw, Parameters, Plant
from twinmatch.dynamics.movement import effect_of
from twinmatch.errors import TwinmatchError
from twinmatch.fitting.approximation import started_chains
from twinmatch.fitting.estimation import (
    FULL,
    Effort,
    Estimate,
    Uncertainty,
    on_bounds,
    solve,
    starts_for,
    uncertainty,
)
from twinmatch.fitting.excitation import (
    amount,
    movement_by_inputs,
    why_not_moved,
)
from twinmatch.fitting.gate import (
    FitEvidence,
    GateLimits,
    Status,
    first_excited,
    judge,
    undetermined,
)
from twinmatch.fitting.identifiability import Identified, identify, unidentified
from twinmatch.fitting.problem import (
    LASTING,
    Bounds,
    Noise,
    Prior,
    Problem,
    checked_free,
    checked_law,
)
from twinmatch.requirements import Among, Sized
from twinmatch.signals import FloatArray, Window


class Fit(NamedTuple):
    """NRMSE 1 − ‖measured − simulated‖/‖measured − mean‖: 1 is perfect, 0 no better than the mean; of several
    outputs or inputs their mean."""

    y: float
    """Fit of the output."""
    u: float
    """Fit of the input; NaN for a driven twin."""


_SHOWS: Final = 0.25
"""Share of a least step that a fit may be made from: what has moved so far for long says as much."""
_KNOWN: Final = 0.1
"""Relative standard error from which a parameter counts as determined before a fit is made."""
_NO_FIT = Fit(float("nan"), float("nan"))


_BY_NAME: Final = Sized("free", "its free parameters")
_BY_PAIR: Final = Sized("free", "its free parameters", square=True)
_FREE: Final = Among("free", "parameter")


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
    starts: Annotated[Mapping[str, float], _FREE]
    """Values of those states, by name; empty if the structure has none."""
    covariance: Annotated[FloatArray, _BY_PAIR] = field(metadata={"columns": -1})
    """Covariance of the fitted parameters, shape (n, n), in their own units."""
    fisher: Annotated[FloatArray, _BY_PAIR] = field(metadata={"columns": -1})
    """Information JᵀJ of the weighted residuals, shape (n, n)."""
    eigenvalues: Annotated[FloatArray, _BY_NAME]
    """Eigenvalues of the information in units of the parameters' scales, ascending, shape (n,)."""
    condition: float
    """Condition number of the scaled Jacobian."""
    bounds_hit: Annotated[tuple[str, ...], _FREE]
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
    directions: Annotated[
        FloatArray, Sized("free", "its free parameters", square=True, may_be_empty=True)
    ] = field(default_factory=lambda: np.empty((0, 0)), metadata={"columns": -1})
    """Eigenvectors of the information in units of the parameters' scales, shape (n, n): column j belongs
    to `eigenvalues[j]`, so column 0 is the combination of parameters that the window determines least."""
    intervals: Annotated[
        FloatArray, Sized("free", "its free parameters", rows=2, may_be_empty=True)
    ] = field(default_factory=lambda: np.empty((0, 2)), metadata={"columns": 2})
    """Profile-likelihood interval (95 %) of each parameter, in its own unit, shape (n, 2); an end is
    infinite where a bound of the search cuts the interval off, zero where zero is a physical limit, and NaN
    if no fit was made or it does not explain the window."""
    believed: Annotated[tuple[str, ...], _FREE] = ()
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
    def standard_errors(self) -> Annotated[FloatArray, _BY_NAME]:
        """Standard errors of the fitted parameters, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    def of_parameters(self) -> tuple[tuple[str, ...], FloatArray]:
        """Names of the fitted parameters, without fitted states, and their covariance."""
        names = tuple(name for name in self.free if name in self.parameters)
        places = [self.free.index(name) for name in names]
        return names, self.covariance[np.ix_(places, places)]


def without_fit(
    window: Window,
    free: tuple[str, ...],
    start: Parameters,
    status: Status,
    reason: str,
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


def match(
    window: Window,
    *,
    start: Parameters,
    free: Iterable[str] | None = None,
    incumbent: Parameters | None = None,
    bounds: Bounds | None = None,
    noise: Noise | None = None,
    law: LoopLaw = FROM_PLANT_FILE,
    min_step: float | None = None,
    limits: GateLimits | None = None,
    prior: Prior = MappingProxyType({}),
) -> Match:
    """Fit the twin to a window by nonlinear least squares.

    If the controller is known, the twin runs in closed loop on the window's set-points, and output and input
    are fitted. Otherwise it is driven by the recorded input, and the output is fitted.

    First a fit without the window's last part is tested on that part against `incumbent` (or, without
    one, `start`); the returned parameters are then fitted to the whole window. A parameter that the
    window does not determine is kept as near to its value in `incumbent` or `start` as the window allows.

    Args:
        window: recorded samples; should hold two levels and the transition between them. Stand-ins for lost
            samples are not fitted.
        start: plant, structure, start of the search, and values of the parameters not free.
        free: names of the parameters to fit; default: those of the structure.
        incumbent: present parameters of this regime, of any structure of the plant.
        bounds: replacements for the plant's bounds, by name of a parameter or of a state with unknown start.
        noise: standard deviations that weight the residuals; default: the plant's.
        law: that of the plant's controller, None if it is not known; default: the plant file's, at the
            window's period.
        min_step: movement of the output, in its unit, that makes a window (for a driven twin, as expected of
            its inputs); a quarter of it must show; default: the declared `least_step`.
        limits: limits of the gate.
        prior: what is known of the parameters beforehand, such as from earlier sessions.

    Raises:
        FittingError: names or bounds are invalid, or the controller has another period.
        PlantError: a bound is not a possible value of the parameter.
    """
    model = start.model
    limits = limits or GateLimits()
    law = checked_law(model, window, law)
    names = checked_free(model, free)
    problem = Problem(
        window, names, start, noise or Noise.of(model.plant), law, bounds, prior
    )
    if window.share_seen < limits.least_seen:
        reason = (
            f"only {window.share_seen:.0%} of the window's samples were received; "
            f"a match needs {limits.least_seen:.0%}"
        )
        return without_fit(
            window, problem.names, start, Status.DID_NOT_CONVERGE, reason
        )
    split, missing = _split(problem, min_step, limits)
    if missing:
        return without_fit(window, problem.names, start, Status.NO_EXCITATION, missing)
    found = _with_fit(problem, split, incumbent or start, limits)
    if incumbent is None and found.status is Status.NOT_BETTER:
        return _as_they_are(problem, found, limits)
    return found


def explaining(
    window: Window, starts: Iterable[Parameters], noise: Noise, law: Law | None
) -> list[Parameters]:
    """The starts in whose structures a fit explains the window, the most justified first.

    A single window is too short to hold a third of it back, as the choice of structure in verdicts does: for
    one or two blocks the free run of a structure that lacks something may be the better one by chance.
    The charge of a structure is the sum of the squares that its best fit leaves, divided by the length over
    which they are correlated, and for each fitted value the logarithm of the number of independent ones.
    """
    charged: list[tuple[float, Parameters]] = []
    for start in starts:
        best = usable_fit(window, start, noise, law)
        if best is not None and best.chi2 <= GateLimits().most(law):
            independent = best.residuals.size / LASTING
            charged.append(
                (
                    independent * best.chi2 + best.values.size * math.log(independent),
                    start,
                )
            )
    return [start for _, start in sorted(charged, key=itemgetter(0))]


def usable_fit(
    window: Window,
    start: Parameters,
    noise: Noise,
    law: Law | None,
    effort: Effort = FULL,
) -> Estimate | None:
    """The best fit in the structure of a start; None if none converges within the bounds."""
    problem = Problem(window, checked_free(start.model, None), start, noise, law)
    try:
        best = solve(problem, starts_for(problem, start), effort)
    except TwinmatchError:  # another structure may be too fast for these samples
        return None
    return best if best.converged and not on_bounds(problem, best.values) else None


def _split(
    problem: Problem, min_step: float | None, limits: GateLimits
) -> tuple[int, str]:
    """Number of samples for the test fit, or the reason why none can be made."""
    window = problem.window
    plant = problem.base.model.plant
    outputs = [*plant.outputs.values()]
    least = np.array(
        [
            _SHOWS * (output.least_step if min_step is None else min_step)
            for output in outputs
        ]
    )
    if problem.law is None:
        signal = "input"
        excited = _first_moved(
            movement_by_inputs(window, effect_of(plant, window.period)), least
        )
    else:
        signal = "set-point"
        outputs = outputs[: window.references.shape[1]]
        least = least[: len(outputs)]
        excited = _first_moved(window.references, least)
    if excited is None:
        if problem.law is None and np.ptp(window.inputs, axis=0).any():
            return (
                0,
                f"{why_not_moved(window, plant, least)}, in the window's {len(window)} samples",
            )
        steps = " or ".join(
            f"{step:g} {output.unit}".rstrip()
            for step, output in zip(least, outputs, strict=True)
        )
        how_far = (
            "so far that the output would show it, " if problem.law is None else ""
        )
        return (
            0,
            f"the {signal} did not move {how_far}by {steps} within the window's {len(window)} samples",
        )
    split = max(
        int((1.0 - limits.held_back) * len(window)), excited + limits.least_samples
    )
    if len(window) - split < limits.least_samples:
        return 0, (
            f"the {signal} moved at sample {window.first + excited}, too near to the window's end at "
            f"{window.last} for a fit and its test"
        )
    return split, ""


def _first_moved(moved: FloatArray, least: FloatArray) -> int | None:
    """Position of the first sample at which a signal, shape (N, o), has moved far enough, or None."""
    places = [
        first_excited(column, step) for column, step in zip(moved.T, least, strict=True)
    ]
    return min((place for place in places if place is not None), default=None)


def not_determined(
    window: Window,
    start: Parameters,
    free: Iterable[str],
    noise: Noise,
    law: Law | None,
) -> str:
    """In words, which parameters a window does not determine yet, judged by the twin's tangents at the start
    of a search; empty if it determines all."""
    problem = Problem(window, checked_free(start.model, free), start, noise, law)
    try:
        fisher = problem.evaluate(problem.values_of(start)).hessian * np.outer(
            problem.scales, problem.scales
        )
        variances = LASTING * np.diag(np.linalg.inv(fisher))
    except (TwinmatchError, np.linalg.LinAlgError):
        return "it determines nothing yet"
    determined = []
    undetermined = []
    for unknown, variance in zip(problem.unknowns, variances.tolist(), strict=True):
        if unknown.initial:
            continue
        # rounding of a singular one
        error = math.sqrt(variance) if variance > 0 else math.inf
        if error <= _KNOWN:
            determined.append(f"{unknown.name} to {error:.1%}")
        else:
            undetermined.append(unknown.name)
    if not undetermined:
        return ""
    still = ", ".join(undetermined)
    if determined:
        return f"it determines {', '.join(determined)}, not yet {still}"
    return f"it does not determine {still} yet"


def _with_fit(
    problem: Problem, split: int, rival: Parameters, limits: GateLimits
) -> Match:
    """The match of the best fit: a test fit to the samples before `split` has to predict those behind better than the
    rival."""
    window = problem.window
    fitted_part = replace(
        problem, window=window.part(window.first, window.first + split - 1)
    )
    starts = starts_for(problem, problem.base)
    test = solve(fitted_part, starts)
    best = solve(problem, [test.values, *starts])
    identified = _identified(problem, best, rival, limits)
    first_tested = split - (len(window) - problem.measured.shape[1])
    tested = problem.residuals(test.values)[:, first_tested:]
    standing = _residuals_of(problem, fitted_part, rival)[:, first_tested:]
    evidence = _evidence(problem, identified, limits, tested, standing)
    status, reason = judge(evidence, limits)
    final = identified.estimate
    of_all = identified.known
    return Match(
        parameters=problem.experiment.parameters_at(final.values),
        free=problem.names,
        starts=problem.experiment.starts_at(final.values),
        covariance=of_all.covariance,
        fisher=of_all.fisher,
        eigenvalues=of_all.eigenvalues,
        condition=of_all.condition,
        bounds_hit=evidence.bounds_hit,
        fit=_fit(problem, final.residuals),
        held_back=_fit(problem, tested),
        chi2=final.chi2,
        samples=(window.first, window.last),
        status=status,
        reason=reason,
        directions=of_all.directions,
        intervals=identified.intervals,
        believed=identified.believed,
        determined=identified.determined,
        suggestion=identified.suggestion,
    )


def _identified(
    problem: Problem, best: Estimate, rival: Parameters, limits: GateLimits
) -> Identified:
    """The best fit with what it determines; parameters that it does not are kept at the rival's values."""

    def stands(of_all: Uncertainty, values: FloatArray) -> bool:
        errors = np.sqrt(np.diag(of_all.covariance))
        if not _condition(problem, problem.names, of_all) <= limits.condition:
            return False
        loose = undetermined(problem.unknowns, values, errors, limits)
        return not loose and not on_bounds(problem, values)

    if best.converged and best.chi2 <= limits.most(problem.law):
        return identify(problem, best, rival, stands)
    return unidentified(problem, best)


def _evidence(
    problem: Problem,
    identified: Identified,
    limits: GateLimits,
    tested: FloatArray,
    standing: FloatArray,
) -> FitEvidence:
    """What the gate checks; `tested` and `standing` are the residuals of the test fit and of the rival on the
    held-back part."""
    final = identified.estimate
    kept = identified.kept
    free = [i for i, name in enumerate(problem.names) if name not in kept]
    names = [problem.names[i] for i in free]
    confused = identified.others.confused(limits.condition)
    return FitEvidence(
        free=tuple(problem.unknowns[i] for i in free),
        values=final.values[free],
        standard_errors=np.sqrt(np.diag(identified.others.covariance)),
        condition=_condition(problem, names, identified.others),
        bounds_hit=tuple(
            name for name in on_bounds(problem, final.values) if name not in kept
        ),
        converged=final.converged,
        chi2=final.chi2,
        held_back_chi2=problem.mean_square(tested),
        incumbent_chi2=problem.mean_square(standing),
        kept=_kept_sentence(problem, identified),
        most=limits.most(problem.law),
        confused=tuple(names[place] for place in confused),
        still=_still(problem.window, problem.base.model.plant),
    )


def _as_they_are(problem: Problem, found: Match, limits: GateLimits) -> Match:
    """The match with the start's own values, which forecast better than what was found: they are the better twin.

    What was found, if they do not explain the window.
    """
    values = problem.values_of(problem.base)
    values[len(problem.free) :] = _starts_of(problem, problem.base)
    estimate = Estimate(problem, values, converged=True)
    if not estimate.chi2 <= limits.most(problem.law):
        return found
    known = uncertainty(problem, estimate)
    reason = (
        f"the values of the plant file explain the window down to {estimate.chi2:.3g} times the noise variance, "
        f"and are kept: {found.reason}"
    )
    return replace(
        found,
        parameters=problem.base,
        starts=problem.experiment.starts_at(values),
        covariance=known.covariance,
        fisher=known.fisher,
        eigenvalues=known.eigenvalues,
        condition=known.condition,
        directions=known.directions,
        fit=_fit(problem, estimate.residuals),
        held_back=_NO_FIT,
        chi2=estimate.chi2,
        status=Status.ACCEPTED,
        reason=reason,
        intervals=np.full((len(problem.names), 2), np.nan),
        believed=(),
        determined="",
        suggestion="",
    )


def _condition(problem: Problem, names: Sequence[str], known: Uncertainty) -> float:
    """Condition number of the unknowns with these names that the gate judges.

    What a dead time had on its way at the start is left out: a window says as much of it when it is short as when
    it is long, while it says ever more of the others, so that their ratio grows without anything being wrong.
    """
    chains = started_chains(problem)
    return known.condition_of([i for i, name in enumerate(names) if name not in chains])


def _still(window: Window, plant: type[Plant]) -> str:
    """Which inputs stood still all the time, in words; empty if none did."""
    stood = [
        f"{name} stood at {amount(level, drive.unit)}"
        for (name, drive), level, moved in zip(
            plant.drives.items(),
            window.inputs[0].tolist(),
            np.ptp(window.inputs, axis=0).tolist(),
            strict=True,
        )
        if moved == 0.0
    ]
    return " and ".join(stood)


def _kept_sentence(problem: Problem, found: Identified) -> str:
    """Each kept parameter with its value and interval; empty if none was."""
    kept = []
    for name in found.kept:
        place = problem.names.index(name)
        low, high = found.intervals[place]
        value = found.estimate.values[place]
        kept.append(f"{name} at {value:.3g} (possible: {low:.2g} to {high:.2g})")
    return ", ".join(kept)


def _residuals_of(problem: Problem, seen: Problem, rival: Parameters) -> FloatArray:
    """Residuals of given parameters on the window, with initial states fitted to the part before the test."""
    starts = _starts_of(seen, rival)
    return replace(problem, free=(), base=rival).residuals(starts)


def _starts_of(problem: Problem, given: Parameters) -> FloatArray:
    """The unknown initial states that fit a window best with given parameters, shape (s,)."""
    alone = replace(problem, free=(), base=given)
    starts = alone.values_of(given)
    return solve(alone, [starts]).values if starts.size else starts


def _fit(problem: Problem, residuals: FloatArray) -> Fit:
    """NRMSE over the last samples of the window, as many as there are residuals."""
    count = residuals.shape[1]
    figures = []
    for measured, residual, weight in zip(
        problem.measured, residuals, problem.weights[:, 0], strict=True
    ):
        values = measured[-count:]
        spread = float(np.linalg.norm(values - np.mean(values)))
        fit = (
            1.0 - np.linalg.norm(residual) / weight / spread if spread > 0 else math.nan
        )
        figures.append(float(fit))
    n_outputs = len(problem.base.model.plant.outputs)
    return Fit(_mean_or_nan(figures[:n_outputs]), _mean_or_nan(figures[n_outputs:]))


def _mean_or_nan(figures: Sequence[float]) -> float:
    return float(np.mean(figures)) if figures else math.nan
