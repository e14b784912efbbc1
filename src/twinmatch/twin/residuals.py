"""Residuals of a twin on a window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinmatch.dynamics import SKIPPED, Parameters, PidGains, begin, simulate_driven, simulate_window
from twinmatch.signals import FloatArray, Window

__all__ = ["Residuals", "nrmse", "residuals", "window_fit"]


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
    states = begin(parameters, float(window.output[SKIPPED]), disturbances=disturbances[0])
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
    twin = simulate_window(parameters, window, gains=gains)
    of_output = nrmse(window.output[SKIPPED:], twin.output)
    return of_output, float("nan") if gains is None else nrmse(window.input[SKIPPED:], twin.input)


def nrmse(measured: FloatArray, simulated: FloatArray) -> float:
    """1 − ‖measured − simulated‖ / ‖measured − mean‖; NaN for a measured signal that is constant."""
    spread = float(np.linalg.norm(measured - np.mean(measured)))
    return 1.0 - float(np.linalg.norm(measured - simulated)) / spread if spread > 0 else float("nan")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
