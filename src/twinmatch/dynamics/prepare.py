"""Compiles everything for a plant in advance: its equations, and the kernels, which are the same for all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinmatch.dynamics.experiment import Experiment
from twinmatch.dynamics.forecasts import Foresight, noise_scores
from twinmatch.dynamics.observer import Observer
from twinmatch.dynamics.plant import Model, Parameters, Plant
from twinmatch.dynamics.simulation import (
    advance,
    advance_side_by_side,
    begin,
    quantities,
    read,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.signals import Window

_SAMPLES = 8


def derived_models(plant: type[Plant]) -> Iterator[Model]:
    """The structures of a plant whose equations are in its file, each when its equations are compiled.

    Raises:
        PlantError: the equations cannot be used, or the cache folder cannot be written.
    """
    for name, structure in plant.structures.items():
        if structure.external is None:
            model = plant.model(name)
            model.kernels  # noqa: B018
            yield model


def prepare(plant: type[Plant]) -> Iterator[Model]:
    """Compile all structures of a plant, one at a time; each is yielded when it is ready.

    Those already on disk are only loaded. The kernels that are the same for all are those of plants with one
    loop, too.

    Raises:
        PlantError: the equations cannot be used, or the cache folder cannot be written.
    """
    single = len(plant.outputs) == len(plant.drives) == 1
    for place, model in enumerate(derived_models(plant)):
        if single and place == 0:
            _use(model.parameters())
        yield model


def _use(parameters: Parameters) -> None:
    """Call every kernel once: numba compiles at the first call.

    The other kernels of linearisations are called by the observer, too.
    """
    model = parameters.model
    law = model.plant.loop
    usual_input = model.plant.drive.rest
    period = 1.0 if law is None else law.period
    output = read(parameters, begin(parameters, sum(model.plant.output.span) / 2))
    states = begin(parameters, output)
    quantities(
        parameters, advance(parameters, states, usual_input, period), usual_input
    )
    advance_side_by_side([parameters], states[None], usual_input, period)
    model.kernels.slopes_at(parameters.vector, states, model.rest, model.disturbances)
    # The kernel of the energy balance.
    model.kernels.parts(
        parameters.vector,
        output,
        states,
        float(usual_input),
        float(usual_input),
        model.disturbances,
        period,
        parameters.steps(period),
    )
    observer = Observer(
        parameters,
        output,
        period=period,
        drift=np.ones(states.size),
        start=np.ones(states.size),
    )
    observer.correct(output)
    observer.predict(usual_input)
    levels = np.full(_SAMPLES, output)
    foresight = Foresight(
        [(parameters, ())], law, drift=[np.ones(states.size)], period=period
    )
    loop_state = foresight.at([states], [observer.joint], usual_input, None)
    foresight.ahead(
        loop_state, np.full(_SAMPLES, usual_input) if law is None else levels
    )
    run = simulate_driven(
        parameters, np.full(_SAMPLES, usual_input), states=states, period=period
    )
    if law is not None:
        run = simulate_closed_loop(parameters, levels, states=states, law=law)
    disturbances = model.disturbance_rows(None, _SAMPLES)
    window = Window(
        levels, run.outputs, run.inputs, period=period, disturbances=disturbances
    )
    structure = model.structure
    experiment = Experiment(
        parameters, structure.free, window, free_starts=structure.free_starts
    )
    values = experiment.values_of(parameters)
    experiment.normal(values)
    experiment.descend(values, values, values, np.ones(values.size), 1)
    tangents = experiment.tangents(values)
    weighed = np.ones((2, _SAMPLES - 2, experiment.size))
    noise_scores(experiment, tangents, weighed, np.ones((1, 2)))
