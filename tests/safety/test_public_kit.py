"""The guards of a healthy kit: the public package's model, which has heater 2 at half the power of heater 1."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.liar import RunTime
from tests.support.public_kit import public_kit
from twinmatch.control import Controller
from twinmatch.dynamics import law_of
from twinmatch.nodes.gated import OutputGate
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.plants import TCLabBoth

LEVELS = [(35.0, 35.0), (50.0, 35.0), (50.0, 45.0)]
"""Set-points of both heaters, °C, each held for `HOLD`."""
HOLD = 450
"""Seconds."""


def test_heater_2_of_a_healthy_kit_reaches_its_set_point() -> None:
    """It was held 1 K below the last of them, as it was thought to heat by a fifth more."""
    kit = public_kit(1)
    clocks = RunTime()
    gate = OutputGate(clocks, TCLabBridge.guards_of_both(TCLabBridge.LIMITS))
    controller = Controller(law_of(TCLabBoth, 1.0))
    references = np.repeat(LEVELS, HOLD, axis=0)
    readings = []
    limited = 0
    for k, reference in enumerate(references):
        measured = np.array([kit.T1, kit.T2])
        readings.append(measured)
        command = controller.step(reference, measured)
        clocks.now = float(k)
        gate.command(command, k, clocks().stamps)
        gate.temperature(measured, clocks().stamps)
        applied = np.array(gate.decide().inputs)
        gate.sample(tuple(reference), tuple(measured), tuple(applied))
        limited += bool(applied[1] < command[1] - 1e-9)
        kit.Q1(applied[0])
        kit.Q2(applied[1])
        kit.update(float(k + 1))
    # A reading has steps of 0.3 K.
    assert np.mean(readings[-100:], axis=0)[1] == pytest.approx(LEVELS[-1][1], abs=0.3)
    assert limited <= 5
