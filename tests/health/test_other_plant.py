"""The health of a plant that is not thermal and a hundred times as fast, in its own names and units."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.plants import Motor
from twinmatch.dynamics import Pid, advance, begin, read
from twinmatch.health import Alarm, Fault, HealthSettings, Monitor
from twinmatch.signals import Sample

BROKEN = 1200
PERIOD = Motor.loop.period


def alarms(kind: str = "", matched: int = 400, **values: float) -> tuple[Alarm, ...]:
    """Of 80 s of a motor under a load that is measured, broken after 60 s.

    From sample `matched` on its parameters are known; its file calls none typical.
    """
    truth, pid = Motor.model().parameters(**{"j": 4.4e-4, "b": 1.2e-4, **values}), Pid(Motor.loop)
    states, random, y = begin(truth, 0.0), np.random.default_rng(7), 0.0
    monitor = Monitor(HealthSettings.of(Motor, PERIOD))
    for k, reference in enumerate(np.repeat([50.0, 120.0, 80.0, -150.0, 100.0, 130.0, 60.0, 110.0], 200)):
        broken = kind if k >= BROKEN else ""
        if broken != "frozen":
            y = 700.0 if broken == "off" else read(truth, states) + random.normal(0.0, 0.2)
        u, load = pid.step(float(reference), y), 0.02 * np.sin(k / 200)
        known = truth if k >= matched else None
        monitor.push(Sample(k, round(k * PERIOD * 1e9), float(reference), y, u, (load,)), known)
        driven = 0.0 if broken == "lost" else u
        states = advance(truth, states, driven, PERIOD, np.array([load]))
    return monitor.alarms


def test_a_healthy_one_is_left_alone() -> None:
    assert alarms() == ()


@pytest.mark.parametrize("matched", [400, 10_000])
def test_defaults_that_are_far_off_accuse_nobody(matched: int) -> None:
    """A file begins a search with its defaults. Until one has ended, they say nothing about the drive."""
    assert alarms(matched=matched, k=0.2, r=6.0, j=4e-3) == ()


def test_a_sensor_is_watched_before_anything_is_matched() -> None:
    assert alarms("frozen", matched=10_000)[0].fault is Fault.SENSOR_FROZEN
    assert alarms("off", matched=10_000)[0].fault is Fault.SENSOR_IMPLAUSIBLE


@pytest.mark.parametrize(
    ("kind", "fault", "within", "words"),
    [
        ("lost", Fault.DRIVE_LOST, 5.0, "should have moved the speed by"),
        ("frozen", Fault.SENSOR_FROZEN, 10.0, "the speed has been stuck at"),
        (
            "off",
            Fault.SENSOR_IMPLAUSIBLE,
            0.0,
            "V and set-point 60 rad/s, which is impossible: look at the sensor",
        ),
    ],
)
def test_what_breaks_is_reported(kind: str, fault: Fault, within: float, words: str) -> None:
    alarm = alarms(kind)[0]
    assert alarm.fault is fault
    assert 0 <= (alarm.flagged - BROKEN) * PERIOD <= within
    assert words in alarm.reason
    assert "rad/s" in alarm.reason
