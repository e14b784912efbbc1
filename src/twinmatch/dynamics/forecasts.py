"""Forecasts of the loop beyond the newest sample, and the effect of the sensors' noise on a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.experiment import Experiment, Tangents
from twinmatch.dynamics.loop import Law
from twinmatch.dynamics.plant import Parameters
from twinmatch.dynamics.simulation import gains_of, law_of, n_references, signal_rows
from twinmatch.dynamics.variances import foresee, noise_effects
from twinmatch.signals import FloatArray, finite


class LoopForecast(NamedTuple):
    """Forecast of the N samples after the newest one; variances only where asked for."""

    outputs: FloatArray
    """y simulated from the mean states and parameters, without noise, shape (N, o)."""
    inputs: FloatArray
    """u of the same run, shape (N, m)."""
    output_variances: FloatArray
    """Variances of the sensors' readings, including their noise, shape (N, o)."""
    input_variances: FloatArray
    """Variances of the commands that the law computes from such readings, shape (N, m); zero if inputs are
    given."""

    @property
    def means(self) -> FloatArray:
        """Outputs, then inputs, shape (o + m, N)."""
        return np.concatenate([self.outputs, self.inputs], axis=1).T

    @property
    def variances(self) -> FloatArray:
        """Those of outputs, then inputs, shape (o + m, N)."""
        return np.concatenate([self.output_variances, self.input_variances], axis=1).T


def forecast_loop(
    parameters: Parameters,
    *,
    states: FloatArray,
    covariance: ArrayLike,
    input: ArrayLike,
    drift: ArrayLike,
    unsure: Sequence[str] = (),
    reference: ArrayLike | None = None,
    controller: ArrayLike | None = None,
    gains: Law | None = None,
    inputs: ArrayLike | None = None,
    period: float = 1.0,
    disturbances: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    swift: float = 0.0,
    banded: bool = True,
) -> LoopForecast:
    """Simulate the closed loop, or a plant under known inputs, beyond the newest sample.

    The mean is that of `advance` and `simulate_closed_loop` (or `simulate_driven`). The variances are those
    of small deviations from it, exact around the loop; where u is on a limit, its variance is zero. They
    include the uncertainty of states and parameters, the drift of the states, and the sensors' noise as it
    circulates in the loop.

    Args:
        parameters: the plant.
        states: states at the newest sample, corrected by its readings, shape (n,).
        covariance: covariance of states and the k parameters `unsure`, shape (n + k, n + k); symmetric.
        input: u of the newest sample, which acts until the next, shape (m,); for one input also a number.
        drift: standard deviation of the drift of each state from the equations per second, shape (n,).
        unsure: names of the parameters in the covariance.
        reference: set-points from the next sample on, shape (N,) or (N, r): the closed loop.
        controller: state of the controller after the newest sample.
        gains: the controller; default: the plant file's, at 1 s.
        inputs: u from the next sample on, shape (N,) or (N, m), instead of a reference: the driven plant.
        period: sample time of a driven plant, s; for the loop the controller's is used.
        disturbances: constant, shape (d,), or from the newest sample on, shape (N + 1, d).
        noise: standard deviation of a reading, or of those of each output; default: the plant file's.
        swift: standard deviation of the error of a state's movement over a sample, as a share of it.
        banded: whether the variances are wanted, two thirds of the work; without, they are empty.

    Raises:
        PlantError: a signal or a name is invalid, the controller is not known, or the plant is too fast.
    """
    if (reference is None) == (inputs is None):
        title = parameters.model.title
        raise PlantError(f"{title}: a forecast takes set-points ahead or inputs ahead; give one of the two")
    loop = None if reference is None else gains or gains_of(parameters.model.plant, 1.0)
    known = Foresight(
        parameters, loop, states=states, covariance=covariance, input=input, drift=drift, unsure=unsure,
        controller=controller, period=period, noise=noise, swift=swift,
    )  # fmt: skip
    return known.ahead(inputs if reference is None else reference, disturbances, banded=banded)


class Foresight:
    """What a forecast needs to know at its sample, checked once: it is then made for any signals ahead."""

    def __init__(
        self,
        parameters: Parameters,
        loop: Law | None,
        *,
        states: FloatArray,
        covariance: ArrayLike,
        input: ArrayLike,
        drift: ArrayLike,
        unsure: Sequence[str] = (),
        controller: ArrayLike | None = None,
        period: float = 1.0,
        noise: ArrayLike | None = None,
        swift: float = 0.0,
    ) -> None:
        """Take what `forecast_loop` takes; without a loop, inputs are given.

        Raises:
            PlantError: as `forecast_loop`.
        """
        model, title = parameters.model, parameters.model.title
        unknown = [name for name in unsure if name not in model.names]
        if unknown:
            raise PlantError(f"{title}: no parameter {unknown[0]!r}; there are {', '.join(model.names)}")
        n, k, period = len(model.states), len(unsure), float(period if loop is None else loop.period)
        process_noise = np.zeros(n + k)
        process_noise[:n] = np.square(_fit(title, "drift", drift, (n,))) * period
        self._model, self._name = model, "inputs" if loop is None else "set-points"
        self._columns = n_references(model.plant, loop)
        self._states = _fit(title, "states", states, (n,))
        self._covariance = _fit(title, "covariance", covariance, (n + k, n + k))
        given = model.noise if noise is None else np.atleast_1d(noise)
        noises = _fit(title, "noise", given, model.noise.shape)
        u = _fit(title, "newest input", np.atleast_1d(input), (len(model.plant.drives),))
        self._kernels = model.kernels_by(unsure)
        which = [[self._kernels.UNKNOWN.index(name) for name in unsure]] * 2
        self._begun = parameters.vector, np.array(which, dtype=np.int64).reshape(2, k)
        self._now = process_noise, u, *law_of(loop, controller)
        self._then = period, parameters.steps(period), noises * noises, float(swift)

    def ahead(
        self, signal: ArrayLike | None, disturbances: ArrayLike | None = None, *, banded: bool = True
    ) -> LoopForecast:
        """The forecast under these set-points (or inputs) and disturbances.

        Raises:
            PlantError: as `forecast_loop`.
        """
        model = self._model
        references = signal_rows(model.title, self._name, signal, self._columns)
        size = len(references) + 1
        if disturbances is not None and np.ndim(disturbances) == 1:
            disturbances = np.tile(model.disturbance_row(disturbances), (size, 1))
        return LoopForecast._make(
            self._kernels.call(
                foresee, *self._begun, self._states.copy(), self._covariance.copy(), *self._now, references,
                model.disturbance_rows(disturbances, size), *self._then, banded,
            )
        )  # fmt: skip


def _fit(title: str, name: str, values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Copy values into an array for the compiled code, and check shape and values."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not finite(array):
        bad = f"of shape {array.shape}" if array.shape != shape else "with a value that is not finite"
        raise PlantError(f"{title}: {name} {bad} given; give finite values of shape {shape}")
    return array


def noise_scores(
    experiment: Experiment, tangents: Tangents, weighed: FloatArray, weights: FloatArray
) -> tuple[FloatArray, float]:
    """Effect of white noise in the readings on the sums Σ_j weighed_j·residual_j.

    Args:
        experiment: the experiment.
        tangents: its run.
        weighed: rows of the weighed residuals' Jacobian, shape (o + m, N, n), for noise of 1 in the readings.
        weights: weights of the residuals of outputs and inputs, for noise of 1 in the readings, shape
            (o, o + m): one row for the readings of each output.

    Returns:
        The sums caused by noise of size 1 in each reading alone, shape (N·o, n), and the mean squared
        residual caused by all of them. Noise of the first readings also shifts the twin's start. For a
        driven twin, noise enters only through the readings it is compared with, and its start.
    """
    return noise_effects(
        np.ascontiguousarray(tangents.by_state),
        np.ascontiguousarray(tangents.by_input),
        np.ascontiguousarray(tangents.around),
        np.ascontiguousarray(tangents.seen),
        experiment.start_slope,
        np.ascontiguousarray(weighed),
        np.ascontiguousarray(weights, dtype=np.float64),
        experiment.closed,
    )
