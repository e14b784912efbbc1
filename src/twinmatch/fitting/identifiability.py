"""Identifiability: which parameters and combinations a window determines, and the step that tells more.

A parameter is believed if the data alone bound its interval on both sides, to a factor of two or less. A
parameter that is not believed is not necessarily wrong: the twin may predict well along the whole interval.
So a fit that leaves one parameter open, down to zero, may still be used, with that parameter kept as near to
its previous value as the interval allows and the others fitted again. Where combinations have no effect at all,
as those of the gain of an input that stood still and of a rest, one parameter of each is kept so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.fitting.approximation import shift_by_dead_times
from twinmatch.fitting.estimation import (
    Estimate,
    Uncertainty,
    on_bounds,
    profile_intervals,
    solve,
    starts_for,
    uncertainty,
)
from twinmatch.fitting.problem import Problem
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Window

_WIDEST = 2.0
"""Largest ratio of the ends of a believed parameter's interval; where zero is arbitrary, the interval must
not exceed the parameter's scale. A ratio does not depend on where in the valley the estimate lies."""
_TOLD_SHIFT = 0.02
"""Least shift of an estimate that is reported, as a share of its size."""
_TIGHTER = 3.0
"""Factor by which a ratio of two parameters must be known better than each alone to be reported."""


class _StepSuggestion(Rule):
    """Which step of the set-point is suggested: the smallest of a few over the declared range that is nearly
    as good as the best. The next window is this one's last regime and the one after the step."""

    levels: int = 8
    """Number of set-points considered, over the range that the plant declares for them."""
    least_step: float = 0.5
    """Smallest suggested step, as a share of the distance between two of them."""
    lead: int = 20
    """Samples of the window kept before its last step."""
    after: int = 240
    """Samples simulated after the new step."""
    moved: float = 20.0
    """Change of the set-point that counts as a step, in units of the output's noise."""
    reached: float = 10.0
    """Largest final distance of the output from the set-point, in the same units."""
    worth: float = 1.25
    """Least improvement worth a suggestion."""
    nearly: float = 0.9
    """Share of the best improvement that the smallest sufficient step must reach."""


_SUGGESTION: Final = _StepSuggestion()


def suggest_step(
    problem: Problem, values: FloatArray, fisher: FloatArray, name: str
) -> str:
    """A sentence with the step that would best determine the combination that this window determines least,
    and how much better parameter `name` would be known; empty if no step would help much, or if the loop
    is not known.

    The next window would hold this one's last regime and the one after the step. For each step it is
    simulated with the fitted twin, and its information JᵀJ is compared with that of this window.
    """
    plant = problem.base.model.plant
    before = _scaled_inverse(problem, fisher)
    if before is None or problem.law is None or len(plant.outputs) > 1:
        return ""
    least_known = np.linalg.eigh(fisher * np.outer(problem.scales, problem.scales))[1][
        :, 0
    ]
    place = problem.names.index(name)
    present = float(problem.window.reference[-1])
    levels = np.linspace(
        *(plant.output.set_points or plant.output.span), _SUGGESTION.levels
    )
    least_step = _SUGGESTION.least_step * (levels[1] - levels[0])
    last_part = _last_part(problem)
    steps: list[_StepGain] = []
    for level in sorted(levels.tolist(), key=lambda level: abs(level - present)):
        if abs(level - present) >= least_step:
            after = _after_step(problem, values, last_part, level)
            if after is not None:
                variance_before = least_known @ before @ least_known
                variance_after = least_known @ after @ least_known
                of_direction = float(np.sqrt(variance_before / variance_after))
                of_name = float(np.sqrt(before[place, place] / after[place, place]))
                steps.append(_StepGain(level, of_direction, of_name))
    best = max((step.of_direction for step in steps), default=0.0)
    for step in steps:
        if (
            step.of_direction >= _SUGGESTION.nearly * best
            and step.of_name >= _SUGGESTION.worth
        ):
            times = (
                f"{step.of_name:.0f}" if step.of_name >= 2.5 else f"{step.of_name:.1f}"
            )
            way = f"{present:g} to {step.level:.4g} {plant.output.unit}"
            return (
                f"a step from {way} would determine {name} about {times} times better"
            )
    return ""


class _StepGain(NamedTuple):
    """How many times better a step would determine something."""

    level: float
    """The set-point after it."""
    of_direction: float
    """The combination that is known least."""
    of_name: float
    """The parameter in question."""


def _last_part(problem: Problem) -> Window:
    """The window's last regime, from a little before the step to it."""
    window = problem.window
    noise = problem.base.model.plant.output.noise
    steps = np.flatnonzero(
        np.abs(np.diff(window.reference)) >= _SUGGESTION.moved * noise
    )
    first = max(int(steps[-1]) + 1 - _SUGGESTION.lead, 0) if steps.size else 0
    return window.part(window.first + first, window.last)


def _after_step(
    problem: Problem, values: FloatArray, last_part: Window, level: float
) -> FloatArray | None:
    """Scaled covariance from the next window, which begins with the last part of this one; None if the output
    does not reach the set-point."""
    noise = problem.base.model.plant.output.noise
    ahead = Window(
        np.full(_SUGGESTION.after, level),
        np.full(_SUGGESTION.after, last_part.output[-1]),
        np.zeros(_SUGGESTION.after),
        first=last_part.last + 1,
        period=last_part.period,
        disturbances=np.repeat(last_part.disturbances[-1:], _SUGGESTION.after, axis=0),
    )
    next_one = replace(problem, window=last_part.joined(ahead))
    response = next_one.experiment.simulate(values)
    if not abs(response.output[-1] - level) <= _SUGGESTION.reached * noise:
        return None
    return _scaled_inverse(problem, next_one.evaluate(values).hessian)


def _scaled_inverse(problem: Problem, fisher: FloatArray) -> FloatArray | None:
    """Covariance for white noise in units of the scales; None if a direction has no effect at all."""
    scaled = fisher * np.outer(problem.scales, problem.scales)
    eigenvalues = np.linalg.eigvalsh(scaled)
    if not eigenvalues[0] > np.finfo(np.float64).eps * eigenvalues[-1]:
        return None
    return np.asarray(np.linalg.inv(scaled), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Identified:
    """An estimate, possibly with parameters kept, and its uncertainty."""

    estimate: Estimate
    known: Uncertainty
    """Uncertainty of all free parameters."""
    others: Uncertainty
    """Uncertainty of the others if the kept ones are known."""
    kept: tuple[str, ...] = ()
    """Names of the kept parameters."""
    intervals: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    believed: tuple[str, ...] = ()
    determined: str = ""
    suggestion: str = ""


def unidentified(problem: Problem, found: Estimate) -> Identified:
    """The result for an estimate that does not explain the window: its parameters mean nothing."""
    of_all = uncertainty(problem, found)
    return Identified(
        found, of_all, of_all, intervals=np.full((len(problem.names), 2), np.nan)
    )


def identify(
    problem: Problem,
    found: Estimate,
    standing: Parameters,
    stands: Callable[[Uncertainty, FloatArray], bool],
) -> Identified:
    """Find the parameters that the window determines.

    If a fit is not acceptable as it is (`stands`, called with its uncertainty and values), its least
    determined parameter is kept at its previous value, or one parameter of each combination without any
    effect, unless a parameter ended on a bound other than zero: such a fit is refused anyway.
    """
    of_all = uncertainty(problem, found)
    intervals = profile_intervals(problem, found.values, of_all.covariance_of_shown)
    shift = shift_by_dead_times(problem, found.values)
    intervals = _with_shift(problem, intervals, shift)
    widths = _widths(problem, intervals)
    believed = tuple(
        n for n, width in zip(problem.names, widths, strict=True) if width <= 1.0
    )
    final = found
    kept: list[int] = []
    if not stands(of_all, found.values):
        kept = _to_keep(problem, found.values, widths, of_all)
    if kept:
        final = _keep(problem, found, kept, intervals, standing)
        of_all = uncertainty(problem, final)
    places = [i for i in range(len(problem.names)) if i not in kept]
    suggestion = ""
    if len(believed) < len(problem.names):
        least = problem.names[int(np.argmax(widths))]
        suggestion = suggest_step(problem, final.values, of_all.fisher, least)
    return Identified(
        estimate=final,
        known=of_all,
        others=of_all.given(places),
        kept=tuple(problem.names[i] for i in kept),
        intervals=intervals,
        believed=believed,
        determined=_sentence_on(
            problem, final.values, of_all.covariance, intervals, believed
        )
        + _sentence_on_shift(problem, found.values, shift, of_all.covariance),
        suggestion=suggestion,
    )


def _with_shift(
    problem: Problem, intervals: FloatArray, shift: FloatArray
) -> FloatArray:
    """The intervals, shape (n, 2), with all values in them as they would be without a shift, shape (n,)."""
    low = intervals[:, 0] - np.maximum(shift, 0.0)
    high = intervals[:, 1] - np.minimum(shift, 0.0)
    low = np.where(low > problem.lower, low, -np.inf)
    high = np.where(high < problem.upper, high, np.inf)
    low = np.where(np.isneginf(low) & (problem.lower == 0.0), 0.0, low)
    is_shifted = np.isfinite(intervals) & (shift != 0.0)[:, None]
    return np.where(is_shifted, np.column_stack([low, high]), intervals)


def _sentence_on_shift(
    problem: Problem, values: FloatArray, shift: FloatArray, covariance: FloatArray
) -> str:
    """A clause on the parameter that a dead time's approximation shifts most, in its size.

    It is empty if the noise hides all shifts, or none is large.
    """
    errors = np.sqrt(np.diag(covariance))
    place = -1
    largest = _TOLD_SHIFT
    for i in range(len(problem.free)):
        unknown = problem.unknowns[i]
        size = abs(values[i]) if unknown.relative else unknown.scale
        share = abs(shift[i]) / size if size > 0.0 else 0.0
        if share > largest and abs(shift[i]) > errors[i]:
            place = i
            largest = share
    if place < 0:
        return ""
    way = "low" if shift[place] < 0.0 else "high"
    return (
        f"; {problem.free[place]} ({values[place]:.3g}) is about {abs(shift[place]):.2g} too {way}, as the dead "
        "time is approximated, which the intervals allow for; to know more, rest it before the first switching"
    )


def _to_keep(
    problem: Problem, values: FloatArray, widths: list[float], known: Uncertainty
) -> list[int]:
    """Places of the parameters without which nothing is hidden; else of the one with the widest interval, of
    equals the first; none if one ended on a bound."""
    for name in on_bounds(problem, values):
        if values[problem.names.index(name)] != 0.0:
            return []
    n_parameters = len(problem.free)
    place = int(np.argmax(widths[:n_parameters]))
    if widths[place] <= 1.0 or len(widths) == 1:
        return []
    # an offset can take what the value kept of a gain is wrong by
    gains = [i for i, unknown in enumerate(problem.unknowns) if unknown.relative]
    held = known.hidden(gains).held
    of_parameters = all(i < n_parameters for i in held)
    return sorted(held) if held and of_parameters else [place]


def _widths(problem: Problem, intervals: FloatArray) -> list[float]:
    """Width of each interval relative to the limit of belief, infinite if the data leave a side open."""
    widths = []
    for unknown, (low, high) in zip(problem.unknowns, intervals.tolist(), strict=True):
        is_closed = (
            math.isfinite(low) and math.isfinite(high) and low > unknown.bounds[0]
        )
        if not is_closed:
            widths.append(math.inf)
        elif unknown.relative:
            widths.append(math.log(high / low) / math.log(_WIDEST))
        else:
            widths.append((high - low) / unknown.scale)
    return widths


def _keep(
    problem: Problem,
    found: Estimate,
    places: list[int],
    intervals: FloatArray,
    standing: Parameters,
) -> Estimate:
    """The fit with some parameters kept as near to their previous values as their intervals allow."""
    kept = {}
    for place in places:
        name = problem.names[place]
        low, high = np.clip(intervals[place], *problem.unknowns[place].bounds)
        kept[name] = float(np.clip(standing.get(name, problem.base[name]), low, high))
    reduced = replace(
        problem,
        free=tuple(n for n in problem.free if n not in kept),
        base=problem.experiment.parameters_at(found.values).replace(**kept),
    )
    others = [i for i in range(found.values.size) if i not in places]
    refit = solve(reduced, [found.values[others], *starts_for(reduced, reduced.base)])
    values = np.empty_like(found.values)
    values[places] = [*kept.values()]
    values[others] = refit.values
    return Estimate(problem, values, refit.converged)


def _sentence_on(
    problem: Problem,
    values: FloatArray,
    covariance: FloatArray,
    intervals: FloatArray,
    believed: tuple[str, ...],
) -> str:
    """A sentence on the parameters or combination that the window determines, and those left open (95 %)."""
    if not np.isfinite(covariance).all():
        return "some combination of the free parameters does not show in this window at all"
    determined = []
    undetermined = []
    for name, interval in zip(problem.names, intervals, strict=True):
        words = f"{name} ({_range(interval)})"
        if name in believed:
            determined.append(words)
        else:
            undetermined.append(words)
    text = "the window determines no parameter alone"
    if determined:
        text = f"the window determines {_word_list(determined)}"
    ratio = _best_ratio(problem, values, covariance)
    if ratio:
        text += f"; best known is the ratio {ratio}"
    return f"{text}; left open: {_word_list(undetermined)}" if undetermined else text


def _best_ratio(problem: Problem, values: FloatArray, covariance: FloatArray) -> str:
    """The best known ratio of two parameters, if known far better than each alone."""
    places = [
        i
        for i, unknown in enumerate(problem.unknowns)
        if unknown.relative and values[i] > 0.0
    ]
    best = math.inf
    text = ""
    for i, j in combinations(places, 2):
        pair = [i, j]
        relative = covariance[np.ix_(pair, pair)] / np.outer(values[pair], values[pair])
        first = relative[0, 0]
        second = relative[1, 1]
        error = math.sqrt(max(first + second - 2.0 * relative[0, 1], 0.0))
        if error < best and _TIGHTER * error < math.sqrt(min(first, second)):
            best = error
            text = f"{problem.names[i]} / {problem.names[j]} (± {200 * error:.2g} %)"
    return text


def _range(interval: FloatArray) -> str:
    low, high = interval.tolist()
    if math.isnan(low) or (math.isinf(low) and math.isinf(high)):
        return "any value"
    if math.isinf(high):
        return f"{low:.3g} or more"
    return f"{high:.3g} or less" if math.isinf(low) else f"{low:.3g} to {high:.3g}"


def _word_list(words: list[str]) -> str:
    return (
        " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
    )
