"""Observer for unmeasured states: an extended Kalman filter on the plant's own tick, which can also estimate
slowly changing parameters.

How far a plant drifts from its equations depends on what they leave out. An observer that is given too little
of it holds on to its equations and no longer sees the readings: on a motor with stick-slip it was further off
after one sample than the reading itself. One that is given too much follows the noise of each reading. So the
assumed drift may be adapted until successive innovations are not correlated, which is so at the best filter
whatever the readings' noise is (Mehra, IEEE TAC 15, 1970): they have the same sign while too little is
assumed, and opposite ones while too much is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.filters import adapt, follow
from twinmatch.dynamics.plant import Model, Parameters
from twinmatch.dynamics.simulation import begin, signal_rows
from twinmatch.signals import FloatArray, finite


class RandomWalk(NamedTuple):
    """Random walk of a parameter that is estimated with the states."""

    drift: float
    """Standard deviation of its change per second, in its unit; grows with the root of time."""
    start: float
    """Initial standard deviation."""


class KernelArguments(NamedTuple):
    """What compiled code needs of an observer, and does not change."""

    model: Model
    code: NDArray[np.int64]
    vector: FloatArray
    """Parameters, shape (p,)."""
    steps: int
    """Integration steps in a period."""
    period: float
    """Sample time, s."""
    noise: FloatArray
    """Standard deviations of the readings, shape (o,)."""
    limit: float
    n_states: int
    n_disturbances: int
    n_adaptation: int
    """Size of its `adaptation`."""


class ObserverArrays(NamedTuple):
    """What compiled code changes of an observer."""

    states: FloatArray
    """Shape (n,)."""
    joint: FloatArray
    """Covariance of the states, shape (n, n)."""
    process_noise: FloatArray
    """Variances added in a period, shape (n,)."""
    adaptation: FloatArray
    """By how much these exceed the variances given, and the newest innovations, as `filters.adapt` describes
    them; shape (1 + o,), or (0,) if it does not adapt."""
    disturbances: FloatArray
    """Those at the newest sample, shape (d,)."""


class Observer:
    """States and their covariance, sample by sample: call `correct`, then `predict`, alternately."""

    def __init__(
        self,
        parameters: Parameters,
        output: ArrayLike | None = None,
        *,
        period: float,
        drift: ArrayLike,
        start: ArrayLike | None = None,
        input: ArrayLike | None = None,
        disturbances: ArrayLike | None = None,
        states: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        random_walks: Mapping[str, RandomWalk] | None = None,
        limit: float = math.inf,
        adaptive: bool = False,
    ) -> None:
        """Start from the plant file's initial states at this output, or anywhere from given states.

        Args:
            parameters: the plant.
            output: first readings, shape (o,), or a number; not needed if the states are given.
            period: sample time, s.
            drift: standard deviation of the drift of each state from the equations per second, shape (n,).
            start: initial standard deviation of each state, shape (n,); or give the covariance.
            input: inputs until the first sample, shape (i,), or a number; default: at rest.
            disturbances: those at the first sample.
            states: initial states, shape (n,), instead of those computed from the output.
            covariance: that of the states, shape (n, n), or of states and estimated parameters,
                (n + m, n + m).
            random_walks: m parameters that change slowly and are estimated like states, inside their bounds.
            limit: innovation, in standard deviations, to which larger ones are clipped: for sensors with
                single wrong readings, such as a camera that corrects its flat field.
            adaptive: assume more drift than given while successive innovations have the same sign, and less
                while they have opposite ones.

        Raises:
            PlantError: a value is invalid, a name is not a parameter, or the plant is too fast for the
            period.
        """
        model = parameters.model
        walks = random_walks or {}
        self._title = model.title
        self._model = model
        self.estimated = tuple(walks)
        """Names of the estimated parameters, in the order of the joint covariance."""
        self._require_parameters(self.estimated)
        self._kernels = model.kernels_by(self.estimated)
        self._which = self._places_of_estimated()
        self._period = float(period)
        self._process_noise = self._variances_in_a_period(drift, walks)
        self._adaptation = np.zeros(0)
        if adaptive:
            self._adaptation = np.array([1.0, *np.zeros_like(model.noise)])
        if not limit > 0:
            raise PlantError(
                f"{model.title}: the observer's limit is {limit}; it must be positive"
            )
        self._limit = float(limit)
        self._noise = model.noise
        self._row = model.disturbance_row(disturbances)
        if states is None:
            if output is None:
                raise PlantError(
                    f"{model.title}: an observer starts from an output or from states; give one"
                )
            states = begin(parameters, output, input=input, disturbances=self._row)
        self.states = states
        self._joint = self._first_covariance(
            start, covariance, [walk.start for walk in walks.values()]
        )
        self.parameters = parameters

    @property
    def parameters(self) -> Parameters:
        """Parameters of the plant, with the current estimates of those that are estimated.

        Others of the same model may be set at any sample: states and covariance are kept.

        Raises:
            PlantError: they belong to another model, whose states differ.
        """
        if not self.estimated:
            return self._parameters
        estimates = zip(
            self.estimated, self._vector[self._which[1]].tolist(), strict=True
        )
        return self._parameters.replace(**dict(estimates))

    @parameters.setter
    def parameters(self, parameters: Parameters) -> None:
        if parameters.model is not self._model:
            msg = f"{self._title}: parameters of {parameters.model.title} given; make a new observer"
            raise PlantError(msg)
        self._parameters = parameters
        self._vector = parameters.vector.copy()
        self._steps = parameters.steps(self._period)
        spans = [self._model.declared[name].bounds for name in self.estimated]
        values = self._vector[self._which[1]]
        low, high = np.array(spans, dtype=np.float64).reshape(-1, 2).T
        self._bounds = np.stack([np.minimum(low, values), np.maximum(high, values)])

    @property
    def vector(self) -> FloatArray:
        """Values of `parameters` in the model's order, shape (p,)."""
        return self._vector.copy()

    @property
    def steps(self) -> int:
        """Integration steps of a period, as in the last prediction."""
        return self._steps

    @property
    def states(self) -> FloatArray:
        """Estimated states, shape (n,)."""
        return self._states.copy()

    @states.setter
    def states(self, states: ArrayLike) -> None:
        given = np.array(states, dtype=np.float64)
        if given.shape != (len(self._model.states),) or not finite(given):
            raise PlantError(
                f"{self._title}: states {given.tolist()} given; give finite values of "
                f"{', '.join(self._model.states)}"
            )
        self._states: FloatArray = given

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the states, shape (n, n)."""
        n = self._states.size
        return self._joint[:n, :n].copy()

    @property
    def joint(self) -> FloatArray:
        """Covariance of the states and, after them, of the estimated parameters, shape (n + m, n + m)."""
        return self._joint.copy()

    def correct(
        self,
        output: ArrayLike,
        disturbances: ArrayLike | None = None,
        input: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Take the readings of a sample, shape (o,), or a number, under its inputs (default: the drives at
        rest), which count where an output depends on them at once; return their innovations, each given the
        readings before it, and the variances expected of them.

        Raises:
            PlantError: the reading or a disturbance is not finite (the observer is then unchanged); or the
                equations have no finite value at the estimated states, and a new observer is needed.
        """
        y = self._model.row_of("outputs", output)
        self._row = self._model.disturbance_row(disturbances)
        u = self._model.rest if input is None else self._model.row_of("inputs", input)
        correction: tuple[FloatArray, FloatArray] = self._kernels.correct(
            self._vector,
            self._states,
            self._joint,
            y,
            self._row,
            u,
            self._noise,
            self._limit,
            self._which,
            self._bounds,
        )
        if not math.isfinite(correction[0].sum() + correction[1].sum()):
            msg = f"{self._title}: its equations have no finite value at the observer's states"
            raise PlantError(f"{msg}; start a new observer")
        adapt(self._process_noise, self._adaptation, *correction)
        return correction

    def predict(self, input: ArrayLike) -> None:
        """Move on by one period under inputs, shape (i,), or a number.

        Raises:
            PlantError: the input is not finite; the observer is then unchanged.
        """
        u = self._model.row_of("inputs", input)
        if self.estimated:
            self._steps = self._model.steps(self._vector, self._period)
        self._kernels.predict(
            self._vector,
            self._states,
            self._joint,
            self._process_noise,
            u,
            self._row,
            self._period,
            self._steps,
            self._which,
        )

    @property
    def kernel_arguments(self) -> KernelArguments:
        """What compiled code needs to move it."""
        return KernelArguments(
            model=self._model,
            code=self._kernels.code,
            vector=self._vector,
            steps=self._steps,
            period=self._period,
            noise=self._noise,
            limit=self._limit,
            n_states=self._states.size,
            n_disturbances=self._row.size,
            n_adaptation=self._adaptation.size,
        )

    def move_into(self, arrays: ObserverArrays) -> None:
        """Keep its numbers in these arrays from now on, so that others can move it with many at once."""
        arrays.states[:] = self._states
        arrays.joint[:] = self._joint
        arrays.process_noise[:] = self._process_noise
        arrays.adaptation[:] = self._adaptation
        arrays.disturbances[:] = self._row
        self._states = arrays.states
        self._joint = arrays.joint
        self._process_noise = arrays.process_noise
        self._adaptation = arrays.adaptation
        self._row = arrays.disturbances

    def _require_parameters(self, names: Sequence[str]) -> None:
        """Raise an error for the first of these that is not a parameter."""
        parameters = self._model.names
        for name in names:
            if name not in parameters:
                raise PlantError(
                    f"{self._title}: {name!r} cannot be estimated; choose from {', '.join(parameters)}"
                )

    def _places_of_estimated(self) -> NDArray[np.int64]:
        """Where the m estimated parameters are among those that compiled code may estimate and among all,
        shape (2, m)."""
        places = np.zeros((2, len(self.estimated)), dtype=np.int64)
        for k, name in enumerate(self.estimated):
            places[0, k] = self._kernels.UNKNOWN.index(name)
            places[1, k] = self._model.names.index(name)
        return places

    def _variances_in_a_period(
        self, drift: ArrayLike, walks: Mapping[str, RandomWalk]
    ) -> FloatArray:
        """Variances that a period adds to the states and, after them, to the estimated parameters."""
        n = len(self._model.states)
        of_states = self._deviations("drift", drift, n)
        of_walks = [walk.drift for walk in walks.values()]
        per_second = self._deviations(
            "drift", [*of_states, *of_walks], n + len(of_walks)
        )
        return np.asarray(np.square(per_second) * self._period)

    def _first_covariance(
        self,
        start: ArrayLike | None,
        covariance: ArrayLike | None,
        estimated: list[float],
    ) -> FloatArray:
        n = self._states.size
        m = len(estimated)
        if (start is None) == (covariance is None):
            msg = f"{self._title}: give an observer's start (standard deviations) or its covariance, not both"
            raise PlantError(msg)
        joint = np.diag(
            np.square(self._deviations("start", [0.0] * n + estimated, n + m))
        )
        if covariance is None:
            joint[:n, :n] = np.diag(np.square(self._deviations("start", start, n)))
            return joint
        matrix = np.array(covariance, dtype=np.float64)
        if matrix.shape not in {(n, n), (n + m, n + m)} or not finite(matrix):
            msg = f"{self._title}: a covariance of shape {matrix.shape} given; give finite values, ({n}, {n})"
            raise PlantError(f"{msg} or ({n + m}, {n + m})" if m else msg)
        size = matrix.shape[0]
        joint[:size, :size] = 0.5 * (matrix + matrix.T)
        return joint

    def _deviations(self, name: str, values: ArrayLike | None, size: int) -> FloatArray:
        deviations = np.array(values, dtype=np.float64)
        if (
            deviations.shape != (size,)
            or not (np.isfinite(deviations) & (deviations >= 0)).all()
        ):
            raise PlantError(
                f"{self._title}: {name} {deviations.tolist()} given; give {size} finite standard deviations, "
                f"none negative ({', '.join((*self._model.states, *self.estimated)[:size])})"
            )
        return deviations


class ObserverBank:
    """Observers of one plant's models that take the same samples, moved on by one compiled call.

    Their states and covariances lie in its arrays from then on. None of them estimates parameters.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        """Begin with at least one observer; all have the same period, limit and noise; all adapt or none."""
        count = len(observers)
        all_arguments = [observer.kernel_arguments for observer in observers]
        first = all_arguments[0]
        self._model = first.model
        self._same = (first.period, first.noise, first.limit)
        self._sizes = np.zeros((count, 2), dtype=np.int64)
        self._codes = np.stack([arguments.code for arguments in all_arguments])
        self._steps = np.array(
            [arguments.steps for arguments in all_arguments], dtype=np.int64
        )
        for i, arguments in enumerate(all_arguments):
            self._sizes[i] = arguments.n_states, arguments.vector.size
        most, longest = self._sizes.max(axis=0)
        self._vectors = np.zeros((count, longest))
        self._states = np.zeros((count, most))
        self._noises = np.zeros((count, most))
        self._joints = np.zeros((count, most * most))
        self._rows = np.zeros((count, first.n_disturbances))
        self._adaptations = np.zeros((count, first.n_adaptation))
        for i, observer in enumerate(observers):
            n, m = self._sizes[i]
            self._vectors[i, :m] = all_arguments[i].vector
            arrays = ObserverArrays(
                states=self._states[i, :n],
                joint=self._joints[i, : n * n].reshape(n, n),
                process_noise=self._noises[i, :n],
                adaptation=self._adaptations[i],
                disturbances=self._rows[i],
            )
            observer.move_into(arrays)

    def push(
        self,
        inputs: ArrayLike,
        outputs: ArrayLike,
        seen: ArrayLike = (True,),
        disturbances: ArrayLike | None = None,
        now: ArrayLike | None = None,
    ) -> list[int]:
        """Move on by N periods, each under the inputs of the sample before, shape (N, i), to the readings,
        shape (N, o), that were `seen`, shape (N,), under the inputs `now` of these samples (default: the
        drives at rest), which count where an output depends on them at once; signals of one column may have
        shape (N,).

        Returns:
            Of each observer, how many samples it took: fewer than N if its equations had no finite value at
            the next; then nothing of it is of use.
        """
        model = self._model
        m = model.rest.size
        inputs_before = signal_rows(model.title, "input", inputs, m)
        size = len(inputs_before)
        inputs_now = np.tile(model.rest, (size, 1))
        if now is not None:
            inputs_now = signal_rows(model.title, "input", now, m)
        _, noise, _ = self._same
        counts: list[int] = follow(
            self._codes,
            self._sizes,
            self._vectors,
            self._states,
            self._joints,
            self._noises,
            self._adaptations,
            self._rows,
            self._steps,
            inputs_before,
            inputs_now,
            np.array(seen, dtype=np.bool_),
            np.array(outputs, dtype=np.float64).reshape(size, noise.size),
            model.disturbance_rows(disturbances, size),
            *self._same,
        ).tolist()
        return counts
