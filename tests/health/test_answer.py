"""A drive behind a heater and a lag, seen in coarse steps: the kit that the package `tclab` simulates."""

from __future__ import annotations

import random

import numpy as np
import pytest

from tests.support.plants import Lag, Motor
from twinmatch.control import Loop
from twinmatch.health import Alarm, Fault, HealthSettings, Monitor
from twinmatch.health.answer import answers_late
from twinmatch.plants import Peltier, TCLab

SECOND = 1_000_000_000


def alarms(
    samples: int,
    *,
    lost: float = np.inf,
    back: float = np.inf,
    frozen: float = np.inf,
    gain: float = 1.0,
    seed: int = 0,
) -> tuple[Alarm, ...]:
    """Of a kit held at four levels in turn; its heater does `gain` of what the model's does."""
    tclab = pytest.importorskip("tclab", reason="no kit to simulate; pip install 'twinmatch[tclab]'")
    random.seed(seed)
    kit, loop, monitor = tclab.TCLabModel(synced=False), Loop(TCLab), Monitor(HealthSettings.of(TCLab))
    kit.tlast, y = 0.0, 21.0
    for k in range(samples):
        kit.update(float(k))
        y = y if k >= frozen else kit.T1
        level = (35.0, 50.0, 40.0, 60.0)[k // 450 % 4]
        loop.measure(y, k * SECOND)
        sample = loop.tick(k * SECOND, lambda _, level=level: level)
        assert sample is not None
        kit.Q1(0.0 if lost <= k < back else gain * sample.input)
        monitor.push(sample)
    return monitor.alarms


@pytest.mark.parametrize("gain", [0.7, 1.0, 1.4])
def test_a_healthy_kit_is_left_alone(gain: float) -> None:
    """Though readings repeat themselves for a minute, and the monitor knows no more than typical values."""
    assert alarms(2700, gain=gain) == ()


@pytest.mark.parametrize("lost", [430, 700, 1000, 1500, 1750, 2230])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_lost_heater_is_reported_within_half_a_minute(lost: int, seed: int) -> None:
    """At each level, on the way up and after a long rest: what it does shows only after its lags."""
    alarm = alarms(lost + 40, lost=lost, seed=seed)[0]
    assert alarm.fault is Fault.DRIVE_LOST
    assert 0 < alarm.flagged - lost <= 30
    assert "the drive should have moved the temperature T1 by" in alarm.reason


def test_it_stays_lost_until_it_is_back() -> None:
    """For six minutes the kit cools down to the room; then the wire is repaired, and the drive proves it."""
    told = alarms(1560, lost=1000, back=1360)
    assert [alarm.fault for alarm in told] == [Fault.DRIVE_LOST]
    assert told[0].last is not None
    assert 1360 <= told[0].last <= 1500


def test_a_frozen_sensor_is_reported_once_the_plant_should_have_moved() -> None:
    """Ten seconds after a step it is asked for 20 °C more."""
    alarm = alarms(1460, frozen=1360)[0]
    assert alarm.fault is Fault.SENSOR_FROZEN
    assert alarm.flagged - 1360 <= 40


def test_only_a_drive_behind_something_is_watched_so() -> None:
    assert answers_late(TCLab.model().parameters(), 1.0)
    assert not answers_late(Lag.model().parameters(), 1.0)
    assert not answers_late(Motor.model().parameters(), 0.05)
    assert not answers_late(Peltier.model().parameters(**Peltier.typical), 1.0)
