"""A drive behind a heater and a lag, seen in coarse steps: the kit that the package `tclab` simulates."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.support.faulty_kit import (
    HEALTHY,
    Broken,
    Published,
    Simulated,
    hold,
    levels,
    run,
    some_levels,
    watch,
)
from tests.support.plants import Lag, Motor
from tests.support.recorded_kits import kit_rows
from twinmatch.health import Alarm, Fault, HealthSettings, Monitor
from twinmatch.health.lagged_effect import is_lagged
from twinmatch.plants import Peltier, TCLab
from twinmatch.signals import Sample

pytest.importorskip(
    "tclab", reason="no kit to simulate; pip install 'twinmatch[tclab]'"
)


def alarms(samples: int, broken: Broken = HEALTHY, seed: int = 0) -> tuple[Alarm, ...]:
    """Of a kit held at four levels in turn."""
    return watch(run(Simulated(seed), levels(samples), broken))


@pytest.mark.parametrize("gain", [0.7, 1.4])
def test_a_healthy_kit_is_left_alone(gain: float) -> None:
    """Though readings repeat themselves for a minute, and the monitor knows no more than typical values.

    Those of the usual gain are the beginnings of the runs below, in which nothing is reported either.
    """
    assert alarms(900, Broken(gain=gain), seed=1) == ()


@pytest.mark.parametrize(
    ("seed", "lost"), [*((1, lost) for lost in (430, 700, 1000, 1500)), (2, 700)]
)
def test_a_lost_heater_is_reported_in_half_a_minute_and_named_a_minute_later(
    seed: int, lost: int
) -> None:
    """At each level, on the way up and after a rest: what it does shows only after its lags, and larger
    losses look the same until then."""
    both, named = alarms(lost + 100, Broken(lost=lost), seed)
    assert both.fault is Fault.DRIFT
    assert 0 < both.flagged - lost <= 30
    assert "the drive should have moved the temperature T1 by" in both.reason
    assert "or the plant loses far more than before" in both.reason
    assert named.fault is Fault.DRIVE_LOST
    assert 0 < named.flagged - both.flagged <= 75
    assert named.first <= both.first  # what was matched meanwhile is not kept
    assert "or the plant loses" not in named.reason


@pytest.mark.parametrize(("lost", "losses"), [(1000, 4.0), (1500, 2.5)])
def test_a_draught_is_not_called_a_lost_heater(lost: int, losses: float) -> None:
    """The first alarm names both; once the heater has shown that it works, the losses may be named."""
    kit_alarms = alarms(lost + 300, Broken(draught=lost, losses=losses), 1)
    assert kit_alarms[0].fault is Fault.DRIFT
    assert {a.fault for a in kit_alarms} <= {Fault.DRIFT, Fault.LOSSES_CHANGED}


@pytest.mark.parametrize(
    ("power", "soonest", "latest", "seed"),
    [(5, 31, 120, 3), (10, 16, 30, 4)],
)
def test_a_heater_lost_at_rest_is_reported_as_soon_as_its_power_shows(
    power: float, soonest: int, latest: int, seed: int
) -> None:
    """In 30 s a heater lost at 10 % takes 0.6 °C from the reading, two of its steps. At 5 % a room that
    becomes 3 °C colder does the same, until the controller has raised the power."""
    lost = 700 + 50 * seed
    both, named = watch(
        run(Simulated(seed), hold(power, lost + latest + 76), Broken(lost=lost))
    )
    assert both.fault is Fault.DRIFT
    assert soonest <= both.flagged - lost <= latest
    assert named.fault is Fault.DRIVE_LOST


def test_samples_without_disturbances_have_the_usual_ones() -> None:
    samples = run(Simulated(1), levels(470), Broken(lost=430))
    without = [replace(sample, disturbances=()) for sample in samples]
    assert watch(without) == watch(samples) != ()


@pytest.mark.parametrize(
    "seed",
    [1, 13],
)
def test_a_kit_that_answers_sooner_and_more_than_expected_has_its_heater(
    seed: int,
) -> None:
    """Once its set-point falls, or the controller brakes, it does what a dead heater would do."""
    samples = run(
        Published(seed), some_levels(seed, 1200 if seed == 1 else 2700, 26.0, 65.0, 700)
    )
    assert watch(samples) == ()


def test_a_controller_that_brakes_does_not_make_a_strong_kit_look_dead() -> None:
    """1.5 times the typical power: the room was taken to be warmer than it is, and is so as power falls."""
    assert watch(run(Published(2), levels(1100))) == ()


def test_a_gap_while_the_kit_cools_does_not_look_like_a_lost_heater() -> None:
    """How warm the heater is, is not known behind its lag, until the readings after the gap have shown it."""
    samples = run(Simulated(1), levels(1060))
    assert watch([s for s in samples if s.index != 939]) == ()


@pytest.mark.parametrize("name", ["mpc_1", "mpc_44", "mpc_45", "mpc_54"])
def test_a_kit_under_another_law_is_left_alone(name: str) -> None:
    """Twenty minutes with a sample in five seconds: a heater full on and off in turn, and one more that acts.
    In the first minutes what looks missing is how late this kit follows."""
    monitor = Monitor(HealthSettings.of(TCLab, 5.0))
    for k, row in enumerate(kit_rows("tclab_other", name)):
        monitor.push(
            Sample(k, 5_000_000_000 * k, row["T1"], row["T1"], row["Q1"], (row["Q2"],))
        )
    assert monitor.alarms == ()


def test_it_stays_lost_until_it_is_back() -> None:
    """For six minutes the kit cools down to the room; then the wire is repaired, and the drive proves it."""
    kit_alarms = alarms(1560, Broken(lost=1000, back=1360), seed=1)
    assert [alarm.fault for alarm in kit_alarms] == [Fault.DRIFT, Fault.DRIVE_LOST]
    assert kit_alarms[1].last is not None
    assert 1360 <= kit_alarms[1].last <= 1500


def test_a_frozen_sensor_is_reported_once_the_plant_should_have_moved() -> None:
    """Ten seconds after a step it is asked for 20 °C more."""
    alarm = watch(run(Simulated(1), levels(1460), Broken(frozen=1360)))[0]
    assert alarm.fault is Fault.SENSOR_FROZEN
    assert alarm.flagged - 1360 <= 40


def test_only_a_drive_behind_something_is_watched_so() -> None:
    assert is_lagged(TCLab.model().parameters(), 1.0)
    assert not is_lagged(Lag.model().parameters(), 1.0)
    assert not is_lagged(Motor.model().parameters(), 0.05)
    assert not is_lagged(Peltier.model().parameters(**Peltier.typical), 1.0)
