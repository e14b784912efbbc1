"""Which parameters, and which combinations of them, a window determines.

A parameter is believed when the data alone close its interval on both sides, to a factor of two or less.
What is not believed is not thereby wrong: the twin may predict well along the whole interval. So a fit
that leaves one parameter quite open, down to zero, may still be used, with that parameter kept as near to
what stood before as the interval allows and the others fitted anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.matching.estimation import Estimate, Uncertainty, on_bounds, solve, starts_for, uncertainty
from twinmatch.matching.excitation import suggest_step
from twinmatch.matching.problem import Problem
from twinmatch.matching.profile import profile_intervals
from twinmatch.signals import FloatArray

__all__ = ["Identified", "identify", "unidentified"]

_WIDEST = 2.0
"""Ratio of the ends of a believed parameter's interval; where zero means nothing, the typical difference
of the parameter takes its place. A ratio does not depend on where in the valley the estimate lies."""
_TIGHTER = 3.0
"""How much better than each alone a ratio of two parameters must be known to be worth naming."""


@dataclass(frozen=True, eq=False)
class Identified:
    """An estimate, perhaps with one parameter kept, and what the window says about it."""

    estimate: Estimate
    known: Uncertainty
    """Of all free parameters."""
    others: Uncertainty
    """Of all but the kept one, this being known."""
    kept: str = ""
    """Name of the parameter that was kept, or nothing."""
    intervals: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    believed: tuple[str, ...] = ()
    determined: str = ""
    suggestion: str = ""


def unidentified(problem: Problem, found: Estimate) -> Identified:
    """An estimate whose parameters mean nothing, because it does not explain the window."""
    known = uncertainty(problem, found)
    return Identified(found, known, known, intervals=np.full((len(problem.names), 2), np.nan))


def identify(
    problem: Problem,
    found: Estimate,
    standing: Parameters,
    stands: Callable[[Uncertainty, FloatArray], bool],
) -> Identified:
    """Ask the window which parameters it determines.

    A fit that does not stand by itself (`stands` is asked with its uncertainty and values) gets its least
    determined parameter kept. One that ended on a bound other than zero does not: it is refused for that.
    """
    known = uncertainty(problem, found)
    intervals = profile_intervals(problem, found.values, known.covariance)
    widths = _widths(problem, intervals)
    believed = tuple(n for n, width in zip(problem.names, widths, strict=True) if width <= 1.0)
    final, kept = found, ""
    if not stands(known, found.values):
        kept = _to_keep(problem, found.values, widths)
    if kept:
        interval = intervals[problem.names.index(kept)]
        before = standing.get(kept, problem.base[kept])
        final = _keep(problem, found, kept, interval, before)
        known = uncertainty(problem, final)
    places = [i for i, name in enumerate(problem.names) if name != kept]
    suggestion = ""
    if len(believed) < len(problem.names):
        least = problem.names[int(np.argmax(widths))]
        suggestion = suggest_step(problem, final.values, known.fisher, least)
    return Identified(
        estimate=final,
        known=known,
        others=known.given(places),
        kept=kept,
        intervals=intervals,
        believed=believed,
        determined=_determined(problem, final.values, known.covariance, intervals, believed),
        suggestion=suggestion,
    )


def _to_keep(problem: Problem, values: FloatArray, widths: list[float]) -> str:
    """Name of the parameter with the widest interval, of equals the first; none if a bound stopped one."""
    stopped = [n for n in on_bounds(problem, values) if values[problem.names.index(n)] != 0.0]
    of_parameters = widths[: len(problem.free)]
    place = int(np.argmax(of_parameters))
    return "" if stopped or of_parameters[place] <= 1.0 or len(widths) == 1 else problem.free[place]


def _widths(problem: Problem, intervals: FloatArray) -> list[float]:
    """Width of each interval in units of what is believed, infinite if the data leave a side open."""
    widths = []
    for unknown, (low, high) in zip(problem.unknowns, intervals.tolist(), strict=True):
        closed = math.isfinite(low) and math.isfinite(high) and low > unknown.bounds[0]
        if not unknown.relative:
            width = (high - low) / unknown.scale
        else:
            width = math.log(high / low) / math.log(_WIDEST) if closed else math.inf
        widths.append(width if closed else math.inf)
    return widths


def _keep(problem: Problem, found: Estimate, name: str, interval: FloatArray, standing: float) -> Estimate:
    """The fit with one parameter kept as near to what stands as its interval (low, high) allows."""
    place = problem.names.index(name)
    low, high = np.clip(interval, *problem.unknowns[place].bounds)
    value = float(np.clip(standing, low, high))
    others = replace(
        problem,
        free=tuple(n for n in problem.free if n != name),
        base=problem.parameters_at(found.values).replace(**{name: value}),
    )
    rest = solve(others, [np.delete(found.values, place), *starts_for(others, others.base)])
    return Estimate(problem, np.insert(rest.values, place, value), rest.converged)


def _determined(
    problem: Problem,
    values: FloatArray,
    covariance: FloatArray,
    intervals: FloatArray,
    believed: tuple[str, ...],
) -> str:
    """Which parameters or combination the window determines, and which it leaves open (95 %)."""
    if not np.isfinite(covariance).all():
        return "some combination of the free parameters does not show in this window at all"
    known = [f"{n} ({_range(intervals[problem.names.index(n)])})" for n in problem.names if n in believed]
    left = [f"{n} ({_range(intervals[problem.names.index(n)])})" for n in problem.names if n not in believed]
    text = f"the window determines {_listed(known)}" if known else "the window determines no parameter alone"
    ratio = _best_ratio(problem, values, covariance)
    if ratio:
        text += f"; best known is the ratio {ratio}"
    return f"{text}; left open: {_listed(left)}" if left else text


def _best_ratio(problem: Problem, values: FloatArray, covariance: FloatArray) -> str:
    """The ratio of two parameters known best, if far better than each alone."""
    places = [i for i, unknown in enumerate(problem.unknowns) if unknown.relative and values[i] > 0.0]
    best, text = math.inf, ""
    for i, j in combinations(places, 2):
        pair = [i, j]
        relative = covariance[np.ix_(pair, pair)] / np.outer(values[pair], values[pair])
        error = math.sqrt(max(relative[0, 0] + relative[1, 1] - 2.0 * relative[0, 1], 0.0))
        if error < best and _TIGHTER * error < math.sqrt(min(relative[0, 0], relative[1, 1])):
            best, text = error, f"{problem.names[i]} / {problem.names[j]} (± {200 * error:.2g} %)"
    return text


def _range(interval: FloatArray) -> str:
    low, high = interval.tolist()
    if math.isnan(low) or (math.isinf(low) and math.isinf(high)):
        return "any value"
    if math.isinf(high):
        return f"{low:.3g} or more"
    return f"{high:.3g} or less" if math.isinf(low) else f"{low:.3g} to {high:.3g}"


def _listed(words: list[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
