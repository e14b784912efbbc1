"""The runaway watch: silent over healthy hours, loud when pushing does nothing."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.support.rig import GAINS, rig
from twinmatch.dynamics import Pid, advance, begin, read
from twinmatch.safety import Runaway
from twinmatch.signals import Window

RIG = rig(seebeck=0.06, conductance=0.65, heat_capacity=28.0)


def first_alarm(
    reference: Callable[[int], float], drive: Callable[[int, float], float], ticks: int = 900
) -> int:
    """Run the rig in its loop with a drive that may fail; the tick of the first alarm, or `ticks`."""
    watch, pid, states = Runaway(), Pid(GAINS), begin(RIG, 22.85)
    for k in range(ticks):
        y = read(RIG, states)
        u = pid.step(reference(k), y)
        if watch.check(float(k), reference(k), y, u):
            return k
        states = advance(RIG, states, drive(k, u), GAINS.period)
    return ticks


def both_ways(k: int) -> float:
    return 70.0 if (k // 300) % 2 == 0 else 25.0


def test_a_healthy_loop_raises_nothing_in_both_directions() -> None:
    assert first_alarm(both_ways, lambda _, u: u) == 900


@pytest.mark.parametrize(("at", "within"), [(20, 90), (320, 90)])
def test_a_lost_drive_is_found_while_heating_and_while_cooling(at: int, within: int) -> None:
    found = first_alarm(both_ways, lambda k, u: u if k < at else 0.0)
    # While cooling towards 25 °C a plate without drive still cools by itself; the alarm may only come
    # with the next heating.
    assert at < found < (at + within if at < 300 else 600 + within)


def test_a_reversed_cable_is_found_at_once() -> None:
    assert first_alarm(lambda _: 60.0, lambda _, u: -u) < 30


def test_a_clock_set_back_starts_the_watch_again() -> None:
    watch = Runaway()
    assert watch.check(100.0, 60.0, 25.0, 255.0) is None
    assert watch.check(10.0, 60.0, 25.0, 255.0) is None
    assert watch.check(11.0, 60.0, 25.0, 255.0) is None


@pytest.mark.parametrize("number", [1, 2, 5, 9, 14, 20])
def test_no_alarm_over_a_healthy_hour(number: int, recorded_hour: Callable[[int], Window]) -> None:
    assert _alarm_in(recorded_hour(number)) is None


def test_the_lost_drive_of_a_real_hour_is_found(recorded_hour: Callable[[int], Window]) -> None:
    found = _alarm_in(recorded_hour(27))
    assert found is not None
    assert 2235 < found < 2355


def _alarm_in(hour: Window) -> int | None:
    watch = Runaway()
    for k in range(len(hour)):
        if watch.check(float(k), hour.reference[k], hour.output[k], hour.input[k]):
            return k
    return None
