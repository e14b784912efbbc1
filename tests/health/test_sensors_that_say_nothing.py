"""Sensors that slip off, run away or freeze, on the public package's kit: their readings teach the twin nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from tests.support.public_kit import Pair, held, kit_under_its_loop
from twinmatch.emulation.faults import FaultSchedule, parse_faults
from twinmatch.health.channel_alarms import ChannelAlarm
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.faults import Fault
from twinmatch.health.runaway import (
    RUNNING,
    NewestMovement,
    Runaways,
    WayBack,
    runs_away,
)
from twinmatch.plants import TCLabBoth

LEVELS = ((35.0, 35.0), (50.0, 35.0), (50.0, 45.0), (40.0, 45.0), (50.0, 40.0))
"""Set-points of both heaters, °C, each held for `HOLD`."""
HOLD = 450
"""Seconds."""
SOON = 15
"""Seconds within which a reading that runs away is named; it has to move for ten."""

RUNNING_FOR = 15
"""Samples of a reading that runs away."""


class Watched(NamedTuple):
    """What was said of a kit."""

    alarms: tuple[ChannelAlarm, ...]
    farthest_estimate: float
    """By how much the newest estimate of a sensor was off at most, °C, from the twentieth second of a lie on."""


def watched(seed: int, faults: str, size: int) -> Watched:
    """A kit of the package's model under its usual loop, of `size` seconds."""
    monitor = ChannelMonitor(TCLabBoth.model(TCLabBoth.followed).typical(), 1.0)
    schedule = FaultSchedule(parse_faults(faults))
    read = [0.0, 0.0]

    def readings(second: int, temperatures: Pair, room: float) -> Pair:
        schedule.due(second)
        for place in range(2):
            if not schedule.acts("sensor-frozen", place + 1):
                told = schedule.told(temperatures[place], room, second, place + 1)
                read[place] = told
        return read[0], read[1]

    farthest = 0.0
    references = held(LEVELS, HOLD, size)
    for sample, temperatures in kit_under_its_loop(seed, references, readings=readings):
        monitor.push(sample)
        for estimate in monitor.estimates:
            off = abs(estimate.value - temperatures[place_of(estimate.signal)])
            farthest = max(farthest, off)
    return Watched(monitor.alarms, farthest)


def place_of(name: str) -> int:
    """Which sensor of the kit has a name."""
    return list(TCLabBoth.outputs).index(name)


@pytest.mark.parametrize(
    ("kind", "signal"),
    [
        ("sensor-slips.1", "temperature"),
        ("sensor-slips.2", "second_temperature"),
        ("sensor-drifts.1", "temperature"),
        ("sensor-drifts.2", "second_temperature"),
    ],
)
def test_a_sensor_whose_reading_runs_away_is_named_at_once_and_alone(
    kind: str, signal: str
) -> None:
    """Its loop drives its heater to 100 % meanwhile; no other name is given, and it is over soon after it is back."""
    begins = 1400
    ends = 1600
    alarms, farthest_estimate = watched(500, f"{kind}@{begins}+{ends - begins}", 1750)
    (alarm,) = alarms
    assert (alarm.fault, alarm.signal) == (Fault.SENSOR_DRIFT, signal)
    assert begins < alarm.flagged <= begins + SOON
    assert "farther than the plant can" in alarm.reason
    assert alarm.size < -RUNNING.noises * 0.1
    assert alarm.last is not None
    assert ends <= alarm.last <= ends + SOON
    # The package's equations are not ours; the sensor itself is off by 20 °C and more.
    assert farthest_estimate < 12.0


def test_a_sensor_that_stays_off_stays_named() -> None:
    """It reads the room from then on, and its filters take none of it."""
    (alarm,) = watched(501, "sensor-slips.2@1500", 2000).alarms
    assert (alarm.fault, alarm.signal) == (Fault.SENSOR_DRIFT, "second_temperature")
    assert alarm.last is None


@pytest.mark.parametrize("seed", [500, 502, 505])
def test_a_named_frozen_sensor_that_moves_again_has_not_drifted(seed: int) -> None:
    """What it showed for five minutes had been learned; then its readings seemed to be off by 8 °C, for good."""
    (alarm,) = watched(seed, "sensor-frozen.2@1700+300", 2240).alarms
    assert (alarm.fault, alarm.signal) == (Fault.SENSOR_FROZEN, "second_temperature")
    assert alarm.last == 2000


@pytest.mark.parametrize("seed", [500, 501])
def test_a_sensor_is_back_however_badly_its_loop_was_known_without_it(
    seed: int,
) -> None:
    """For five minutes its loop drives its heater to 100 %, and the estimate errs by more than its band; the reading
    moves by 30 °C to near there when the sensor is right again."""
    (alarm,) = watched(seed, "sensor-slips.2@1550+300", 1900).alarms
    assert alarm.fault is Fault.SENSOR_DRIFT
    assert alarm.last is not None
    assert 1850 <= alarm.last <= 1850 + SOON


@pytest.mark.parametrize("kind", ["sensor-slips", "sensor-drifts"])
def test_of_both_sensors_that_run_away_none_is_named_or_read_through(kind: str) -> None:
    alarms, farthest_estimate = watched(502, f"{kind}@1500+100", 1750)
    (alarm,) = alarms
    assert alarm.fault is Fault.DRIFT
    assert 1500 < alarm.flagged <= 1500 + SOON
    assert "temperature T1 and temperature T2 have moved at once" in alarm.reason
    assert "none is read through" in alarm.reason
    assert farthest_estimate == 0.0
    assert alarm.last is not None
    assert 1600 <= alarm.last <= 1600 + SOON


@pytest.mark.parametrize("seed", [501, 503, 504])
def test_a_frozen_sensor_is_named_when_it_moves_again_at_the_latest(seed: int) -> None:
    """Its loop rested, so that nothing showed for five minutes; then its reading seemed to be off, for good."""
    (alarm,) = watched(seed, "sensor-frozen.2@1300+300", 1800).alarms
    assert (alarm.fault, alarm.signal) == (Fault.SENSOR_FROZEN, "second_temperature")
    assert alarm.last == alarm.flagged == 1600
    assert "moved then to where the twin expected it" in alarm.reason


def test_what_nobody_saw_while_a_sensor_lied_accuses_no_heater() -> None:
    """Heater 1 gets 100 % for five minutes, as its sensor reads far too little, and cools down beside heater 2: this
    was said to have half of its effect."""
    (alarm,) = watched(5, "sensor-drifts.1@1500+300", 1950).alarms
    assert alarm.fault is Fault.SENSOR_DRIFT
    assert alarm.last is not None
    assert 1800 <= alarm.last <= 1800 + SOON


def test_a_sensor_that_is_off_after_it_has_stood_for_long_was_not_frozen() -> None:
    """Its loop rests, and its display stands; then its reading moves away from where it is expected."""
    (alarm,) = watched(501, "sensor-offset.2@1345", 1365).alarms
    assert (alarm.fault, alarm.signal) == (Fault.SENSOR_DRIFT, "second_temperature")


def test_a_frozen_sensor_is_named_whatever_began_while_it_stood() -> None:
    """The estimate that shows it began after the sensor had frozen, as something else was learned meanwhile."""
    alarms = watched(104, "sensor-frozen.2@1700", 2100).alarms
    assert [alarm.fault for alarm in alarms] == [Fault.SENSOR_FROZEN]


def test_steps_of_a_reading_are_jumps_and_do_not_run_away() -> None:
    movement = NewestMovement(second=1.0)
    values = [40.0] * 30 + [35.0] * 30
    assert not any(movement.take(v, 0.1, counts=True).is_beyond_known for v in values)


def test_a_reading_may_move_as_far_as_it_has_before() -> None:
    movement = NewestMovement(second=1.0)
    falls = list(np.arange(80.0, 40.0, -0.4))
    rests = [40.0] * 60
    before = [movement.take(v, 0.1, counts=True).is_beyond_known for v in falls + rests]
    again = [movement.take(v, 0.1, counts=True).is_beyond_known for v in falls]
    assert any(before)
    assert not any(again[20:])
    faster = list(np.arange(40.0, 0.0, -1.0))
    assert any(movement.take(v, 0.1, counts=True).is_beyond_known for v in faster)


def test_a_missing_reading_does_not_move() -> None:
    movement = NewestMovement(second=1.0)
    for _ in range(20):
        movement.take(40.0, 0.1, counts=True)
    assert movement.take(0.0, 0.1, counts=False).size == 0.0
    assert not movement.take(30.0, 0.1, counts=True).is_beyond_known


@pytest.mark.parametrize(("moved", "expected"), [(-4.0, False), (-6.5, True)])
def test_a_movement_is_compared_with_the_farthest_of_the_plant(
    moved: float, expected: bool
) -> None:
    """A fall of 2 °C at most, 2.5 times as far, and eight noises of 0.1 °C."""
    assert runs_away(moved, (-2.0, 9.0), 0.1) is expected


def test_a_reading_runs_away_while_it_moves_farther_than_its_plant_can() -> None:
    """In ten seconds the first reading rises by 5 °C, the second by half of that, and the plant by 1.5 °C at most."""
    farthest = (np.array([-1.0, -1.0]), np.array([1.5, 1.5]))
    runaways = Runaways(2, 1.0, lambda: farthest)
    noise = np.array([0.05, 0.05])
    counts = np.ones(2, dtype=bool)
    both = np.ones(2, dtype=bool)
    for k in range(RUNNING_FOR):
        runaways.take(np.array([20.0 + 0.5 * k, 20.0 + 0.25 * k]), counts, noise)
    assert runaways.moved.tolist() == [5.0, 2.5]
    assert runaways.lasting(1, both) == [0]
    assert runaways.lasting(RUNNING_FOR, both) == []
    assert runaways.lasting(1, np.array([False, True])) == []
    runaways.take(np.array([20.0, 20.0]), np.zeros(2, dtype=bool), noise)
    assert runaways.lasting(1, both) == []


def test_a_plant_that_cools_down_to_a_lying_sensor_does_not_bring_it_back() -> None:
    slow = WayBack(second=1.0)
    cools = 21.0 + 25.0 * np.exp(-np.arange(1500) / 180.0)
    assert not any(slow.take(21.0, expected, 1.0, 0.8) for expected in cools)
    quick = WayBack(second=1.0)
    away = [quick.take(21.0, 46.0, 1.0, 0.8) for _ in range(60)]
    back = [quick.take(45.5, 46.0, 1.0, 0.8) for _ in range(20)]
    assert not any(away)
    assert back.index(True) == 9


def test_a_reading_is_back_if_a_small_share_is_left_of_how_far_it_was_off() -> None:
    """Its estimate errs by more than its band, as the plant has gone where nobody saw it."""
    way_back = WayBack(second=1.0)
    away = [way_back.take(21.0, 75.0, 2.0, 0.8) for _ in range(60)]
    back = [way_back.take(79.0, 75.0, 2.0, 0.8) for _ in range(20)]
    assert not any(away)
    assert back.index(True) == 9


def test_a_reading_is_back_that_follows_its_plant_for_long() -> None:
    """The plant had cooled down to where the sensor lied; what tells is that both rise together."""
    way_back = WayBack(second=1.0)
    rests = [way_back.take(21.0, 21.5, 1.0, 0.8) for _ in range(600)]
    rises = 21.0 + 0.1 * np.arange(120)
    follows = [way_back.take(reading, reading + 0.5, 1.0, 0.8) for reading in rises]
    assert not any(rests)
    assert any(follows)
    assert rises[follows.index(True)] > 25.0
