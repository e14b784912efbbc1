"""Units of outputs and inputs in which a controller's margin exceeds the ν-gaps of a family by most.

Vinnicombe's theorem holds in any constant units: a controller whose margin b(P, C) with one plant is greater
than the ν-gap to another stabilises that one, too. In unsuitable units it says nothing, so the units are
searched: they maximise arcsin b − arcsin δν, a lower bound of arcsin b at every member. Where that is
negative, units so extreme that both vanish would bring it near 0 and prove nothing; there the ratio b/δν
counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing.matrix_gap import (
    beside,
    closed_loop,
    frequencies_of,
    gaps_of,
    matrix_margin,
    matrix_nu_gap,
    sizes_of,
)
from twinmatch.comparing.state_space import StateSpace, half_plane
from twinmatch.comparing.undefined import having_value
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

RATIOS = np.logspace(-3, 3, 19)
"""Units of the outputs against those of the inputs that are tried first, relative to the given ones."""


class _Climbing(Rule):
    """A random search over the logarithms of all units: a step that helped is followed by a longer one, one
    that did not by a shorter one, in such proportion that the size stays where one step in five helps."""

    first: float = 0.7
    """Size of the first step."""
    last: float = 0.01
    """Size of a step from which on the search ends."""
    longer: float = 1.5
    """Factor on a step that helped."""
    shorter: float = 0.9
    """Factor on a step that did not."""
    trials: int = 400
    """Steps, at most."""
    change: float = 1e4
    """Factor by which a unit may change, at most."""
    seed: int = 1


_CLIMBING: Final = _Climbing()


class Scaling(NamedTuple):
    """Units of a plant's signals, and what they prove."""

    outputs: FloatArray
    """Unit of each output, shape (p,)."""
    inputs: FloatArray
    """Unit of each input, shape (m,); only ratios between all units matter."""
    margin: float
    """b(P, C) in these units; 0 if the loop is not stable."""
    gap: float
    """Largest ν-gap from P to a member of the family in these units."""

    @property
    def claim(self) -> float:
        """How well that is so, positive if it is: arcsin b − arcsin δν, or else ln(b/δν)."""
        return _claim(self.margin, self.gap)

    @property
    def holds(self) -> bool:
        """Whether the controller is guaranteed to stabilise the whole family."""
        return self.margin > self.gap


@having_value("the stability margin beside the ν-gaps")
def best_scaling(
    plant: StateSpace,
    family: Sequence[StateSpace],
    controller: StateSpace,
    *,
    outputs: ArrayLike | None = None,
    inputs: ArrayLike | None = None,
) -> Scaling:
    """The constant units that are best for the claim that C stabilises every member, because b(P, C) is
    greater than the largest ν-gap from P.

    Args:
        plant: P, the member that the claim starts from.
        family: the others; P may be one of them.
        controller: C of u = −C·y.
        outputs, inputs: units to begin with, shapes (p,) and (m,); default 1.

    Raises:
        DiscriminationError: periods or numbers of signals differ, or a gap or margin has no value.
    """
    p = plant.n_outputs
    begin = np.concatenate(
        [_units_or_ones(outputs, p), _units_or_ones(inputs, plant.n_inputs)]
    )

    def in_units(units: FloatArray) -> Scaling:
        y = units[:p]
        u = units[p:]
        scaled = plant.scaled(y, u)
        gaps = [matrix_nu_gap(scaled, member.scaled(y, u)) for member in family]
        return Scaling(
            y, u, matrix_margin(scaled, controller.scaled(u, y)), max(gaps, default=0.0)
        )

    first = in_units(begin)
    if first.margin == 0 or not family:
        return first
    climbed = in_units(_climb(_claim_in(plant, family, controller), begin, p))
    return max(first, climbed, key=lambda scaling: scaling.claim)


def _units_or_ones(units: ArrayLike | None, count: int) -> FloatArray:
    return (
        np.ones(count) if units is None else np.array(units, dtype=np.float64, ndmin=1)
    )


def _claim(margin: float, gap: float) -> float:
    if margin > gap:
        return math.asin(margin) - math.asin(gap)
    return math.log(margin / gap) if margin > 0 else -math.inf


def _claim_in(
    plant: StateSpace, family: Sequence[StateSpace], controller: StateSpace
) -> Callable[[FloatArray], float]:
    """The claim in given units, from responses on a grid of frequencies."""
    nominal, law, *members = half_plane(plant, controller, *family)
    # well posed, since the margin is not 0
    loop = cast("StateSpace", closed_loop(nominal, law))
    poles = np.concatenate(
        [np.linalg.eigvals(system.A) for system in (nominal, *members)]
    )
    frequencies = beside(frequencies_of(np.linalg.eigvals(loop.A)), poles)
    p = plant.n_outputs
    loop_responses = loop.response(frequencies)
    nominal_responses = np.tile(nominal.response(frequencies), (len(members), 1, 1))
    member_responses = np.concatenate(
        [member.response(frequencies) for member in members]
    )

    def claim(units: FloatArray) -> float:
        y = units[:p]
        u = units[p:]
        ratio = (u / y[:, None]).astype(np.complex128)
        rows = np.concatenate([y, u])
        columns = np.concatenate([u, y])
        norm = float(sizes_of(loop_responses * (columns / rows[:, None])).max())
        gap = float(gaps_of(nominal_responses * ratio, member_responses * ratio).max())
        return _claim(min(1.0, 1 / norm), gap)

    return claim


def _climb(
    value: Callable[[FloatArray], float], units: FloatArray, outputs: int
) -> FloatArray:
    """Change the ratio of output to input, then all units at random, by steps that adapt: the
    value has ridges, on which a search along single units stops."""
    whole = np.arange(units.size) < outputs
    units = max((np.where(whole, units * ratio, units) for ratio in RATIOS), key=value)
    best = value(units)
    size = _CLIMBING.first
    rng = np.random.default_rng(_CLIMBING.seed)
    begin = units
    for _ in range(_CLIMBING.trials):
        if size < _CLIMBING.last or units.size == 2:
            break
        moved = units * np.exp(size * rng.standard_normal(units.size))
        moved = np.clip(moved, begin / _CLIMBING.change, begin * _CLIMBING.change)
        reached = value(moved)
        better = reached > best
        if better:
            units = moved
            best = reached
        size *= _CLIMBING.longer if better else _CLIMBING.shorter
    return units
