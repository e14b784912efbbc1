"""A twin carried beside the plant, so that it can foretell from any sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twinmatch.dynamics import Model, Observer, Parameters, PlantError
from twinmatch.signals import FloatArray, Sample

__all__ = ["Follower", "drift_of"]

DRIFT: Final = 2e-4
"""How far a state may stray from the equations in a second, in units of its span: 0.03 K on the rig."""
UNKNOWN: Final = 0.03
"""How uncertain a state is at the start, in units of its span: 4.5 K."""
LIMIT: Final = 4.0
"""Standard deviations of surprise at which a reading moves the states no further: a sensor that corrects
itself is not the plant."""


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
            parameters: of the twin.
            period: sample time, s.
            states: at the next sample, before its reading; what the plant file says of its output if not
                given.
            free: names of the parameters that were matched.
            covariance: of these, shape (len(free), len(free)); none if not given.
        """
        self.parameters, self.period = parameters, period
        self.free = tuple(free) if covariance is not None else ()
        self.covariance = np.zeros((0, 0)) if covariance is None else covariance
        self._states = states
        self._observer: Observer | None = None
        self._input = 0.0

    def push(self, sample: Sample) -> None:
        """Take one sample; it follows the one before it.

        States at which the twin's equations mean nothing any more are given up, and it begins anew here.
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
                disturbances=row,
                states=self._states,
                limit=LIMIT,
            )
            self._observer.correct(sample.output, row)
        self._input = sample.input

    def restart(self) -> None:
        """Forget what was read: the next sample does not follow the last one."""
        self._observer = self._states = None

    @property
    def states(self) -> FloatArray:
        """At the newest sample, its reading taken in, shape (n,)."""
        return self._followed.states

    @property
    def state_covariance(self) -> FloatArray:
        """Of those, shape (n, n)."""
        return self._followed.covariance

    @property
    def joint(self) -> FloatArray:
        """Of states and free parameters, which are taken to err on their own, shape (n + m, n + m)."""
        n, m = self.states.size, len(self.free)
        joint = np.zeros((n + m, n + m))
        joint[:n, :n], joint[n:, n:] = self.state_covariance, self.covariance
        return joint

    @property
    def _followed(self) -> Observer:
        assert self._observer is not None, "a follower is asked after its first sample"  # noqa: S101
        return self._observer


def drift_of(model: Model) -> FloatArray:
    """Standard deviation by which each state strays from the equations in a second, shape (n,)."""
    return DRIFT * _spans(model)


def _spans(model: Model) -> FloatArray:
    low, high = np.array([state.span for state in model.declared_states], dtype=np.float64).T
    return np.asarray(high - low, dtype=np.float64)
