"""A plant file without typical parameters: health follows the twin that has predicted it far better."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache

import numpy as np

from twinmatch.dynamics import (
    Disturbance,
    Drive,
    Equations,
    Output,
    Parameter,
    Parameters,
    Plant,
    State,
    Structure,
    advance,
)
from twinmatch.health import Fault, Health, HealthSettings, Monitor
from twinmatch.signals import Sample

PERIOD = 600.0
DAY = 144
"""Samples."""
OPEN = range(round(6.5 * DAY), round(6.8 * DAY))
"""While a window is open."""


def bounded(default: float, role: str = "") -> Parameter:
    return Parameter(
        default=default, bounds=(default / 50, default * 50), positive=True, role=role
    )


class RoomOnTrial(Plant, name="room_on_trial"):
    """Air that a radiator warms, and walls; the first structure leaves these out."""

    parts = ("walls",)
    time_constant = 10000.0
    inside = Output(unit="°C", noise=0.05, span=(-20.0, 70.0), set_points=(15.0, 24.0))
    radiator = Drive(unit="W", limits=(0.0, 1200.0), noise=10.0)
    outside = Disturbance(unit="°C", default=5.0)
    air = State(unit="°C", span=(-20.0, 120.0))
    wall = State(unit="°C", span=(-20.0, 120.0), start_bounds=(0.0, 40.0))
    capacity = bounded(1e6)
    mass = bounded(5e6)
    losses = bounded(20.0, "losses")
    surface = bounded(100.0)
    shell = bounded(20.0)
    structures = {  # noqa: RUF012
        "air": Structure(free=("capacity", "losses")),
        "air and walls": Structure(
            free=("capacity", "losses", "mass", "surface", "shell"),
            parts=frozenset({"walls"}),
        ),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        """Heat goes from the radiator to the air, from there to the walls, and outdoors."""
        to_walls = self.surface * (self.air - self.wall) if "walls" in parts else 0.0
        rates = {
            self.air: (
                self.radiator - self.losses * (self.air - self.outside) - to_walls
            )
            / self.capacity,
            self.wall: (to_walls - self.shell * (self.wall - self.outside)) / self.mass,
        }
        states = [self.air, self.wall] if "walls" in parts else [self.air]
        return Equations(
            rates={state: rates[state] for state in states},
            output=self.air,
            start=dict.fromkeys(states, self.inside),
        )


TRUTH = RoomOnTrial.model("air and walls").parameters(
    capacity=8e5, mass=6e6, losses=12.0, surface=150.0, shell=20.0
)
POOR = RoomOnTrial.model("air").parameters(capacity=1.5e6, losses=28.0)
"""About what a match of the first structure finds."""
GOOD = TRUTH.replace(capacity=8.3e5, losses=12.6, surface=145.0)
"""What one with walls finds."""


@cache
def week(*, opened: bool, stuck: range = range(0)) -> list[Sample]:
    """Under a thermostat; a sensor may be `stuck` for a while."""
    random = np.random.default_rng(3)
    states = np.array([19.0, 17.0])
    heats = False
    samples = list[Sample]()
    for k in range(7 * DAY):
        hour = k * 24 / DAY % 24
        outdoor = (
            5.0
            + 5.0 * math.sin(2 * math.pi * (hour - 9) / 24)
            + 3.0 * math.sin(2 * math.pi * k / 700)
        )
        reading = (
            samples[-1].output
            if k in stuck
            else round(states[0] + random.normal(0.0, 0.05), 2)
        )
        wanted = 21.0 if 6 <= hour < 22 else 17.0
        heats = reading < wanted + (0.3 if heats else -0.3)
        samples.append(
            Sample(
                k, round(k * PERIOD * 1e9), wanted, reading, 1200.0 * heats, (outdoor,)
            )
        )
        parameters = TRUTH.replace(losses=72.0) if opened and k in OPEN else TRUTH
        states = advance(
            parameters, states, samples[-1].input, PERIOD, np.array([outdoor])
        )
    return samples


def judged(
    samples: Iterable[Sample], *given: tuple[int, Parameters]
) -> tuple[Monitor, list[Health]]:
    """What a monitor says that is given twins, each from a sample on."""
    monitor = Monitor(HealthSettings.of(RoomOnTrial, PERIOD))
    twins = dict(given)
    twin = None
    healths = list[Health]()
    for sample in samples:
        twin = twins.get(sample.index, twin)
        healths.append(monitor.push(sample, twin))
    return monitor, healths


def test_a_window_is_named_once_a_later_match_has_proven_better() -> None:
    (alarm,) = judged(week(opened=True), (DAY, POOR), (2 * DAY, GOOD))[0].alarms
    assert alarm.fault is Fault.LOSSES_CHANGED
    assert OPEN.start - 3 <= alarm.first <= OPEN.start + 5
    assert alarm.flagged in OPEN


def test_a_poorer_twin_is_not_followed_and_changes_nothing_that_is_said() -> None:
    samples = week(opened=True)
    monitor, healths = judged(samples, (DAY, GOOD), (2 * DAY, POOR))
    assert [alarm.fault for alarm in monitor.alarms] == [Fault.LOSSES_CHANGED]
    assert healths == judged(samples, (DAY, GOOD))[1]


def test_what_a_fault_may_have_touched_is_not_followed() -> None:
    """A trial ends with an alarm; healthy days have none."""
    stuck = range(3 * DAY, 3 * DAY + 6)
    monitor, _ = judged(week(opened=True, stuck=stuck), (DAY, POOR), (2 * DAY, GOOD))
    assert [alarm.fault for alarm in monitor.alarms] == [Fault.SENSOR_FROZEN]
    assert not judged(week(opened=False), (DAY, POOR), (2 * DAY, GOOD))[0].alarms
