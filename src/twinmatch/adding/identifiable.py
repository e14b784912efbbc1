"""Structural identifiability of a structure's free parameters.

The exact tangents of a simulated experiment are the sensitivities of the output to each parameter. If a
combination of parameters has no effect on the output at any of several points of the parameter space, no
recording can determine it. One point where the tangents have full rank proves the opposite (local structural
identifiability; Walter & Pronzato, Identification of Parametric Models, 1997, section 2.6).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from twinmatch.adding.findings import Finding
from twinmatch.adding.trial import run_trial, trial_for
from twinmatch.dynamics import Experiment, Model, Parameters, PlantError
from twinmatch.dynamics.declarations import Parameter
from twinmatch.signals import FloatArray

__all__ = ["inseparable"]

_POINTS: Final = 4
_AWAY: Final = 1.5
"""Largest factor, either way, between a point and the defaults."""
_FLAT: Final = 1e-6
"""A column is linearly dependent if its residual is below this share of its length. Tangents are exact to
about 1e-12; parameters with different effects mostly differ by more than 1e-4."""
_TAKES_PART: Final = 0.02
"""Parameters with a smaller share in a combination are not listed."""


class _Combination(NamedTuple):
    """Parameters that can change together without effect on the output."""

    names: tuple[str, ...]
    shares: tuple[float, ...]
    """Relative changes; for parameters without a meaningful zero, changes in units of their scale."""


def inseparable(model: Model) -> list[Finding]:
    """Combinations of the structure's free parameters that no data can determine.

    Raises:
        PlantError: the plant cannot be simulated at its defaults.
    """
    free = tuple(name for name in model.structure.free if name in model.declared)
    if not free:
        return []
    found: list[_Combination] | None = None
    for point in _points(model, free):
        try:
            here = _combinations(point, free)
        except PlantError:
            continue  # reported by the check of the bounds
        if found is None or len(here) < len(found):
            found = here
        if not found:
            return []
    return [_finding(model, combination) for combination in found or []]


def _points(model: Model, free: tuple[str, ...]) -> list[Parameters]:
    random = np.random.default_rng(11)
    points = [model.parameters()]
    for _ in range(_POINTS - 1):
        values = {}
        for name in free:
            declared = model.declared[name]
            values[name] = _moved(declared, model.defaults[name], float(random.uniform(-1.0, 1.0)))
        points.append(model.parameters(**values))
    return points


def _moved(declared: Parameter, value: float, by: float) -> float:
    low, high = declared.bounds
    if declared.relative and value:
        moved = value * _AWAY**by
    else:
        moved = value + by * min(declared.scale, (high - low) / 4)
    return moved if declared.possible(moved) else value


def _combinations(parameters: Parameters, free: tuple[str, ...]) -> list[_Combination]:
    """Columns of the tangents that depend linearly on the columns before them."""
    model = parameters.model
    trial = trial_for(parameters)
    _, window = run_trial(parameters, trial)
    starts = model.structure.free_starts
    experiment = Experiment(parameters, free, window, free_starts=starts, gains=None)
    tangents = experiment.tangents(experiment.values_of(parameters)).by[0]
    if not np.isfinite(tangents).all():
        msg = f"{model.title}: the sensitivities of its output are not finite"
        raise PlantError(msg)
    sizes = [_size(model.declared[name], parameters[name]) for name in free]
    sizes += [max(abs(model.plant.states[name].scale), 1e-12) for name in starts]
    columns = tangents * np.array(sizes)
    names = (*free, *(f"start of {name}" for name in starts))
    least = 1e-9 * model.plant.output.noise * math.sqrt(columns.shape[0])
    found: list[_Combination] = []
    # Initial values first: they are always estimated, so a dependence is attributed to a parameter.
    order = [*range(len(free), len(names)), *range(len(free))]
    basis: list[int] = []
    for j in order:
        length = float(np.linalg.norm(columns[:, j]))
        if length <= least:
            found.append(_Combination((names[j],), (1.0,)))
            continue
        shares, rest = _projected(columns[:, basis], columns[:, j])
        if rest > _FLAT * length:
            basis.append(j)
            continue
        named = [(names[k], -float(s)) for k, s in zip(basis, shares, strict=True) if abs(s) > _TAKES_PART]
        parts = [(names[j], 1.0), *named]
        found.append(_Combination(tuple(n for n, _ in parts), tuple(s for _, s in parts)))
    return found


def _projected(basis: FloatArray, column: FloatArray) -> tuple[FloatArray, float]:
    """Least-squares coefficients of a column in a basis, and the length of the residual."""
    if not basis.shape[1]:
        return np.empty(0), float(np.linalg.norm(column))
    lengths = np.linalg.norm(basis, axis=0)
    shares = np.linalg.lstsq(basis / lengths, column, rcond=None)[0]
    left = float(np.linalg.norm(column - basis / lengths @ shares))
    return np.asarray(shares / lengths, dtype=np.float64), left


def _size(declared: Parameter, value: float) -> float:
    return abs(value) if declared.relative and value else declared.scale


def _finding(model: Model, combination: _Combination) -> Finding:
    place = f"structure {model.structure_name!r}"
    names, shares = combination
    if len(names) == 1:
        what = f"{place}: the output does not depend on {names[0]}, which is free"
        return Finding(what, f"remove {names[0]} from `free`, or check the equations")
    relative = all(model.declared[n].relative for n in names if n in model.declared)
    alike = all(abs(abs(s) - 1.0) < 0.02 for s in shares) and relative
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    if alike and len(names) == 2:
        seen = f"{names[0]}/{names[1]}" if shares[0] * shares[1] > 0 else f"{names[0]}·{names[1]}"
        what = f"{place}: no data can determine {listed} separately, only {seen}"
    elif alike and all(s > 0 for s in shares):
        what = f"{place}: no data can determine {listed} separately, only their ratios"
    else:
        what = f"{place}: {listed} can change together without effect on the output"
    todo = (
        "remove one of them from `free`, best the one you know or need least (its default, or a value in "
        "`fixed`, is used), or write the equations with the combination"
    )
    return Finding(what, todo)
