"""A simulated experiment on a plant file: steps of the input over the drive's whole range."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import Model, Parameters, PlantError, Response, begin, simulate_driven
from twinmatch.signals import FloatArray, Window

__all__ = ["Trial", "middle_of", "modes", "run_trial", "time_constants", "trial_for"]

SAMPLES: Final = 400
_PER_LAG: Final = 20.0
"""Samples per slowest time constant: 400 samples span twenty of them."""
_SEED: Final = 7


class Trial(NamedTuple):
    """Inputs and initial value of the experiment."""

    input: FloatArray
    """Shape (N,)."""
    disturbances: FloatArray
    """Shape (N, m)."""
    period: float
    """Sampling period, s."""
    output: float
    """Initial output."""


def middle_of(model: Model) -> float:
    """The output in the middle of the plant's operating range."""
    y = model.plant.output
    low, high = y.set_points or y.span
    states = [model.plant.states[name].span for name in model.states]
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = states[0]
    return (low + high) / 2


def modes(parameters: Parameters) -> NDArray[np.complex128]:
    """Eigenvalues of the plant linearised in the middle of its range, 1/s.

    Raises:
        PlantError: the equations have no finite values there.
    """
    model = parameters.model
    states = begin(parameters, middle_of(model))
    rest = sum(model.plant.drive.limits) / 2
    slopes = model.kernels.slopes_at(parameters.vector, states, float(rest), model.disturbances)[1]
    if not np.isfinite(slopes).all():
        msg = f"{model.title}: the derivatives of its rates are not finite in the middle of its range"
        raise PlantError(msg)
    return np.asarray(np.linalg.eigvals(slopes), dtype=np.complex128)


def time_constants(parameters: Parameters) -> FloatArray:
    """Time constants of the plant linearised in the middle of its range, s, ascending; without integrators.

    Raises:
        PlantError: the equations have no finite values there.
    """
    rates = np.abs(modes(parameters))
    return np.sort(1.0 / rates[rates > 0])


def trial_for(parameters: Parameters, period: float | None = None) -> Trial:
    """Design the experiment for a plant with these parameters.

    Args:
        parameters: the plant's parameters.
        period: sampling period, s; a twentieth of the slowest time constant if not given.
    """
    model = parameters.model
    if period is None:
        lags = time_constants(parameters)
        period = float(lags[-1]) / _PER_LAG if lags.size else 1.0
        period = float(f"{min(max(period, 1e-6), 1e6):.2g}")
    random = np.random.default_rng(_SEED)
    low, high = model.plant.drive.limits
    input_ = np.empty(SAMPLES)
    at = 0
    while at < SAMPLES:
        hold = int(random.integers(5, 60))
        input_[at : at + hold] = random.uniform(low, high)
        at += hold
    moved = np.repeat(random.uniform(-1.0, 1.0, (SAMPLES // 50, model.disturbances.size)), 50, axis=0)
    disturbances = model.disturbances + 0.1 * np.maximum(np.abs(model.disturbances), 1.0) * moved
    return Trial(input_, disturbances, period, middle_of(model))


def run_trial(parameters: Parameters, trial: Trial) -> tuple[Response, Window]:
    """Simulate the experiment; returns the response, also as a window.

    Raises:
        PlantError: the plant is too fast for the period, or its output is not finite.
    """
    states = begin(parameters, trial.output, input=float(trial.input[0]))
    run = simulate_driven(
        parameters, trial.input, states=states, period=trial.period, disturbances=trial.disturbances
    )
    if not np.isfinite(run.output).all():
        at = int(np.flatnonzero(~np.isfinite(run.output))[0])
        msg = f"{parameters.model.title}: its output is not a finite number after {at * trial.period:g} s"
        raise PlantError(msg)
    window = Window(
        np.full(trial.input.size, trial.output),
        run.output,
        trial.input,
        period=trial.period,
        disturbances=trial.disturbances,
    )
    return run, window
