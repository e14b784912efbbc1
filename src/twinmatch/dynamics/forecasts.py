"""Forecasts of the loop beyond the newest sample, and the effect of the sensors' noise on a fit."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.dynamics import variances as variance_kernels
from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.experiment import Experiment
from twinmatch.dynamics.laws import LawCode
from twinmatch.dynamics.loop import Law
from twinmatch.dynamics.plant import Parameters
from twinmatch.dynamics.runs import Tangents
from twinmatch.dynamics.simulation import law_code, n_references, signal_rows
from twinmatch.dynamics.variances import foresee_each, noise_effects
from twinmatch.signals import FloatArray, finite


class Wanted(IntEnum):
    """What is to be forecast of a twin."""

    NOTHING = 0
    MEAN = variance_kernels.MEAN
    BANDED = variance_kernels.BANDED
    """Mean and variance."""


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


class TwinsNow(NamedTuple):
    """Some twins of one plant at a sample."""

    states: FloatArray
    """A row for each, with zeros behind where others have more."""
    covariances: FloatArray
    """Those of states and unsure parameters, flat, in the same way."""
    input: FloatArray
    """u of that sample, which acts until the next, shape (m,)."""
    law: LawCode
    memory: FloatArray
    """State of the law after that sample, shape (q,)."""


class Foresight:
    """Forecasts of closed loops, or of plants under known inputs, beyond the newest sample: by some twins of
    one plant, in one compiled call. What does not change from sample to sample is checked once. A twin whose
    equations are external is alone.

    The mean is that of `advance` and `simulate_closed_loop` (or `simulate_driven`). The variances are those
    of small deviations from it, exact around the loop; where u is on a limit, its variance is zero. They
    include the uncertainty of states and parameters, the drift of the states, and the sensors' noise as it
    circulates in the loop.
    """

    def __init__(
        self,
        twins: Sequence[tuple[Parameters, Sequence[str]]],
        loop: Law | None,
        *,
        drift: Sequence[ArrayLike],
        period: float = 1.0,
        noise: ArrayLike | None = None,
        swift: float = 0.0,
    ) -> None:
        """Prepare forecasts.

        Args:
            twins: of each the parameters, and the names of those unsure.
            loop: the controller; None: inputs are given instead of set-points.
            drift: of each twin the standard deviation of the drift of each state from the equations per
                second, shape (n,).
            period: sample time of driven plants, s; for a loop the controller's is used.
            noise: standard deviation of a reading, or of those of each output; default: the plant file's.
            swift: standard deviation of the error of a state's movement over a sample, as a share of it.

        Raises:
            PlantError: a signal or a name is invalid, or the plant is too fast.
        """
        model = twins[0][0].model
        period = float(period if loop is None else loop.period)
        self._model = model
        self._name = "inputs" if loop is None else "set-points"
        self._loop = loop
        self._columns = n_references(model.plant, loop)
        self._kernels = [
            parameters.model.kernels_by(unsure) for parameters, unsure in twins
        ]
        self.sizes = np.array(
            [_sizes_of(parameters, unsure) for parameters, unsure in twins]
        )
        most, _, widest = self.sizes.max(axis=0)
        self._process_noise = np.zeros((len(twins), most + widest))
        unknown_places = []
        for i, ((parameters, unsure), deviations) in enumerate(
            zip(twins, drift, strict=True)
        ):
            n = len(parameters.model.states)
            title = parameters.model.title
            _require_names(title, unsure, parameters.model.names)
            unknown_places.append(
                2 * [self._kernels[i].UNKNOWN.index(name) for name in unsure]
            )
            self._process_noise[i, :n] = (
                np.square(_fit(title, "drift", deviations, (n,))) * period
            )
        self._which = _in_rows(unknown_places, np.int64)
        self._vectors = _in_rows(
            [parameters.vector for parameters, _ in twins], np.float64
        )
        self._steps = np.array([parameters.steps(period) for parameters, _ in twins])
        noise_of_readings = model.noise if noise is None else np.atleast_1d(noise)
        noises = _fit(model.title, "noise", noise_of_readings, model.noise.shape)
        self._then = period, noises * noises, float(swift)
        if not model.is_external:
            self._codes = np.stack([kernels.code for kernels in self._kernels])

    def at(
        self,
        states: Sequence[FloatArray],
        covariances: Sequence[ArrayLike],
        input: ArrayLike,
        controller: ArrayLike | None,
    ) -> TwinsNow:
        """The twins at a sample.

        Args:
            states: of each twin, corrected by the readings of that sample, shape (n,).
            covariances: of each, that of states and unsure parameters, shape (n + k, n + k); symmetric.
            input: u of that sample, which acts until the next, shape (m,); for one input also a number.
            controller: state of the controller after it.

        Raises:
            PlantError: a signal is invalid, or the controller is not known.
        """
        title = self._model.title
        most, _, widest = self.sizes.max(axis=0)
        starts = np.zeros((len(states), most))
        joints = np.zeros((len(states), (most + widest) ** 2))
        for i, (n, _, k) in enumerate(self.sizes.tolist()):
            starts[i, :n] = _fit(title, "states", states[i], (n,))
            joints[i, : (n + k) ** 2] = _fit(
                title, "covariance", covariances[i], (n + k, n + k)
            ).ravel()
        u = _fit(
            title,
            "newest input",
            np.atleast_1d(input),
            (len(self._model.plant.drives),),
        )
        return TwinsNow(starts, joints, u, *law_code(self._loop, controller))

    def ahead(
        self,
        now: TwinsNow,
        signal: ArrayLike | None,
        disturbances: ArrayLike | None = None,
        *,
        banded: bool = True,
    ) -> LoopForecast:
        """The forecast of a single twin.

        Args:
            now: the twin.
            signal: set-points from the next sample on, shape (N,) or (N, r); of a driven plant the inputs.
            disturbances: constant, shape (d,), or from the newest sample on, shape (N + 1, d).
            banded: whether the variances are wanted, two thirds of the work; without, they are empty.

        Raises:
            PlantError: a signal is invalid.
        """
        means, variances = self.each(
            now, [Wanted.BANDED if banded else Wanted.MEAN], signal, disturbances
        )
        many = self._model.noise.size
        shown = variances[0] if banded else variances[0, :, :0]
        return LoopForecast(
            means[0, :many].T, means[0, many:].T, shown[:many].T, shown[many:].T
        )

    def each(
        self,
        now: TwinsNow,
        wanted: Sequence[Wanted],
        signal: ArrayLike | None,
        disturbances: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Means and variances of outputs, then inputs, of all twins, shape (C, o + m, N); NaN is what is
        not `wanted`.

        Raises:
            PlantError: as `ahead`.
        """
        period, noise, swift = self._then
        arguments = (
            self.sizes,
            self._vectors,
            self._which,
            now.states,
            now.covariances,
            self._process_noise,
            self._steps,
            np.array(wanted),
            *now[2:],
            *self._rows(signal, disturbances),
            period,
            noise,
            swift,
        )
        forecasts: tuple[FloatArray, FloatArray]
        if self._model.is_external:
            forecasts = self._kernels[0].foresee_each(*arguments)
        else:
            forecasts = foresee_each(self._codes, *arguments)
        return forecasts

    def _rows(
        self, signal: ArrayLike | None, disturbances: ArrayLike | None
    ) -> tuple[FloatArray, FloatArray]:
        model = self._model
        references = signal_rows(model.title, self._name, signal, self._columns)
        size = len(references) + 1
        if disturbances is not None and np.ndim(disturbances) == 1:
            disturbances = np.tile(model.disturbance_row(disturbances), (size, 1))
        return references, model.disturbance_rows(disturbances, size)


def _in_rows(
    values: Sequence[Sequence[float] | FloatArray], dtype: type[np.number[Any]]
) -> NDArray[Any]:
    """Values of several lengths in the rows of one array, zeros behind them."""
    rows = np.zeros((len(values), max(map(len, values))), dtype=dtype)
    for row, row_values in zip(rows, values, strict=True):
        row[: len(row_values)] = row_values
    return rows


def _sizes_of(parameters: Parameters, unsure: Sequence[str]) -> tuple[int, int, int]:
    """Numbers of states, of parameters, and of those unsure."""
    return len(parameters.model.states), parameters.vector.size, len(unsure)


def _require_names(title: str, names: Sequence[str], declared: Sequence[str]) -> None:
    for name in names:
        if name not in declared:
            raise PlantError(
                f"{title}: no parameter {name!r}; there are {', '.join(declared)}"
            )


def _fit(
    title: str, name: str, values: ArrayLike, shape: tuple[int, ...]
) -> FloatArray:
    """Copy values into an array for the compiled code, and check shape and values."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not finite(array):
        bad = (
            f"of shape {array.shape}"
            if array.shape != shape
            else "with a value that is not finite"
        )
        raise PlantError(
            f"{title}: {name} {bad} given; give finite values of shape {shape}"
        )
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
    effects: tuple[FloatArray, float] = noise_effects(
        tangents,
        experiment.start_slope,
        np.ascontiguousarray(weighed),
        np.ascontiguousarray(weights, dtype=np.float64),
        experiment.closed,
    )
    return effects
