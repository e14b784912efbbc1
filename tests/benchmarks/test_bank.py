"""A bank of hypotheses tells which channel of a plant with two loops has changed."""

from __future__ import annotations

from itertools import islice

from benchmarks.bank.kits import BEGINS, run, typical
from benchmarks.bank.monitor import BankMonitor
from twinmatch.health import Fault


def test_a_sensor_that_is_off_is_named_with_its_channel() -> None:
    """Twenty-five minutes of steps in both loops, and nothing is said; then T2 reads 5 °C too much, and the
    loop cools what it takes for too warm."""
    monitor = BankMonitor(typical(), 1.0)
    for sample in islice(run(21, "T2 +5 °C"), BEGINS + 30):
        monitor.push(sample)
    (alarm,) = monitor.alarms
    assert (alarm.fault, alarm.signal, alarm.last) == (Fault.SENSOR_DRIFT, 1, None)
    assert BEGINS < alarm.flagged <= BEGINS + 15
    assert alarm.first >= BEGINS - 2  # onsets are two seconds apart
    assert abs(alarm.found[0].shift - 5.0) < 1.0
