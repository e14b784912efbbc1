"""Which set-point step would show what a window left open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinmatch.matching.problem import Problem
from twinmatch.signals import FloatArray, Window

__all__ = ["suggest_step"]

_LEVELS = tuple(float(level) for level in range(20, 100, 10))
"""Set-points that are considered, °C: the range of the paper's experiments."""
_LEAST_STEP = 5.0
"""A step smaller than this is not suggested, °C."""
_LEAD, _AFTER = 20, 240
"""Samples of the window kept before its last step, and samples simulated after the new one."""
_MOVED = 2.0
"""Change of the set-point that counts as a step, °C."""
_REACHED = 1.0
"""Distance from the set-point within which the plate must have come at the end, °C."""
_WORTH = 1.25
"""Least improvement worth a suggestion."""
_NEARLY = 0.9
"""Part of the best improvement for which the smallest step is taken."""


def suggest_step(problem: Problem, values: FloatArray, fisher: FloatArray, name: str) -> str:
    """One sentence naming the step from here that would determine the combination this window shows
    least, and how much better parameter `name` would be known; empty if no step would help much.

    The next window holds this one's last regime and the one after the step. For each step it is
    simulated with the fitted twin, and its information JᵀJ compared with that of this window.
    """
    now = _scaled_inverse(problem, fisher)
    if now is None:
        return ""
    scaling = np.outer(problem.scales, problem.scales)
    direction = np.linalg.eigh(fisher * scaling)[1][:, 0]
    here, place = float(problem.window.reference[-1]), problem.free.index(name)
    gains: list[tuple[float, float, float]] = []
    for level in sorted(_LEVELS, key=lambda level: abs(level - here)):
        after = _after_step(problem, values, level) if abs(level - here) >= _LEAST_STEP else None
        if after is not None:
            better = float(np.sqrt(direction @ now @ direction / (direction @ after @ direction)))
            gains.append((level, better, float(np.sqrt(now[place, place] / after[place, place]))))
    best = max((better for _, better, _ in gains), default=0.0)
    for level, better, of_name in gains:
        if better >= _NEARLY * best and of_name >= _WORTH:
            times = f"{of_name:.0f}" if of_name >= 2.5 else f"{of_name:.1f}"
            return f"a step from {here:g} to {level:g} °C would determine {name} about {times} times better"
    return ""


def _after_step(problem: Problem, values: FloatArray, level: float) -> FloatArray | None:
    """Scaled covariance that the next window would leave; None if the plate does not get there."""
    window = problem.window
    steps = np.flatnonzero(np.abs(np.diff(window.reference)) >= _MOVED)
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
    response = next_one.simulate(problem.parameters_at(values), problem.sink_start_at(values))
    if not abs(response.output[-1] - level) <= _REACHED:
        return None
    return _scaled_inverse(problem, next_one.evaluate(values).normal[2])


def _scaled_inverse(problem: Problem, fisher: FloatArray) -> FloatArray | None:
    """Covariance for white noise in units of the scales; None if a direction does not show at all."""
    scaled = fisher * np.outer(problem.scales, problem.scales)
    eigenvalues = np.linalg.eigvalsh(scaled)
    if not eigenvalues[0] > np.finfo(np.float64).eps * eigenvalues[-1]:
        return None
    return np.asarray(np.linalg.inv(scaled), dtype=np.float64)
