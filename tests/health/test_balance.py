"""The balance: exact for its own twin, and it finds out what another twin gets wrong."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.support import faulty_rig as rig
from tests.support.plants import Motor
from tests.support.servo import PERIOD, Servo, turns
from twinmatch.dynamics import (
    Controller,
    advance,
    begin,
    read,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.health import (
    Alarm,
    Balance,
    Fault,
    HealthError,
    HealthSettings,
    Monitor,
    Refusals,
)
from twinmatch.plants import Peltier
from twinmatch.signals import Sample

RIG = Peltier.model().parameters(**Peltier.typical)


def tick(y: float, u: float) -> Sample:
    return Sample(0, 0, 0.0, float(y), float(u))


def test_nothing_is_left_of_the_twin_itself() -> None:
    pwm = np.random.default_rng(1).uniform(-255, 255, 200)
    run = simulate_driven(RIG, pwm, states=begin(RIG, 37.0))
    balance = Balance(RIG, 1.0)
    for u, (y, after) in zip(pwm, itertools.pairwise(run.output), strict=False):
        movement = balance.step(tick(y, u), float(after))
        assert abs(movement.unexplained) < 1e-9
        assert movement.drive * u >= 0
        assert movement.drive + movement.passive == pytest.approx(after - y, abs=1e-9)


def test_an_error_of_drive_and_losses_is_learned() -> None:
    # A quarter more heat capacity slows everything by the same share: both corrections are 1/1.25 − 1.
    slow = RIG.replace(heat_capacity=1.25 * RIG["heat_capacity"])
    reference = rig.profile(5, 3000)
    run = simulate_closed_loop(slow, reference, states=begin(slow, 23.0))
    balance = Balance(RIG, 1.0)
    early = []
    late = []
    for k in range(len(reference) - 1):
        movement = balance.step(
            tick(run.output[k], run.input[k]), float(run.output[k + 1])
        )
        full = balance.block()
        if full is not None:
            balance.learn(*full, healthy=True)
        if k < 300:
            early.append(abs(movement.unexplained))
        elif k > 2000:
            late.append(abs(movement.unexplained))
    values, _ = balance.knowledge
    assert values[0] == pytest.approx(-0.2, abs=0.06)
    assert values[1] == pytest.approx(-0.2, abs=0.06)
    assert np.mean(late) < 0.3 * np.mean(early)


def test_what_was_unhealthy_is_not_learned() -> None:
    balance = Balance(RIG, 1.0)
    for _ in range(40):
        balance.learn(np.array([2.0, -1.0, 1.0, 0.5]), -1.0, healthy=False)
    assert not balance.knowledge[0].any()
    assert balance.roughness == 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"jump": 0.0}, "jump is 0.0; it must be positive"),
        ({"period": float("nan")}, "period is nan; it must be positive"),
        ({"lost": 1.0}, "lost is 1.0 and weak is 0.6; give shares"),
    ],
)
def test_settings_that_tell_nothing_are_refused(
    settings: dict[str, float], message: str
) -> None:
    with pytest.raises(HealthError, match=message):
        HealthSettings(**settings)


# An integrating plant sampled fast: what the drive does within a sample is a small part of its effect.


@pytest.mark.parametrize("error", [1.0, 1.1])
def test_a_healthy_servo_raises_no_alarm(error: float) -> None:
    """Nor does one whose twin has its friction ten per cent wrong."""
    truth = Servo.model().parameters(k=51.6, t=0.12, dry=1430.0, soft=1.0)
    twin = truth.replace(dry=error * 1430.0, soft=10.0)
    run = turns(truth, 3000)
    monitor = Monitor(HealthSettings.of(Servo, PERIOD))
    for k, (y, u) in enumerate(zip(run.output, run.input, strict=True)):
        stamp = round(k * PERIOD * 1e9)
        monitor.push(Sample(k, stamp, 0.0, float(y), float(u)), twin)
    assert monitor.alarms == ()


# The health of a plant that is not thermal and a hundred times as fast, in its own names and units.


BROKEN = 1200
PERIOD_OTHER_PLANT = Motor.loop.period


def alarms(kind: str = "", matched: int = 400, **values: float) -> tuple[Alarm, ...]:
    """Of 80 s of a motor under a load that is measured, broken after 60 s.

    From sample `matched` on its parameters are known; its file calls none typical.
    """
    truth = Motor.model().parameters(**{"j": 4.4e-4, "b": 1.2e-4, **values})
    pid = Controller(Motor.loop)
    states = begin(truth, 0.0)
    random = np.random.default_rng(7)
    y = 0.0
    monitor = Monitor(HealthSettings.of(Motor, PERIOD_OTHER_PLANT))
    refusals = Refusals(monitor.settings, 5)
    for k, reference in enumerate(
        np.repeat([50.0, 120.0, 80.0, -150.0, 100.0, 130.0, 60.0, 110.0], 200)
    ):
        broken = kind if k >= BROKEN else ""
        if broken != "frozen":
            y = (
                700.0
                if broken == "off"
                else read(truth, states) + random.normal(0.0, 0.2)
            )
        u = pid.step(float(reference), y)[0]
        load = 0.02 * np.sin(k / 200)
        nominal = truth if k >= matched else None
        sample = Sample(
            k, round(k * PERIOD_OTHER_PLANT * 1e9), float(reference), y, u, (load,)
        )
        if nominal is not None:
            refusals.know(nominal)
        monitor.push(refusals.settle(sample), nominal)
        driven = 0.0 if broken == "lost" else u
        states = advance(truth, states, driven, PERIOD_OTHER_PLANT, np.array([load]))
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
            "V, which is impossible: look at the sensor",
        ),
    ],
)
def test_what_breaks_is_reported(
    kind: str, fault: Fault, within: float, words: str
) -> None:
    alarm = alarms(kind)[0]
    assert alarm.fault is fault
    assert 0 <= (alarm.flagged - BROKEN) * PERIOD_OTHER_PLANT <= within
    assert words in alarm.reason
    assert "rad/s" in alarm.reason
