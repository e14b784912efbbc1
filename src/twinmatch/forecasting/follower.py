"""State estimation of a twin beside the plant, so that it can forecast from any sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twinmatch.dynamics import Model, Observer, Parameters, PlantError
from twinmatch.signals import FloatArray, Sample

__all__ = ["Follower", "drift_of"]

DRIFT: Final = 2e-4
"""Drift of a state from the equations per second, in units of its span: 0.03 K on the rig."""
UNKNOWN: Final = 0.03
"""Initial uncertainty of a state, in units of its span: 4.5 K."""
LIMIT: Final = 4.0
"""Limit on innovations, in standard deviations: jumps of a self-correcting sensor are not the plant's."""


class Follower:
    """States of one twin from sample to sample, by an observer on the plant's own equations."""

    def __init__(
        self,
        parameters: Parameters,
        period: float,
        *,
        states: FloatArray | None = None,
        free: Sequence[str] = (),
        covariance: FloatArray | None = None,
    ) -> None:
        """Begin with the next sample.

        Args:
            parameters: parameters of the twin.
            period: sample time, s.
            states: states at the next sample, before its reading; default: the plant file's for its output.
            free: names of the parameters that were matched.
            covariance: covariance of these, shape (len(free), len(free)); default: they are exact.
        """
        self.parameters, self.period = parameters, period
        self.free = tuple(free) if covariance is not None else ()
        self.covariance = np.zeros((0, 0)) if covariance is None else covariance
        self._states = states
        self._observer: Observer | None = None
        self._input = 0.0

    def push(self, sample: Sample) -> None:
        """Take one sample, the next one in sequence.

        If the twin's equations have no finite value at the states, the observer is restarted here.
        """
        row = np.array(sample.disturbances) if sample.disturbances else None
        if self._observer is not None:
            self._observer.predict(self._input)
            try:
                self._observer.correct(sample.output, row)
            except PlantError:
                self.restart()
        if self._observer is None:
            self._observer = Observer(
                self.parameters,
                sample.output,
                period=self.period,
                drift=drift_of(self.parameters.model),
                start=UNKNOWN * _spans(self.parameters.model),
                input=sample.input,
                disturbances=row,
                states=self._states,
                limit=LIMIT,
            )
            self._observer.correct(sample.output, row)
        self._input = sample.input

    def restart(self) -> None:
        """Forget the states: the next sample does not follow the last one."""
        self._observer = self._states = None

    @property
    def states(self) -> FloatArray:
        """States at the newest sample, corrected by its reading, shape (n,)."""
        return self._started.states

    @property
    def state_covariance(self) -> FloatArray:
        """Covariance of the states, shape (n, n)."""
        return self._started.covariance

    @property
    def joint(self) -> FloatArray:
        """Covariance of states and free parameters, assumed independent, shape (n + m, n + m)."""
        n, m = self.states.size, len(self.free)
        joint = np.zeros((n + m, n + m))
        joint[:n, :n], joint[n:, n:] = self.state_covariance, self.covariance
        return joint

    @property
    def _started(self) -> Observer:
        assert self._observer is not None, "a follower needs a first sample"  # noqa: S101
        return self._observer


def drift_of(model: Model) -> FloatArray:
    """Standard deviation of the drift of each state from the equations per second, shape (n,)."""
    return DRIFT * _spans(model)


def _spans(model: Model) -> FloatArray:
    low, high = np.array([state.span for state in model.declared_states], dtype=np.float64).T
    return np.asarray(high - low, dtype=np.float64)
