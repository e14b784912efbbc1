"""Checks the columns of an imported recording and makes a window of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from twinmatch.plants import Peltier
from twinmatch.sessions.checks import rounded_period
from twinmatch.sessions.errors import RecordingError
from twinmatch.signals import KELVIN, FloatArray, Window

__all__ = ["Columns", "gather"]

JITTER = 0.1
"""Largest deviation of a time step from the usual step, as a share of it."""


class Columns(NamedTuple):
    """The four columns of a recording, each of shape (N,)."""

    time: FloatArray
    """Seconds, from any origin."""
    reference: FloatArray
    """Set-point, °C."""
    temperature: FloatArray
    """Measured temperature, °C."""
    pwm: FloatArray
    """Command, −255 to 255."""


def gather(columns: Columns, name: str, row: Callable[[int], str]) -> Window:
    """Make a window of the columns, after checking all values.

    Args:
        columns: equally long columns.
        name: the file's name, for messages.
        row: returns the place of the i-th value (from 0) in the file, such as `line 12`.

    Raises:
        RecordingError: fewer than two rows, values that are not finite, irregular or decreasing time, PWM
            beyond ±255, or temperatures below absolute zero.
    """
    if columns.time.size < 2:
        msg = f"recording {name}: has {columns.time.size} rows; at least two are needed"
        raise RecordingError(msg)
    for label, values in columns._asdict().items():
        _refuse(~np.isfinite(values), values, f"recording {name}: {label}", row, "is not a finite number")
    period = _period(columns.time, name, row)
    beyond = np.abs(columns.pwm) > Peltier.drive.limits[1]
    _refuse(beyond, columns.pwm, f"recording {name}: pwm", row, "is beyond ±255; is it in another unit?")
    for label in ("reference", "temperature"):
        values = getattr(columns, label)
        reason = "is below absolute zero; temperatures are in °C"
        _refuse(values < -KELVIN, values, f"recording {name}: {label}", row, reason)
    return Window(columns.reference, columns.temperature, columns.pwm, period=period)


def _period(time: FloatArray, name: str, row: Callable[[int], str]) -> float:
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if back.size:
        at = int(back[0])
        msg = (
            f"recording {name}: time does not advance from {time[at]:g} s in {row(at)} "
            f"to {time[at + 1]:g} s in {row(at + 1)}"
        )
        raise RecordingError(msg)
    # The median, because a single long gap would bias the mean; the lower median, because the shorter of two
    # different steps is the usual one.
    usual = float(np.quantile(steps, 0.5, method="lower"))
    odd = np.flatnonzero(np.abs(steps - usual) > JITTER * usual)
    if odd.size:
        at = int(odd[0])
        msg = (
            f"recording {name}: {steps[at]:g} s from {row(at)} to {row(at + 1)}, elsewhere {usual:g} s; "
            "split the recording there or resample it to one sampling period"
        )
        raise RecordingError(msg)
    return rounded_period(float(steps.mean()))


def _refuse(bad: np.ndarray, values: FloatArray, what: str, row: Callable[[int], str], reason: str) -> None:
    places = np.flatnonzero(bad)
    if places.size:
        first = int(places[0])
        others = f" (and in {places.size - 1} more)" if places.size > 1 else ""
        msg = f"{what} in {row(first)}{others} is {values[first]:g}, which {reason}"
        raise RecordingError(msg)
