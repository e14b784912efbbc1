"""Check that an FMU is fully determined by the states in its map, before it is used."""

from __future__ import annotations

import numpy as np

from twinmatch.dynamics import Model, begin, simulate_driven
from twinmatch.fmu.errors import FmuError

__all__ = ["check_restart"]

SAMPLES = 8
_STATE = 1e-4
"""Tolerance of a state, in units of its span: a restarted solver chooses other steps."""


def check_restart(model: Model) -> None:
    """Simulate a few samples in one run, and again restarting at each from its states; both must agree.

    Forecasts start from states that an observer has estimated. An FMU with internal states that its map does
    not name, such as a filter, would then give wrong forecasts.

    Raises:
        FmuError: they disagree, or the FMU has no finite values.
    """
    plant, kernels = model.plant, model.kernels
    low, high = plant.drive.limits
    drive = np.repeat([0.5 * (plant.drive.rest + high), 0.5 * (plant.drive.rest + low)], SAMPLES // 2)
    parameters = model.parameters()
    period = 1.0 if plant.loop is None else plant.loop.period
    y = float(np.mean(plant.output.set_points or plant.output.span))
    run = simulate_driven(parameters, drive, states=begin(parameters, y), period=period)
    spans = np.array([state.span[1] - state.span[0] for state in model.declared_states])
    for k, u in enumerate(drive.tolist()):
        after = kernels.advance(parameters.vector, run.states[k], u, model.disturbances, period, run.steps)
        seen, _ = kernels.look(parameters.vector, run.states[k], plant.drive.rest, model.disturbances)
        off = np.abs(after - run.states[k + 1]) / spans if spans.size else np.zeros(1)
        if abs(seen - run.output[k]) > plant.output.noise or off.max() > _STATE:
            what = f"its output {seen:g} instead of {run.output[k]:g}"
            if off.max() > _STATE:
                name = model.states[int(np.argmax(off))]
                what = f"{name} {after[np.argmax(off)]:g} instead of {run.states[k + 1][np.argmax(off)]:g}"
            msg = (
                f"{model.title}: restarted from its states, the FMU has {what}; it has internal states that "
                "its map does not name: name all, or export it as model exchange"
            )
            raise FmuError(msg)
