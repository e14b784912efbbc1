"""The health of an incubator: no loop, a measured room, sensors with a coarse last digit, and a lid."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.faulty_incubator import PERIOD, Lid, run, some_incubator, watch
from tests.support.incubator import FIRST, LID, LIDS, SECOND, read_events, read_run
from twinmatch.health import Fault, HealthSettings, HealthState, Monitor, Movement
from twinmatch.health.changes import ChangeDetector
from twinmatch.health.traces import Effect, Lag, Repeats
from twinmatch.plants import Incubator
from twinmatch.signals import Sample, Window


def samples_of(window: Window) -> list[Sample]:
    rows = zip(window.output, window.input, window.disturbances, strict=True)
    return [
        Sample(k, k, float(y), float(y), float(u), tuple(disturbances.tolist()))
        for k, (y, u, disturbances) in enumerate(rows)
    ]


@pytest.mark.parametrize("seed", range(2))
def test_an_open_lid_is_reported_as_other_losses_and_only_that(seed: int) -> None:
    lid = Lid(300 + 7 * seed, 320 + 7 * seed, 6.0)
    *unnamed, alarm = alarms = watch(run(some_incubator(seed), seed, 600, lid))
    assert alarm.fault is Fault.LOSSES_CHANGED
    assert {a.fault for a in unnamed} <= {Fault.DRIFT}, (
        "the drive is lost, or the losses are larger"
    )
    assert 0 < (alarms[0].flagged - lid.opened) * PERIOD <= 75
    assert alarm.last is not None
    assert 0 < (alarm.last - lid.closed) * PERIOD <= 120
    assert "look at lid, fan and room" in alarm.reason


@pytest.mark.parametrize("seed", range(20, 22))
def test_nothing_is_reported_for_one_that_is_left_alone(seed: int) -> None:
    assert watch(run(some_incubator(seed), seed, 800)) == ()


def test_a_room_that_is_measured_is_not_a_hypothesis() -> None:
    """What it does is in the equations: 8 °C within ten minutes are the room's and not the plant's."""
    asked = ChangeDetector(
        HealthSettings.of(Incubator, PERIOD).followed, PERIOD
    ).hypotheses
    assert {h.fault for h in asked} == {
        Fault.LOSSES_CHANGED,
        Fault.DRIVE_WEAK,  # behind a lag it may be lost, too
        Fault.SENSOR_DRIFT,
        Fault.DRIFT,
        Fault.DISTURBANCE,
    }
    assert watch(run(some_incubator(3), 3, 700, warming=(400, 600, 8.0))) == ()


def test_a_reading_whose_noise_is_lost_in_its_last_digit_may_stand_still() -> None:
    """At the top of every swing both sensors repeat themselves for half a minute."""
    faults = [
        a.fault
        for seed in (10, 18)
        for a in watch(run(some_incubator(seed), seed, 250))
    ]
    assert faults == []


def test_a_frozen_reading_is_reported_all_the_same_once_the_plant_should_have_moved() -> (
    None
):
    monitor = Monitor(HealthSettings.of(Incubator, PERIOD))
    samples = run(some_incubator(1), 1, 500)
    for k, sample in enumerate(samples):
        y = samples[400].output if k >= 400 else sample.output
        health = monitor.push(Sample(k, k, y, y, sample.input, sample.disturbances))
    assert health.state is HealthState.FAULT
    assert health.fault is Fault.SENSOR_FROZEN


# --- published runs ---


@pytest.mark.parametrize("name", [FIRST, SECOND])
def test_nothing_is_reported_in_a_published_run(
    incubator_folder: Path, name: str
) -> None:
    assert watch(samples_of(read_run(incubator_folder, name))) == ()


@pytest.mark.parametrize("name", [LID, LIDS])
def test_every_lid_is_reported_until_it_is_closed(
    incubator_folder: Path, name: str
) -> None:
    """Two, and four within two hours. The parameters of this hardware are others; the monitor learns them in
    the minutes before, and an open lid neither spoils them nor counts against them."""
    window = read_run(incubator_folder, name)
    events = read_events(incubator_folder, name)
    alarms = watch(samples_of(window))
    assert [a.fault for a in alarms] == [Fault.LOSSES_CHANGED] * (events.size // 2)
    for alarm, (opened, closed), later in zip(
        alarms, events.reshape(-1, 2), [*events[2::2], math.inf], strict=True
    ):
        assert opened < alarm.flagged * PERIOD <= opened + 75
        assert alarm.last is not None
        # after the second of March the box heats as never before
        assert closed < alarm.last * PERIOD < later


# The traces one by one.


NOISE = 0.1
"""Of a reading, °C."""
STILL = 0.0


def test_the_share_is_what_the_plate_shows_of_the_drive() -> None:
    effect = Effect(1.0, NOISE)
    for _ in range(20):
        # 0.3 of 2 °C are missing every second
        effect.push(Movement(2.0, -1.0, -0.3), 0.05, earned=True)
    assert effect.share == pytest.approx(0.85)
    assert effect.follows


@given(
    share=st.floats(-1.0, 2.0),
    drive=st.floats(1.0, 4.0),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_any_share_is_found_in_heating_and_in_cooling(
    share: float, drive: float, sign: float
) -> None:
    effect = Effect(1.0, NOISE)
    for k in range(24):
        # It comes on as a drive does that the controller turns up, so that no step looks like the camera's.
        part = sign * drive * min(1.0, k / 10)
        effect.push(Movement(part, 0.0, (share - 1.0) * part), 0.05, earned=True)
    assert effect.share == pytest.approx(share, abs=0.35)


def test_too_little_drive_is_not_judged() -> None:
    effect = Effect(1.0, NOISE)
    for _ in range(60):
        effect.push(Movement(0.4, -0.4, -0.4), 0.05, earned=True)
    assert np.isnan(effect.share)
    assert not effect.follows


def test_a_rough_balance_wants_more_drive() -> None:
    effect = Effect(1.0, NOISE)
    for _ in range(60):
        effect.push(Movement(1.0, -1.0, -0.4), 0.6, earned=True)
    assert np.isnan(effect.share)


def test_a_step_of_the_camera_is_not_taken_for_movement() -> None:
    effect = Effect(1.0, NOISE)
    for k in range(40):
        effect.push(Movement(1.0, -1.0, -5.0 if k == 30 else 0.0), 0.05, earned=True)
    assert effect.share == pytest.approx(1.0)


@pytest.mark.parametrize("inward", [-1.0, 1.0])
def test_a_reading_may_stay_at_an_end_of_the_span(inward: float) -> None:
    """A level sensor that ends at 10 V shows no noise there; but the level is known to fall at last."""
    repeats = Repeats(1.0, 10.0, NOISE)
    noisy(repeats, 200)
    for _ in range(40):
        repeats.push(0.0, -inward, inward)  # driven further out
    assert not repeats.stands
    for _ in range(80):
        repeats.push(0.0, inward, inward)
    assert repeats.stands


def noisy(repeats: Repeats, samples: int) -> None:
    for change in np.random.default_rng(8).normal(0.0, 0.1, samples):
        repeats.push(float(change), STILL)


def test_ten_equal_readings_of_a_noisy_camera_are_not_a_coincidence() -> None:
    repeats = Repeats(1.0, 10.0, NOISE)
    noisy(repeats, 100)
    for count in range(1, 12):
        repeats.push(0.0, STILL)
        assert repeats.count == count
        assert repeats.stands == (count >= 9)
    repeats.push(0.3, STILL)
    assert not repeats.stands


def test_a_coarse_camera_may_repeat_itself() -> None:
    random = np.random.default_rng(8)
    repeats = Repeats(1.0, 10.0, NOISE)
    # half a degree: nearly always the same
    readings = np.round(random.normal(40.0, 0.1, 3000) * 2) / 2
    longest = 0
    for change in np.diff(readings):
        repeats.push(float(change), STILL)
        longest = max(longest, repeats.count)
        assert not repeats.stands
    assert longest > 20


def test_a_sensor_without_noise_stands_still_only_if_the_plate_should_move() -> None:
    repeats = Repeats(1.0, 10.0, NOISE)
    for _ in range(60):
        repeats.push(0.0, STILL)
        assert not repeats.stands
    for _ in range(4):
        repeats.push(0.0, 1.0)
    assert repeats.stands


@given(lag=st.integers(2, 6), seed=st.integers(0, 1000))
def test_a_lag_is_found(lag: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    drive = np.convolve(random.normal(0.0, 2.0, 60), np.ones(4) / 2, "valid")
    trace = Lag(1.0)
    for k in range(lag, drive.size):
        response = drive[k - lag] + random.normal(0.0, 0.05)
        trace.push(Movement(float(drive[k]), 0.0, float(response - drive[k])))
    assert trace.seconds(20) == lag


@given(seed=st.integers(0, 1000))
def test_a_dead_drive_is_not_a_lag(seed: int) -> None:
    random = np.random.default_rng(seed)
    trace = Lag(1.0)
    for drive in np.convolve(random.normal(0.0, 2.0, 60), np.ones(4) / 2, "valid"):
        trace.push(Movement(float(drive), 0.0, float(random.normal(0.0, 0.05) - drive)))
    assert trace.seconds(20) is None
