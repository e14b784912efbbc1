"""An integrating plant sampled fast: what the drive does within a sample is a small part of its effect."""

from __future__ import annotations

import pytest

from tests.support.servo import PERIOD, Servo, turns
from twinmatch.health import HealthSettings, Monitor
from twinmatch.signals import Sample


@pytest.mark.parametrize("error", [1.0, 1.1])
def test_a_healthy_servo_raises_no_alarm(error: float) -> None:
    """Nor does one whose twin has its friction ten per cent wrong."""
    truth = Servo.model().parameters(k=51.6, t=0.12, dry=1430.0, soft=1.0)
    twin = truth.replace(dry=error * 1430.0, soft=10.0)
    run = turns(truth, 6000)
    monitor = Monitor(HealthSettings.of(Servo, PERIOD))
    for k, (y, u) in enumerate(zip(run.output, run.input, strict=True)):
        stamp = round(k * PERIOD * 1e9)
        monitor.push(Sample(index=k, stamp=stamp, reference=0.0, output=float(y), input=float(u)), twin)
    assert monitor.alarms == ()
