"""A first PI controller for a plant without one: the fastest by Skogestad's rule whose maximum sensitivity
stays below a ceiling on every twin and on the draws of what its recording leaves open.

Skogestad, Simple analytic rules for model reduction and PID controller tuning, J. Process Control 13 (2003):
of a first-order plant with gain k, time constant τ and dead time θ, Kp = τ / (k (λ + θ)) and
Ti = min(τ, 4 (λ + θ)), with λ the time constant wanted of the loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.whole_loop import WholeLoop
from twinmatch.dynamics import Linear, PidGains, Plant, PlantError
from twinmatch.dynamics.pids import as_linear
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

MAX_SENSITIVITY: Final = 1.6
"""Ceiling of the maximum sensitivity M_s."""
_DRAWS: Final = 8
"""Draws of each twin beside itself."""


class _SlowerLoops(Rule):
    """Loops that are tried, each slower than the one before."""

    factor: float = 1.4
    """Factor on λ from one to the next."""
    most: int = 24
    """Most of them: the last is three thousand times slower."""
    fewest_samples: float = 3.0
    """Least λ, sample times."""
    least_share: float = 0.1
    """Least λ, as a share of the plant's time constant."""


_LOOPS: Final = _SlowerLoops()
_LONGEST: Final = 20_000
"""Samples of a step response, at most."""


class FirstOrderReduction(NamedTuple):
    """A plant reduced to first order with a dead time."""

    gain: float
    """Output per unit of the input."""
    lag: float
    """s"""
    dead_time: float
    """s"""


def reduced(plant: Linear) -> FirstOrderReduction:
    """Reduce a plant by its step response: the times at which it has come 28 and 63 % of its way (Smith and
    Corripio).

    Raises:
        ControllerError: the response does not end, as that of an integrator.
    """
    states = len(plant.A)
    final = (
        plant.C @ np.linalg.solve(np.eye(states) - plant.A, plant.B)
        if _decays(plant)
        else None
    )
    if final is None or not abs(final[0, 0]) > 0.0:
        raise ControllerError(
            "first PID: the output does not come to rest after a step of the input"
        )
    gain = float(final[0, 0])
    shares = _step_response(plant) / gain
    early = _time_at(shares, 0.283, plant.period)
    late = _time_at(shares, 0.632, plant.period)
    lag = max(1.5 * (late - early), plant.period)
    return FirstOrderReduction(gain, lag, max(late - lag, 0.0) + 0.5 * plant.period)


def _decays(plant: Linear) -> bool:
    return bool(np.abs(np.linalg.eigvals(plant.A)).max() < 1.0 - 1e-9)


def _step_response(plant: Linear) -> FloatArray:
    """The output after a unit step, from one sample after it on, until all modes have decayed."""
    slowest = float(np.abs(np.linalg.eigvals(plant.A)).max())
    size = (
        _LONGEST
        if slowest <= 0.0
        else min(math.ceil(-5.0 / math.log(slowest)) + 10, _LONGEST)
    )
    state = np.zeros(len(plant.A))
    outputs = []
    for _ in range(size):
        state = plant.A @ state + plant.B[:, 0]
        outputs.append(float(plant.C[0] @ state))
    return np.array(outputs)


def _time_at(shares: FloatArray, level: float, period: float) -> float:
    """When a response first reaches a share of its way, s, between two samples by a straight line."""
    place = int(np.argmax(shares >= level))
    before = float(shares[place - 1]) if place else 0.0
    part = (level - before) / (float(shares[place]) - before)
    return (place + part) * period


@dataclass(frozen=True, eq=False)
class FirstPid:
    """The gains, and what they rest on."""

    gains: PidGains
    sensitivity: float
    """Largest M_s over the twins and their draws, at all levels."""
    loop_time: float
    """Time constant λ that the loop is made for, s."""
    plants: int
    """Number of twins and draws."""


def first_pid(
    twins: Sequence[TriedTwin],
    levels: Sequence[float],
    holding: Holding,
    slower: float = 1.0,
) -> FirstPid:
    """Find the gains.

    Args:
        twins: what the plant may be, of a plant with one output and one drive.
        levels: outputs at which it is to be held; those at which a twin cannot be held are left out.
        holding: how the plant is held there.
        slower: factor on the least λ: a PID that does not stay in the range is asked for again with more.

    Raises:
        ControllerError: no twin can be held at a level, or no loop keeps below the ceiling.
    """
    plants = _plants(twins, levels, holding)
    if not plants:
        raise ControllerError(
            f"first PID: none of the twins can be held at {list(levels)}"
        )
    reductions = [reduced(plant) for plant in plants]
    gain, lag, dead_time = np.median(reductions, axis=0).tolist()
    period = holding.period
    loop_time = slower * max(
        dead_time, _LOOPS.fewest_samples * period, _LOOPS.least_share * lag
    )
    for _ in range(_LOOPS.most):
        gains = _gains(
            FirstOrderReduction(gain, lag, dead_time), loop_time, twins[0], period
        )
        sensitivity = max(
            WholeLoop(plant, as_linear(gains)).sensitivity() for plant in plants
        )
        if sensitivity <= MAX_SENSITIVITY:
            return FirstPid(gains, sensitivity, loop_time, len(plants))
        loop_time *= _LOOPS.factor
    raise ControllerError(
        f"first PID: no loop has a maximum sensitivity below {MAX_SENSITIVITY:g} on all that is possible; "
        "record more first"
    )


def _plants(
    twins: Sequence[TriedTwin], levels: Sequence[float], holding: Holding
) -> list[Linear]:
    """Every twin and its draws, linearised at the levels at which they can be held."""
    plants = []
    for number, twin in enumerate(twins):
        for parameters in (twin.parameters, *twin.drawn(_DRAWS, number)):
            for level in levels:
                try:
                    plants.append(
                        holding.linear(parameters, [level], twin.disturbances)
                    )
                except PlantError:
                    continue  # the drive does not reach that far
    return plants


def _gains(
    plant: FirstOrderReduction, loop_time: float, twin: TriedTwin, period: float
) -> PidGains:
    """A PI by Skogestad's rule, with its integral tracking the limited command in the integral time."""
    declared: type[Plant] = twin.parameters.model.plant
    low, high = declared.drive.limits
    total = loop_time + plant.dead_time
    proportional = plant.lag / (plant.gain * total)
    integral_time = min(plant.lag, 4.0 * total)
    return PidGains(
        proportional=_rounded(proportional),
        integral=_rounded(proportional / integral_time),
        derivative=0.0,
        back_calculation=_rounded(1.0 / integral_time),
        low=low,
        high=high,
        period=period,
    )


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
