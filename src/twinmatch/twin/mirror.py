"""The twin beside the plant: sample by sample, or over a recorded window."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import (
    FROM_PLANT_FILE,
    SKIPPED,
    Controller,
    Drive,
    Experiment,
    Law,
    LoopLaw,
    Output,
    Parameters,
    Response,
    advance,
    begin,
    begin_window,
    law_for,
    readings,
    simulate_driven,
    simulate_window,
)
from twinmatch.fitting.problem import unknown_starts
from twinmatch.forecasting import StateFilter
from twinmatch.signals import (
    FloatArray,
    OperatingPoint,
    Sample,
    Signals,
    Window,
    point_of,
    rms,
)

_ESTIMATED_OVER: Final = 300.0
"""Newest stretch over which the states of a new structure are estimated, s, at a scale of 1."""


@dataclass(frozen=True)
class MirrorState:
    """Both twins at one tick, before the tick's inputs act on them; each signal as in `Sample`.

    Where the loop is not known there is only the driven twin; the values of the other are NaN.
    """

    sample: Sample
    closed_output: Signals
    """Outputs of the closed-loop twin, which follows the set-points with its own controller."""
    closed_input: Signals
    """Inputs from this controller."""
    closed_states: Mapping[str, float]
    """States of that twin by name, each in its unit."""
    driven_output: Signals
    """Outputs of the driven twin, which gets the plant's inputs."""
    driven_states: Mapping[str, float]
    closed_residual_y: Signals
    """Measured minus closed-loop outputs."""
    closed_residual_u: Signals
    """Measured minus closed-loop inputs."""
    driven_residual_y: Signals
    """Measured minus driven outputs."""
    closed_rms_y: Signals
    """RMS of the residuals above over the newest samples, same units."""
    closed_rms_u: Signals
    driven_rms_y: Signals


class Mirror:
    """Runs two twins beside the plant: one gets the measured set-point, the other the measured input.

    New parameters take over without a jump: states that both structures have, and the controller's state, are
    kept. A state that only the new structure has is estimated by an observer with the new parameters from the
    newest samples: a heat sink may be far from its initial temperature. A gap in the settled samples restarts
    both twins from the measured output.
    """

    _closed: FloatArray
    _driven: FloatArray
    _pid: Controller | None

    def __init__(
        self,
        parameters: Parameters,
        law: LoopLaw = FROM_PLANT_FILE,
        recent: int = 60,
        period: float = 1.0,
        *,
        scale: float = 1.0,
    ) -> None:
        """Start with these parameters.

        Args:
            parameters: of both twins.
            law: that of the running controller, None if the loop is not known; default: the plant file's.
            recent: samples over which residuals are averaged.
            period: sample time, s; ignored with a controller, which has its own.
            scale: factor on the newest stretch over which the states of new parameters are estimated.
        """
        self._parameters = parameters
        self._law = law_for(parameters.model.plant, period, law)
        self._period = period if self._law is None else self._law.period
        self._recent: deque[list[float]] = deque(maxlen=recent)
        self._samples: deque[Sample] = deque(
            maxlen=max(round(_ESTIMATED_OVER * scale / self._period), 1)
        )
        self._previous: Sample | None = None
        self._samples_followed = 0

    @property
    def parameters(self) -> Parameters:
        """Parameters of both twins."""
        return self._parameters

    @parameters.setter
    def parameters(self, new: Parameters) -> None:
        if self._previous is not None and new.model is not self._parameters.model:
            estimated = self._estimate_states(new)
            self._driven = self._transfer_states(self._driven, new, estimated)
            absent = np.full(estimated.size, np.nan)
            self._closed = (
                absent
                if self._pid is None
                else self._transfer_states(self._closed, new, estimated)
            )
        self._parameters = new

    def push(self, sample: Sample) -> MirrorState:
        """Take one settled sample; return the state of the twins at its tick."""
        if self._previous is None or not sample.follows(self._previous):
            self._restart(sample)
        disturbances = _disturbances(sample)
        state = (
            self._drive_twin(sample, disturbances)
            if self._pid is None
            else self._advance_both(sample, self._pid, disturbances)
        )
        self._driven = advance(
            self._parameters, self._driven, sample.inputs, self._period, disturbances
        )
        self._previous = sample
        self._samples.append(sample)
        return state

    def _drive_twin(
        self, sample: Sample, disturbances: FloatArray | None
    ) -> MirrorState:
        """The state of the driven twin, without that of the other."""
        closed = np.full(len(sample.outputs), np.nan)
        commands = np.full(len(sample.inputs), np.nan)
        return self._observe(sample, closed, commands, disturbances)

    def _advance_both(
        self, sample: Sample, pid: Controller, disturbances: FloatArray | None
    ) -> MirrorState:
        """Both twins; advances the closed-loop one to the next tick."""
        closed = readings(self._parameters, self._closed, disturbances)
        if self._samples_followed < 2:
            # The controller's state follows from two recorded samples; until then it is the plant's.
            state = self._observe(sample, closed, np.array(sample.inputs), disturbances)
            pid.follow(sample.references, sample.outputs, sample.inputs)
            self._samples_followed += 1
        else:
            state = self._observe(
                sample, closed, pid.step(sample.references, closed), disturbances
            )
        self._closed = advance(
            self._parameters,
            self._closed,
            state.closed_input,
            self._period,
            disturbances,
        )
        return state

    def _restart(self, sample: Sample) -> None:
        disturbances = _disturbances(sample)
        start = begin(
            self._parameters,
            sample.outputs,
            input=sample.inputs,
            disturbances=disturbances,
        )
        self._closed = start if self._law is not None else np.full(start.size, np.nan)
        self._driven = start
        self._pid = None if self._law is None else Controller(self._law)
        self._recent.clear()
        self._samples.clear()
        self._samples_followed = 0

    def _transfer_states(
        self, states: FloatArray, new: Parameters, estimated: FloatArray
    ) -> FloatArray:
        """States of another structure: those of the present one where it has them, the rest as estimated."""
        present = dict(zip(self._parameters.model.states, states.tolist(), strict=True))
        estimates = zip(new.model.states, estimated.tolist(), strict=True)
        return np.array([present.get(name, value) for name, value in estimates])

    def _estimate_states(self, new: Parameters) -> FloatArray:
        """The states at the next tick, estimated from the newest samples."""
        state_filter = StateFilter(new, self._period)
        state_filter.follow(self._samples)
        newest = self._samples[-1]
        return advance(
            new, state_filter.states, newest.inputs, self._period, _disturbances(newest)
        )

    def _observe(
        self,
        sample: Sample,
        closed: FloatArray,
        commands: FloatArray,
        disturbances: FloatArray | None,
    ) -> MirrorState:
        driven = readings(self._parameters, self._driven, disturbances, sample.inputs)
        y = np.array(sample.outputs)
        u = np.array(sample.inputs)
        residual = [
            *(y - closed).tolist(),
            *(u - commands).tolist(),
            *(y - driven).tolist(),
        ]
        if sample.seen or not self._recent:
            self._recent.append(residual)
        sizes = rms(np.array(self._recent), axis=0).tolist()
        of_closed_y = slice(y.size)
        of_closed_u = slice(y.size, y.size + u.size)
        of_driven_y = slice(y.size + u.size, None)
        names = self._parameters.model.states
        return MirrorState(
            sample=sample,
            closed_output=tuple(closed.tolist()),
            closed_input=tuple(commands.tolist()),
            closed_states=dict(zip(names, self._closed.tolist(), strict=True)),
            driven_output=tuple(driven.tolist()),
            driven_states=dict(zip(names, self._driven.tolist(), strict=True)),
            closed_residual_y=tuple(residual[of_closed_y]),
            closed_residual_u=tuple(residual[of_closed_u]),
            driven_residual_y=tuple(residual[of_driven_y]),
            closed_rms_y=tuple(sizes[of_closed_y]),
            closed_rms_u=tuple(sizes[of_closed_u]),
            driven_rms_y=tuple(sizes[of_driven_y]),
        )


def _disturbances(sample: Sample) -> FloatArray | None:
    return np.array(sample.disturbances) if sample.disturbances else None


_EVALUATIONS: Final = 100
"""Limit on the runs with which initial states are estimated; a handful is usual."""


class Residuals(NamedTuple):
    """RMS of measured minus twin over a window."""

    y: float
    """Output residual of the driven twin, which gets the measured input; of several the worst, likewise."""
    u: float
    """Input residual of the closed-loop twin, which gets the set-point; NaN if the loop is not known."""


def residuals(parameters: Parameters, window: Window, law: Law | None) -> Residuals:
    """Run both twins over a window from its measured start (NaN if it has fewer than four samples)."""
    if len(window) < 4:
        return Residuals(float("nan"), float("nan"))
    plant = parameters.model.plant
    inputs = window.inputs[SKIPPED:]
    driven = simulate_driven(
        parameters,
        inputs,
        states=begin_window(parameters, window),
        period=window.period,
        disturbances=window.disturbances[SKIPPED:],
    )
    of_outputs = _worst(
        window.received(window.outputs[SKIPPED:] - driven.outputs), plant.outputs
    )
    if law is None:
        return Residuals(of_outputs, float("nan"))
    closed = simulate_window(parameters, window, law=law)
    of_inputs = _worst(window.received(inputs - closed.inputs), plant.drives)
    return Residuals(of_outputs, of_inputs)


def _worst(left: FloatArray, signals: Mapping[str, Output | Drive]) -> float:
    """RMS of what is left of the signals, shape (N, signals); of several, of the worst in its noise."""
    sizes = rms(left.T)
    return float(
        sizes[np.argmax(sizes / [signal.noise for signal in signals.values()])]
    )


class Fits(NamedTuple):
    """NRMSE fits of a twin over a window; 1 is perfect."""

    outputs: Signals
    inputs: Signals
    """NaN where the twin was driven by them."""

    @property
    def worst(self) -> tuple[float, float]:
        """The least fit of an output, and of an input."""
        return min(self.outputs), min(self.inputs)

    @property
    def shown(self) -> dict[str, OperatingPoint]:
        """The fits by the letters of outputs and inputs; those of a single one as a number."""
        return {"y": point_of(self.outputs), "u": point_of(self.inputs)}


def window_fits(parameters: Parameters, window: Window, law: Law | None) -> Fits:
    """Fits of each output and input of the closed-loop twin over a window; without a law of the driven
    twin's outputs."""
    twin = response_on(parameters, window, law)
    outputs = _fits_of_each(window, window.outputs, twin.outputs)
    inputs = _fits_of_each(window, window.inputs, twin.inputs)
    return Fits(outputs, inputs if law else (float("nan"),) * len(inputs))


def _fits_of_each(
    window: Window, measured: FloatArray, simulated: FloatArray
) -> Signals:
    """NRMSE of every signal over the samples of a window that were received."""
    fits = []
    for y, y_of_twin in zip(measured[SKIPPED:].T, simulated.T, strict=True):
        fits.append(nrmse(window.received(y), window.received(y_of_twin)))
    return tuple(fits)


def window_fit(
    parameters: Parameters, window: Window, law: Law | None
) -> tuple[float, float]:
    """Fit of output and input, of several the worst."""
    return window_fits(parameters, window, law).worst


def response_on(parameters: Parameters, window: Window, law: Law | None) -> Response:
    """The twin over a whole window, from its third sample on, as it is shown beside the measurements.

    A driven twin has no controller that brings it back to the measurements, so initial states that no sensor
    shows would be off for as long as the plant remembers: those that matches estimate are estimated from the
    window, with these parameters.

    Raises:
        PlantError: as `simulate_window`.
    """
    starts = hidden_starts(parameters, window) if law is None else None
    return simulate_window(parameters, window, law=law, starts=starts)


def hidden_starts(parameters: Parameters, window: Window) -> dict[str, float]:
    """Initial values of the hidden states with which a driven twin is nearest to a window's output.

    Empty, so that the plant file's apply, without such states, if the search does not converge, or if the
    equations run elsewhere.
    """
    model = parameters.model
    unknowns = unknown_starts(model)
    if not unknowns or model.is_external or len(window) <= SKIPPED + len(unknowns):
        return {}
    names = [unknown.name for unknown in unknowns]
    experiment = Experiment(parameters, (), window, free_starts=names, law=None)
    low, high = np.array([unknown.bounds for unknown in unknowns]).T
    scales = np.array([unknown.scale for unknown in unknowns])
    start = np.clip(experiment.values_of(parameters), low, high)
    fit = experiment.descend(start, low, high, scales, _EVALUATIONS)
    return experiment.starts_at(fit.values) if fit.converged else {}


def nrmse(measured: FloatArray, simulated: FloatArray) -> float:
    """1 − ‖measured − simulated‖ / ‖measured − mean‖; NaN for a measured signal that is constant."""
    spread = float(np.linalg.norm(measured - np.mean(measured)))
    return (
        1.0 - float(np.linalg.norm(measured - simulated)) / spread
        if spread > 0
        else float("nan")
    )
