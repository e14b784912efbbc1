"""States that no sensor shows, followed through the output: an extended Kalman filter on the plant's own
tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.simulation import begin
from twinmatch.signals import FloatArray

__all__ = ["Observer"]


class Observer:
    """States and their covariance, sample by sample; first `correct`, then `predict`, and so on."""

    def __init__(
        self,
        parameters: Parameters,
        output: float,
        *,
        period: float,
        drift: ArrayLike,
        start: ArrayLike,
        disturbances: ArrayLike | None = None,
    ) -> None:
        """Begin with the plant file's start at this output.

        Args:
            parameters: the plant.
            output: first reading.
            period: sample time, s.
            drift: standard deviation by which each state strays from the equations in a second, shape (n,).
            start: standard deviation of each state at the start, shape (n,).
            disturbances: at the first sample.
        """
        self.parameters = parameters
        row = parameters.model.disturbance_row(disturbances)
        self.states = begin(parameters, output, disturbances=row)
        self.covariance: FloatArray = np.diag(np.square(np.asarray(start, dtype=np.float64)))
        self._drift = np.diag(np.square(np.asarray(drift, dtype=np.float64))) * period
        self._period = period
        self._row = row

    def correct(self, output: float, disturbances: ArrayLike | None = None) -> tuple[float, float]:
        """Take a reading; return by how much it surprised, and the variance that surprise was to have."""
        model = self.parameters.model
        vector, rest = self.parameters.vector, model.plant.drive.rest
        self._row = model.disturbance_row(disturbances)
        seen = model.kernels.look(vector, self.states, rest, self._row)[0]
        slope = model.kernels.slopes_at(vector, self.states, rest, self._row)[4]
        reach = self.covariance @ slope
        variance = float(slope @ reach) + model.plant.output.noise**2
        surprise = float(output) - float(seen)
        gain = reach / variance
        self.states = self.states + gain * surprise
        kept = np.eye(slope.size) - np.outer(gain, slope)
        noise = model.plant.output.noise**2 * np.outer(gain, gain)
        self.covariance = kept @ self.covariance @ kept.T + noise
        return surprise, variance

    def predict(self, input: float) -> None:
        """Move on by one period under an input."""
        self.states, by_state, _ = self.parameters.model.kernels.tick_slopes(
            self.parameters.vector,
            self.states,
            float(input),
            self._row,
            self._period,
            self.parameters.steps(self._period),
        )
        self.covariance = by_state @ self.covariance @ by_state.T + self._drift
