"""The health of an incubator: no loop, a measured room, sensors with a coarse last digit, and a lid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.faulty_incubator import PERIOD, Lid, run, some_incubator, watch
from tests.support.incubator import FIRST, LID, SECOND, read_run
from twinmatch.health import Fault, HealthSettings, HealthState, Monitor
from twinmatch.health.changes import ChangeDetector, Kind
from twinmatch.plants import Incubator
from twinmatch.signals import Sample, Window


def samples_of(window: Window) -> list[Sample]:
    rows = zip(window.output, window.input, window.disturbances, strict=True)
    return [
        Sample(k, k, float(y), float(y), float(u), tuple(given.tolist()))
        for k, (y, u, given) in enumerate(rows)
    ]


@pytest.mark.parametrize("seed", range(4))
def test_an_open_lid_is_reported_as_other_losses_and_only_that(seed: int) -> None:
    lid = Lid(300 + 7 * seed, 320 + 7 * seed, 6.0)
    alarms = watch(run(some_incubator(seed), seed, 600, lid))
    assert [a.fault for a in alarms] == [Fault.LOSSES_CHANGED]
    assert 0 < (alarms[0].flagged - lid.opened) * PERIOD <= 75
    assert alarms[0].last is not None
    assert 0 < (alarms[0].last - lid.closed) * PERIOD <= 120
    assert "look at lid, fan and room" in alarms[0].reason


@pytest.mark.parametrize("seed", range(20, 24))
def test_nothing_is_reported_for_one_that_is_left_alone(seed: int) -> None:
    assert watch(run(some_incubator(seed), seed, 1200)) == ()


def test_a_room_that_is_measured_is_not_a_hypothesis() -> None:
    """What it does is in the equations: 8 °C within ten minutes are the room's and not the plant's."""
    asked = ChangeDetector(HealthSettings.of(Incubator, PERIOD).followed, PERIOD).hypotheses
    assert {h.kind for h in asked} == set(Kind) - {Kind.ROOM}
    assert watch(run(some_incubator(3), 3, 700, warming=(400, 600, 8.0))) == ()


def test_a_reading_whose_noise_is_lost_in_its_last_digit_may_stand_still() -> None:
    """At the top of every swing both sensors repeat themselves for half a minute."""
    told = [a.fault for seed in (10, 18) for a in watch(run(some_incubator(seed), seed, 250))]
    assert told == []


def test_a_frozen_reading_is_reported_all_the_same_once_the_plant_should_have_moved() -> None:
    monitor = Monitor(HealthSettings.of(Incubator, PERIOD))
    held = run(some_incubator(1), 1, 500)
    for k, sample in enumerate(held):
        y = held[400].output if k >= 400 else sample.output
        health = monitor.push(Sample(k, k, y, y, sample.input, sample.disturbances))
    assert health.state is HealthState.FAULT
    assert health.fault is Fault.SENSOR_FROZEN


# --- published runs ---


@pytest.mark.parametrize("name", [FIRST, SECOND])
def test_nothing_is_reported_in_a_published_run(incubator_folder: Path, name: str) -> None:
    assert watch(samples_of(read_run(incubator_folder, name))) == ()


def test_the_lid_that_was_opened_twice_is_reported_twice(incubator_folder: Path) -> None:
    """The parameters of this hardware are others; the monitor learns them in the minutes before."""
    table = np.genfromtxt(
        incubator_folder / f"{LID}.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    events = np.genfromtxt(incubator_folder / f"{LID}_events.csv", delimiter=",", skip_header=1, usecols=0)
    opened, closed, again, over = (events - table["time"][0]) * 1e-9
    alarms = watch(samples_of(read_run(incubator_folder, LID)))
    assert [a.fault for a in alarms] == [Fault.LOSSES_CHANGED] * 2
    for alarm, begun, ended in zip(alarms, (opened, again), (closed, over), strict=True):
        assert begun < alarm.flagged * PERIOD <= begun + 75
        assert alarm.last is not None
        assert ended < alarm.last * PERIOD <= ended + 75
