"""Whether the controller that a plant file declares is the one that ran the plant in a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from twinmatch.adding.findings import Finding
from twinmatch.dynamics import Pid, PidGains, Plant, controller_state
from twinmatch.sessions import Session
from twinmatch.signals import FloatArray, Sample, Window, unbroken

__all__ = ["loop_findings"]

_STRETCH: Final = 200
"""Samples over which the controller runs on its own: its integral shows wrong gains and wrong windup."""
_LEAST: Final = 20
"""Shorter stretches are left out."""
_SHARE: Final = 0.1
"""RMS error of the input, in standard deviations of the input, from which the loop is another one."""


def loop_findings(session: Session, plant: type[Plant], gains: PidGains | None) -> list[Finding]:
    """A finding if the declared controller does not give the recorded input from set-points and outputs."""
    if gains is None or not session.has_reference:
        return []
    errors = [error for run in _runs(session.samples, gains.period) for error in _errors(run, gains)]
    if not errors:
        return []
    found = np.concatenate(errors)
    rms = float(np.sqrt(np.mean(np.square(found))))
    usual = float(np.std([sample.input for sample in session.samples]))
    if rms <= max(_SHARE * usual, plant.drive.noise):
        return []
    unit = plant.drive.unit
    what = (
        f"the loop in the file does not give the recorded input: run on the recorded set-points and outputs, "
        f"it is {rms:.2g} {unit} off (RMS; the input's own standard deviation is {usual:.2g} {unit})"
    )
    todo = (
        "correct gains, limits, anti-windup (`back_calculation`) or derivative of `loop`; if the controller "
        "is of another form, remove `loop`: the recorded input then drives the twin"
    )
    return [Finding(what, todo)]


def _runs(samples: Sequence[Sample], period: float) -> Iterator[Window]:
    """Stretches of consecutive samples."""
    for run in unbroken(samples):
        for first in range(0, len(run), _STRETCH):
            part = run[first : first + _STRETCH]
            if len(part) >= _LEAST:
                yield Window.from_samples(part, period)


def _errors(run: Window, gains: PidGains) -> Iterator[FloatArray]:
    """Input of the declared controller minus the recorded one, from its first two samples within limits on:
    the controller's state follows from those."""
    within = [not gains.saturates(float(u)) for u in run.input]
    begin = next((k for k in range(len(run) - _LEAST) if within[k] and within[k + 1]), None)
    if begin is None:
        return
    part = run.part(run.first + begin, run.last)
    pid = Pid(gains, controller_state(part, gains))
    pairs = zip(part.reference[2:], part.output[2:], strict=True)
    yield np.array([pid.step(float(r), float(y)) for r, y in pairs]) - part.input[2:]
