"""How fast a plant is: by its time constant or, where nothing is known, by the time between its samples.

Times that are meant for the rig, with its time constant of about 100 s and a sample every second, are
multiplied by a factor, bounded so that the longest horizon is 60 to 1200 samples.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from twinmatch.dynamics.movement import rest_of
from twinmatch.dynamics.plant import Parameters, Plant
from twinmatch.signals import FloatArray

_USUAL: Final = 100.0
"""Time constant at which times are as for the rig, s."""
_MAX_SAMPLES: Final = 4.0
_MIN_SAMPLES: Final = 0.2
"""Samples in the time that is one second of the rig: with fewer, the longest horizon would be less than 60
samples, as many as a verdict compares with the forecasts made for them; with more, computing is slow."""
_MIN_PERIOD: Final = 0.5
"""Sample time below which times shrink with it where no time constant is known, s."""
_SHOWN: Final = 0.1
"""Share of the largest that a mode must have in the response to a step of the input."""
_STANDS: Final = 1e-6
"""Eigenvalue of an integrator, as a share of the fastest."""


def time_scale(period: float) -> float:
    """Factor on all times by the sample time alone, s: for health, and for a plant that only integrates.

    In a plant that is sampled every minute, nothing can be seen ten seconds ahead, and five minutes are only
    five samples. In a motor that is sampled a hundred times a second, all has settled long before.
    """
    return max(period * _MIN_SAMPLES, min(period / _MIN_PERIOD, 1.0))


def plant_scale(plant: type[Plant], period: float, longer: float = 1.0) -> float:
    """Factor on times that follow the plant's time constant; `period` is the sample time, s, and `longer` a
    factor of the user's."""
    slow = time_constant(plant)
    if not slow:
        return time_scale(period) * longer
    return (
        max(_MIN_SAMPLES * period, min(slow / _USUAL, _MAX_SAMPLES * period)) * longer
    )


def slow_scale(plant: type[Plant], period: float) -> float:
    """The factor for slow plants, at least 1, so that fast plants keep the times of health.

    At 200 Hz the model error that trackers assume, which is a rig's, does not suffice for friction.
    """
    return max(plant_scale(plant, period), 1.0)


def usual_scale(plant: type[Plant]) -> float:
    """The factor without bounds; 1 for a plant that only integrates."""
    return time_constant(plant) / _USUAL or 1.0


@cache
def time_constant(plant: type[Plant]) -> float:
    """The plant's slow time constant, s: as its file says, or the slowest that a step of the input shows.

    It is that of the equations linearised in the middle of the outputs' ranges, with typical parameters, in
    the slowest of the structures. Integrators have none; 0 if there is nothing else.
    """
    if plant.time_constant:
        return plant.time_constant
    slowest = 0.0
    for name, structure in plant.structures.items():
        if structure.external is None:
            slowest = max(slowest, _slowest(plant.model(name).typical()))
    return slowest


def _slowest(parameters: Parameters) -> float:
    model = parameters.model
    states, inputs = rest_of(parameters)
    _, fx, fu, _, hx, _, _ = model.kernels.slopes_at(
        parameters.vector, states, inputs, model.disturbances
    )
    with np.errstate(all="ignore"):
        return _slow_mode(fx, fu, hx)


def _slow_mode(fx: FloatArray, fu: FloatArray, hx: FloatArray) -> float:
    """Time constant of the slowest mode, s, that the outputs show after a step of an input."""
    if not (fx.size and all(np.isfinite(matrix).all() for matrix in (fx, fu, hx))):
        return 0.0
    rates, modes = np.linalg.eig(fx)
    decays = np.abs(rates.real)
    sizes = np.abs(rates)
    decays_at_all = decays > _STANDS * np.max(sizes)
    driven = np.linalg.lstsq(modes, fu.astype(complex), rcond=None)[0]
    shown_by_outputs = np.max(np.abs(hx @ modes), axis=0)
    driven_by_inputs = np.max(np.abs(driven), axis=1)
    shares = shown_by_outputs * driven_by_inputs / sizes
    is_shown = decays_at_all & (
        shares >= _SHOWN * np.max(shares[decays_at_all], initial=0.0)
    )
    return float(1.0 / np.min(decays[is_shown])) if is_shown.any() else 0.0
