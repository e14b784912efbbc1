"""The twin that runs beside the plant, sample by sample."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from twinmatch.plant import Pid, PidGains, PlantState, RigParameters, advance
from twinmatch.signals import KELVIN, Sample

__all__ = ["Mirror", "MirrorState"]


@dataclass(frozen=True)
class MirrorState:
    """Both twins at one tick, before the tick's control acts on them."""

    sample: Sample
    closed_output: float
    """What is measured of the twin that is given the set-point and has a controller of its own."""
    closed_input: float
    """What that controller computes."""
    closed_states: tuple[float, ...]
    """Inner states of that twin, in the order and units of the plant's description."""
    driven_output: float
    """What is measured of the twin that is given the plant's input."""
    driven_states: tuple[float, ...]
    closed_residual_y: float
    """Measured minus closed-loop output."""
    closed_residual_u: float
    """Measured minus closed-loop input."""
    driven_residual_y: float
    """Measured minus driven output."""
    closed_rms_y: float
    """RMS of the residuals above over the newest samples, same units."""
    closed_rms_u: float
    driven_rms_y: float


class Mirror:
    """Mirrors the live inputs: the set-point into one twin, the control into another.

    New parameters take over without a jump: plates, sinks and controller keep their state. A gap in
    the samples starts both twins again from the measured temperature.
    """

    _closed: PlantState
    _driven: PlantState
    _pid: Pid

    def __init__(
        self, parameters: RigParameters | None = None, gains: PidGains | None = None, recent: int = 60
    ) -> None:
        """Start with these rig parameters; residuals are averaged over `recent` samples."""
        self.parameters = parameters or RigParameters()
        self._gains = gains or PidGains()
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=recent)
        self._previous: Sample | None = None
        self._started = 0

    def push(self, sample: Sample) -> MirrorState:
        """Take one sample; return where the twins are at its tick."""
        if self._previous is None or sample.index != self._previous.index + 1:
            self._restart(sample)
        if self._started < 2:
            # The controller's state follows from two recorded samples; until then it is the plant's.
            state = self._observe(sample, sample.input)
            self._pid.follow(sample.reference, sample.output, sample.input)
            self._started += 1
        else:
            closed = self._closed.sensor - KELVIN
            state = self._observe(sample, self._pid.step(sample.reference, closed))
        period = self._gains.period
        self._closed = advance(self.parameters, self._closed, state.closed_input, period)
        self._driven = advance(self.parameters, self._driven, sample.input, period)
        self._previous = sample
        return state

    def _restart(self, sample: Sample) -> None:
        start = PlantState(plate=sample.output + KELVIN, sink=self.parameters.ambient)
        self._closed = self._driven = start
        self._pid = Pid(self._gains)
        self._recent.clear()
        self._started = 0

    def _observe(self, sample: Sample, closed_input: float) -> MirrorState:
        closed, driven = self._closed.sensor - KELVIN, self._driven.sensor - KELVIN
        residual = (sample.output - closed, sample.input - closed_input, sample.output - driven)
        self._recent.append(residual)
        closed_rms_y, closed_rms_u, driven_rms_y = np.sqrt(np.mean(np.square(self._recent), axis=0))
        return MirrorState(
            sample=sample,
            closed_output=closed,
            closed_input=closed_input,
            closed_states=_states(self._closed),
            driven_output=driven,
            driven_states=_states(self._driven),
            closed_residual_y=residual[0],
            closed_residual_u=residual[1],
            driven_residual_y=residual[2],
            closed_rms_y=float(closed_rms_y),
            closed_rms_u=float(closed_rms_u),
            driven_rms_y=float(driven_rms_y),
        )


def _states(state: PlantState) -> tuple[float, ...]:
    return state.plate, state.sink, state.sensor
