"""States that no sensor shows, followed through the output: an extended Kalman filter on the plant's own
tick, which can carry slowly changing parameters along."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.simulation import begin
from twinmatch.signals import FloatArray

__all__ = ["Observer", "Wander"]

_STEPS_ANEW = 60
"""Samples after which wandering parameters are asked anew for their Runge–Kutta steps."""


class Wander(NamedTuple):
    """How a parameter changes that is carried along with the states."""

    drift: float
    """Standard deviation by which it changes in a second, in its unit; grows with the root of time."""
    start: float
    """Standard deviation at the start."""


class Observer:
    """States and their covariance, sample by sample; first `correct`, then `predict`, and so on."""

    def __init__(
        self,
        parameters: Parameters,
        output: float | None = None,
        *,
        period: float,
        drift: ArrayLike,
        start: ArrayLike | None = None,
        disturbances: ArrayLike | None = None,
        states: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        wandering: Mapping[str, Wander] | None = None,
        limit: float = math.inf,
    ) -> None:
        """Begin with the plant file's start at this output, or anywhere in a session with given states.

        Args:
            parameters: the plant.
            output: first reading; not needed if the states are given.
            period: sample time, s.
            drift: standard deviation by which each state strays from the equations in a second, shape (n,).
            start: standard deviation of each state at the start, shape (n,); or give the covariance.
            disturbances: at the first sample.
            states: shape (n,), instead of those that the plant file makes of the output.
            covariance: of the states, shape (n, n), or of states and wandering parameters, (n + m, n + m).
            wandering: m parameters that change slowly and are followed like states, inside their bounds.
            limit: surprise, in its standard deviations, beyond which a larger one moves no further: for
                sensors with single wrong readings, such as a camera that corrects its flat field.

        Raises:
            PlantError: a value is unfit, a name is no parameter, or the plant is too fast for the period.
        """
        model = parameters.model
        self._title, self._model = model.title, model
        wandering = wandering or {}
        self.wandering = tuple(wandering)
        """Names of the parameters that are carried along, in the order of the joint covariance."""
        unknown = [name for name in wandering if name not in model.names]
        if unknown:
            msg = f"{model.title}: {unknown[0]!r} cannot wander; there are {', '.join(model.names)}"
            raise PlantError(msg)
        self._kernels = model.kernels_by(self.wandering)
        n, m = len(model.states), len(wandering)
        among = (self._kernels.UNKNOWN, model.names)
        self._which = np.array(
            [[names.index(name) for name in wandering] for names in among], dtype=np.int64
        ).reshape(2, m)
        self._period = float(period)
        rates = [*self._deviations("drift", drift, n), *(w.drift for w in wandering.values())]
        self._strayed = np.square(self._deviations("drift", rates, n + m)) * self._period
        if not limit > 0:
            raise PlantError(f"{model.title}: the observer's limit is {limit}; it must be positive")
        self._limit, self._noise = float(limit), float(model.plant.output.noise)
        self._row = model.disturbance_row(disturbances)
        if states is None:
            if output is None:
                raise PlantError(f"{model.title}: an observer begins at an output or at states; give one")
            states = begin(parameters, output, disturbances=self._row)
        self.states = states
        self._joint = self._first_covariance(start, covariance, [w.start for w in wandering.values()])
        self._columns = np.zeros((n, m + n + 1))
        self.parameters = parameters

    @property
    def parameters(self) -> Parameters:
        """The plant; of parameters that wander, their values now.

        Others of the same model may be given at any sample: the states and all covariance stay.

        Raises:
            PlantError: they are another model's, for which the states mean nothing.
        """
        if not self.wandering:
            return self._parameters
        found = zip(self.wandering, self._vector[self._which[1]].tolist(), strict=True)
        return self._parameters.replace(**dict(found))

    @parameters.setter
    def parameters(self, parameters: Parameters) -> None:
        if parameters.model is not self._model:
            msg = f"{self._title}: parameters of {parameters.model.title} given; make a new observer"
            raise PlantError(msg)
        self._parameters, self._vector = parameters, parameters.vector.copy()
        self._steps, self._ticks = parameters.steps(self._period), 0
        spans = [self._model.declared[name].bounds for name in self.wandering]
        values = self._vector[self._which[1]]
        low, high = np.array(spans, dtype=np.float64).reshape(-1, 2).T
        self._bounds = np.stack([np.minimum(low, values), np.maximum(high, values)])

    @property
    def states(self) -> FloatArray:
        """Shape (n,)."""
        return self._states.copy()

    @states.setter
    def states(self, states: ArrayLike) -> None:
        held = np.array(states, dtype=np.float64)
        if held.shape != (len(self._model.states),) or not np.isfinite(held).all():
            msg = (
                f"{self._title}: states {held.tolist()} given; it takes finite values of "
                f"{', '.join(self._model.states)}"
            )
            raise PlantError(msg)
        self._states: FloatArray = held

    @property
    def covariance(self) -> FloatArray:
        """Of the states, shape (n, n)."""
        n = self._states.size
        return self._joint[:n, :n].copy()

    @property
    def joint(self) -> FloatArray:
        """Covariance of the states and, after them, of the parameters that wander, shape (n + m, n + m)."""
        return self._joint.copy()

    def correct(self, output: float, disturbances: ArrayLike | None = None) -> tuple[float, float]:
        """Take a reading; return by how much it surprised, and the variance that surprise was to have.

        Raises:
            PlantError: the reading or a disturbance is not finite, and nothing has moved; or the equations
                mean nothing any more at the states, and a new observer has to begin.
        """
        if not math.isfinite(output):
            raise PlantError(f"{self._title}: the reading is {output}; only finite values can be used")
        self._row = (
            self._model.disturbances if disturbances is None else self._model.disturbance_row(disturbances)
        )
        found: tuple[float, float] = self._kernels.correct(
            self._vector,
            self._states,
            self._joint,
            float(output),
            self._row,
            self._noise,
            self._limit,
            self._which,
            self._bounds,
        )
        if not math.isfinite(found[0] + found[1]):
            msg = f"{self._title}: its equations give nothing at the states that the observer has come to"
            raise PlantError(f"{msg}; begin a new one")
        return found

    def predict(self, input: float) -> None:
        """Move on by one period under an input.

        Raises:
            PlantError: the input is not finite; nothing has moved then.
        """
        if not math.isfinite(input):
            raise PlantError(f"{self._title}: the input is {input}; the plant takes only finite values")
        if self.wandering:
            self._ticks += 1
            if self._ticks % _STEPS_ANEW == 0:
                self._steps = self._model.steps(self._vector, self._period)
        self._kernels.predict(
            self._vector,
            self._states,
            self._joint,
            self._strayed,
            float(input),
            self._row,
            self._period,
            self._steps,
            self._which,
            self._columns,
        )

    def _first_covariance(
        self, start: ArrayLike | None, covariance: ArrayLike | None, wandering: list[float]
    ) -> FloatArray:
        n, m = self._states.size, len(wandering)
        if (start is None) == (covariance is None):
            msg = f"{self._title}: give an observer's start (standard deviations) or its covariance, not both"
            raise PlantError(msg)
        joint = np.diag(np.square(self._deviations("start", [0.0] * n + wandering, n + m)))
        if covariance is None:
            joint[:n, :n] = np.diag(np.square(self._deviations("start", start, n)))
            return joint
        given = np.array(covariance, dtype=np.float64)
        if given.shape not in {(n, n), (n + m, n + m)} or not np.isfinite(given).all():
            msg = f"{self._title}: a covariance of shape {given.shape} given; it takes finite ({n}, {n})"
            raise PlantError(f"{msg} or ({n + m}, {n + m})" if m else msg)
        size = given.shape[0]
        joint[:size, :size] = 0.5 * (given + given.T)
        return joint

    def _deviations(self, name: str, values: ArrayLike | None, size: int) -> FloatArray:
        held = np.array(values, dtype=np.float64)
        if held.shape != (size,) or not (np.isfinite(held) & (held >= 0)).all():
            msg = (
                f"{self._title}: {name} {held.tolist()} given; it takes {size} finite standard deviations, "
                f"none negative ({', '.join((*self._model.states, *self.wandering)[:size])})"
            )
            raise PlantError(msg)
        return held
