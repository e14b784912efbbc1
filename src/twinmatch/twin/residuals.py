"""Residuals of a twin on a window."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import (
    SKIPPED,
    Experiment,
    Parameters,
    PidGains,
    Response,
    begin_window,
    simulate_driven,
    simulate_window,
)
from twinmatch.fitting.bounds import unknown_starts
from twinmatch.signals import FloatArray, Window

__all__ = ["Residuals", "nrmse", "residuals", "response_on", "window_fit"]

_EVALUATIONS: Final = 100
"""Limit on the runs with which initial states are estimated; a handful is usual."""


class Residuals(NamedTuple):
    """RMS of measured minus twin over a window."""

    y: float
    """Output residual of the driven twin, which gets the measured input."""
    u: float
    """Input residual of the closed-loop twin, which gets the set-point; NaN if the loop is not known."""


def residuals(parameters: Parameters, window: Window, gains: PidGains | None) -> Residuals:
    """Run both twins over a window from its measured start (NaN if it has fewer than four samples)."""
    if len(window) < 4:
        return Residuals(float("nan"), float("nan"))
    disturbances = window.disturbances[SKIPPED:]
    states = begin_window(parameters, window)
    driven = simulate_driven(
        parameters, window.input[SKIPPED:], states=states, period=window.period, disturbances=disturbances
    )
    off = _rms(window.output[SKIPPED:] - driven.output)
    if gains is None:
        return Residuals(off, float("nan"))
    closed = simulate_window(parameters, window, gains=gains)
    return Residuals(off, _rms(window.input[SKIPPED:] - closed.input))


def window_fit(parameters: Parameters, window: Window, gains: PidGains | None) -> tuple[float, float]:
    """NRMSE fit of output and input of the closed-loop twin over a window; 1 is perfect.

    Without gains: that of the driven twin's output, and NaN.
    """
    twin = response_on(parameters, window, gains)
    of_output = nrmse(window.output[SKIPPED:], twin.output)
    return of_output, float("nan") if gains is None else nrmse(window.input[SKIPPED:], twin.input)


def response_on(parameters: Parameters, window: Window, gains: PidGains | None) -> Response:
    """The twin over a whole window, from its third sample on, as it is shown beside the measurements.

    A driven twin has no controller that brings it back to the measurements, so initial states that no sensor
    shows would be off for as long as the plant remembers: those that matches estimate are estimated from the
    window, with these parameters.

    Raises:
        PlantError: as `simulate_window`.
    """
    starts = hidden_starts(parameters, window) if gains is None else None
    return simulate_window(parameters, window, gains=gains, starts=starts)


def hidden_starts(parameters: Parameters, window: Window) -> dict[str, float]:
    """Initial values of the hidden states with which a driven twin is nearest to a window's output.

    Empty, so that the plant file's apply, without such states, if the search does not converge, or if the
    equations run elsewhere.
    """
    model = parameters.model
    unknown = unknown_starts(model)
    if not unknown or model.is_elsewhere or len(window) <= SKIPPED + len(unknown):
        return {}
    runs = Experiment(parameters, (), window, free_starts=[u.name for u in unknown], gains=None)
    low, high = np.array([u.bounds for u in unknown]).T
    scales = np.array([u.scale for u in unknown])
    begun = np.clip(runs.values_of(parameters), low, high)
    found = runs.descend(begun, low, high, scales, _EVALUATIONS)
    return runs.starts_at(found.values) if found.converged else {}


def nrmse(measured: FloatArray, simulated: FloatArray) -> float:
    """1 − ‖measured − simulated‖ / ‖measured − mean‖; NaN for a measured signal that is constant."""
    spread = float(np.linalg.norm(measured - np.mean(measured)))
    return 1.0 - float(np.linalg.norm(measured - simulated)) / spread if spread > 0 else float("nan")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
