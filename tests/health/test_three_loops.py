"""A plant with three drives: what they share, and something unknown that acts as one of them does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.support.watched import copied
from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
)
from twinmatch.health import Fault
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.faults import EVERY
from twinmatch.health.hypotheses import rows_of
from twinmatch.signals import Sample

LAG = 100.0
"""Time constant of each zone, s."""
KNOWN = 1500
"""Samples after which the plant is known."""


class Zones(Plant, name="three_zones"):
    """Three zones of a furnace, each with a heater, a sensor, and some heat of the heater before."""

    first = Output(unit="°C", noise=0.4, span=(0.0, 300.0), text="zone 1")
    second = Output(unit="°C", noise=0.4, span=(0.0, 300.0), text="zone 2")
    third = Output(unit="°C", noise=0.4, span=(0.0, 300.0), text="zone 3")
    one = Drive(unit="%", limits=(0.0, 100.0), noise=1.0, text="heater 1")
    two = Drive(unit="%", limits=(0.0, 100.0), noise=1.0, text="heater 2")
    three = Drive(unit="%", limits=(0.0, 100.0), noise=1.0, text="heater 3")
    x1 = State(unit="°C", span=(0.0, 300.0))
    x2 = State(unit="°C", span=(0.0, 300.0))
    x3 = State(unit="°C", span=(0.0, 300.0))
    gain = Parameter(unit="K/%", default=1.0, bounds=(0.1, 5.0), positive=True)
    lag = Parameter(unit="s", default=LAG, bounds=(10.0, 1000.0), positive=True)
    room = Parameter(
        unit="°C",
        default=20.0,
        bounds=(-20.0, 50.0),
        role="room",
        scale=5.0,
        text="the room",
    )
    structures = {"zones": Structure(free=("gain", "lag", "room"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Each zone follows its heater, and a quarter of the one before."""
        rates = {
            self.x1: (self.room + self.gain * self.one - self.x1) / self.lag,
            self.x2: (self.room + self.gain * (self.two + 0.25 * self.one) - self.x2)
            / self.lag,
            self.x3: (self.room + self.gain * (self.three + 0.25 * self.two) - self.x3)
            / self.lag,
        }
        start = {self.x1: self.first, self.x2: self.second, self.x3: self.third}
        outputs = {self.first: self.x1, self.second: self.x2, self.third: self.x3}
        return Equations(rates=rates, output=outputs, start=start)


def readings(size: int, *, arrives: float = 1.0, push: float = 0.0) -> Iterator[Sample]:
    """The zones under steps of all heaters; from `KNOWN` on the share `arrives` of their power does, or
    heater 2 is off, and something acts as it would with `push` %."""
    noise = np.random.default_rng(3)
    steps = np.random.default_rng(4).uniform(20.0, 70.0, (size // 150 + 1, 3))
    states = np.full(3, 20.0)
    for k in range(size):
        commands = steps[k // 150].copy()
        if push and k >= KNOWN:
            commands[1] = 0.0
        read = states + noise.normal(0.0, 0.4, 3)
        yield Sample(k, k * 10**9, tuple(read), tuple(read), tuple(commands))
        acting = commands.copy()
        if k >= KNOWN:
            acting = arrives * commands
            acting[1] += push
        warmed = acting + 0.25 * np.array([0.0, acting[0], acting[1]])
        states += (20.0 + warmed - states) * -np.expm1(-1.0 / LAG)


@pytest.fixture(scope="module")
def healthy() -> ChannelMonitor:
    monitor = ChannelMonitor(Zones.model().typical(), 1.0)
    for sample in readings(KNOWN):
        monitor.push(sample)
    assert monitor.alarms == ()
    return monitor


def test_a_supply_is_that_of_all_drives() -> None:
    shared = [row for row in rows_of(Zones.model()) if row.cause[1] == EVERY]
    assert shared
    assert {(row.number, *row.also) for row in shared} == {
        ("share 0", "share 1", "share 2")
    }


def test_a_supply_that_is_lost_is_named_with_all_that_hangs_on_it(
    healthy: ChannelMonitor,
) -> None:
    monitor = copied(healthy)
    for sample in readings(KNOWN + 60, arrives=0.0):
        if sample.index >= KNOWN:
            monitor.push(sample)
    (alarm,) = monitor.alarms
    assert alarm.fault is Fault.DRIVE_LOST
    assert alarm.reason == (
        "heater 1, heater 2 and heater 3 have no effect: look at what they share, such as their supply"
    )


def test_something_unknown_that_leads_alone_is_reported(
    healthy: ChannelMonitor,
) -> None:
    """Heat from elsewhere that begins at once in zone 2, and flows on to zone 3 as that of heater 2 does."""
    monitor = copied(healthy)
    for sample in readings(KNOWN + 400, push=20.0):
        if sample.index >= KNOWN:
            monitor.push(sample)
    (alarm,) = monitor.alarms
    assert alarm.fault is Fault.DRIFT
    assert alarm.reason.startswith(
        "the plant behaves as if something that acts as heater 2 does had begun"
    )


def test_zones_that_heat_up_within_samples_are_not_taken_for_sensors_that_jumped() -> (
    None
):
    """Of a recording with few samples in a time constant, with another gain than the file says."""
    monitor = ChannelMonitor(Zones.model().typical(), 10.0)
    noise = np.random.default_rng(3)
    states = np.full(3, 20.0)
    for k in range(120):
        commands = np.full(3, 10.0 if k % 40 < 20 else 90.0)
        read = states + noise.normal(0.0, 0.4, 3)
        monitor.push(
            Sample(k, k * 10**10, tuple(read), tuple(read), tuple(commands.tolist()))
        )
        warmed = 1.8 * (commands + 0.25 * np.array([0.0, commands[0], commands[1]]))
        states += (20.0 + warmed - states) * -np.expm1(-10.0 / LAG)
    assert monitor.alarms == ()
