"""The set-point step that would determine what a window left open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinmatch.fitting.problem import Problem
from twinmatch.signals import FloatArray, Window

__all__ = ["suggest_step"]

_LEVELS = 8
"""Number of set-points considered, over the range that the plant declares for them."""
_LEAST_STEP = 0.5
"""Smallest suggested step, as a share of the distance between two of them."""
_LEAD, _AFTER = 20, 240
"""Samples of the window kept before its last step, and samples simulated after the new one."""
_MOVED = 20.0
"""Change of the set-point that counts as a step, in units of the output's noise."""
_REACHED = 10.0
"""Largest final distance of the output from the set-point, in the same units."""
_WORTH = 1.25
"""Least improvement worth a suggestion."""
_NEARLY = 0.9
"""Share of the best improvement that the smallest sufficient step must reach."""


def suggest_step(problem: Problem, values: FloatArray, fisher: FloatArray, name: str) -> str:
    """A sentence with the step that would best determine the combination that this window determines least,
    and how much better parameter `name` would be known; empty if no step would help much, or if the loop
    is not known.

    The next window would hold this one's last regime and the one after the step. For each step it is
    simulated with the fitted twin, and its information JᵀJ is compared with that of this window.
    """
    now = _scaled_inverse(problem, fisher)
    if now is None or problem.gains is None:
        return ""
    scaling = np.outer(problem.scales, problem.scales)
    direction = np.linalg.eigh(fisher * scaling)[1][:, 0]
    here, place = float(problem.window.reference[-1]), problem.names.index(name)
    output = problem.base.model.plant.output
    levels = np.linspace(*(output.set_points or output.span), _LEVELS)
    least = _LEAST_STEP * (levels[1] - levels[0])
    gains: list[tuple[float, float, float]] = []
    for level in sorted(levels.tolist(), key=lambda level: abs(level - here)):
        after = _after_step(problem, values, level) if abs(level - here) >= least else None
        if after is not None:
            better = float(np.sqrt(direction @ now @ direction / (direction @ after @ direction)))
            gains.append((level, better, float(np.sqrt(now[place, place] / after[place, place]))))
    best = max((better for _, better, _ in gains), default=0.0)
    for level, better, of_name in gains:
        if better >= _NEARLY * best and of_name >= _WORTH:
            times = f"{of_name:.0f}" if of_name >= 2.5 else f"{of_name:.1f}"
            way = f"{here:g} to {level:.4g} {output.unit}"
            return f"a step from {way} would determine {name} about {times} times better"
    return ""


def _after_step(problem: Problem, values: FloatArray, level: float) -> FloatArray | None:
    """Scaled covariance from the next window; None if the output does not reach the set-point."""
    window, noise = problem.window, problem.base.model.plant.output.noise
    steps = np.flatnonzero(np.abs(np.diff(window.reference)) >= _MOVED * noise)
    first = max(int(steps[-1]) + 1 - _LEAD, 0) if steps.size else 0
    kept = window.part(window.first + first, window.last)
    ahead = Window(
        np.concatenate([kept.reference, np.full(_AFTER, level)]),
        np.concatenate([kept.output, np.full(_AFTER, kept.output[-1])]),
        np.concatenate([kept.input, np.zeros(_AFTER)]),
        period=window.period,
        disturbances=np.concatenate([kept.disturbances, np.repeat(kept.disturbances[-1:], _AFTER, axis=0)]),
    )
    next_one = replace(problem, window=ahead)
    response = next_one.experiment.simulate(values)
    if not abs(response.output[-1] - level) <= _REACHED * noise:
        return None
    return _scaled_inverse(problem, next_one.evaluate(values).normal[2])


def _scaled_inverse(problem: Problem, fisher: FloatArray) -> FloatArray | None:
    """Covariance for white noise in units of the scales; None if a direction has no effect at all."""
    scaled = fisher * np.outer(problem.scales, problem.scales)
    eigenvalues = np.linalg.eigvalsh(scaled)
    if not eigenvalues[0] > np.finfo(np.float64).eps * eigenvalues[-1]:
        return None
    return np.asarray(np.linalg.inv(scaled), dtype=np.float64)
