"""Nothing doubtful passes the guard, what latched stays latched; runaway and clocks that go back are seen."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.rig import GAINS, rig
from twinmatch.dynamics import Controller, advance, begin, read
from twinmatch.safety import (
    ClockLimits,
    FaultKind,
    GuardFault,
    GuardLimits,
    OutputGuard,
    Runaway,
    RunawayLimits,
    SafetyClock,
)
from twinmatch.safety.limits import SafetyError
from twinmatch.signals import Window


def armed(at: float = 0.0) -> OutputGuard:
    guard = OutputGuard()
    guard.temperature(25.0, at)
    guard.command(100.0, at)
    assert guard.output(at) == 100.0
    return guard


def test_nothing_passes_before_both_inputs_were_good() -> None:
    guard = OutputGuard()
    assert guard.output(0.0) == 0.0
    guard.command(200.0, 0.0)
    assert guard.output(0.0) == 0.0
    assert not guard.armed
    guard.temperature(25.0, 0.1)
    assert guard.output(0.1) == 200.0


@pytest.mark.parametrize(
    ("kind", "break_it"),
    [
        (FaultKind.COMMAND_SILENT, lambda g: g.temperature(25.0, 1.01)),
        (
            FaultKind.TEMPERATURE_STALE,
            lambda g: [g.command(100.0, t / 2) for t in range(8)],
        ),
        (FaultKind.COMMAND_INVALID, lambda g: g.command(math.nan, 0.5)),
        (FaultKind.COMMAND_INVALID, lambda g: g.command(255.5, 0.5)),
        (FaultKind.TEMPERATURE_INVALID, lambda g: g.temperature(math.nan, 0.5)),
        (FaultKind.OVER_TEMPERATURE, lambda g: g.temperature(110.1, 0.5)),
        (FaultKind.UNDER_TEMPERATURE, lambda g: g.temperature(-10.1, 0.5)),
        (FaultKind.DRIVER, lambda g: g.trip(FaultKind.DRIVER, "nSF is low", 0.5)),
    ],
)
def test_each_fault_zeroes_the_output_and_latches(
    kind: FaultKind, break_it: object
) -> None:
    guard = armed()
    break_it(guard)  # type: ignore[operator]
    fault_time = 3.4 if kind is FaultKind.TEMPERATURE_STALE else 1.1
    assert guard.output(fault_time) == 0.0
    assert guard.fault is not None
    assert guard.fault.kind is kind
    guard.command(100.0, fault_time)
    guard.temperature(25.0, fault_time)
    assert guard.output(fault_time) == 0.0


def test_clearing_needs_new_inputs_before_anything_passes() -> None:
    guard = armed()
    guard.trip(FaultKind.DRIVER, "over-current", 0.5)
    guard.clear()
    assert guard.fault is None
    assert guard.output(0.6) == 0.0
    guard.command(50.0, 0.7)
    guard.temperature(25.0, 0.7)
    assert guard.output(0.7) == 50.0


def test_the_first_fault_is_the_one_reported() -> None:
    guard = armed()
    guard.temperature(200.0, 0.5)
    guard.trip(FaultKind.DRIVER, "later", 0.6)
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.OVER_TEMPERATURE
    assert "above 110 °C" in guard.fault.message


def test_full_drive_without_an_effect_latches() -> None:
    guard = armed()
    for k in range(200):
        time = k * 0.5
        guard.command(255.0, time)
        guard.temperature(25.0, time)
        guard.loop(60.0, 25.0, 255.0, time)
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.RUNAWAY
    assert guard.output(100.0) == 0.0


def test_what_the_ceiling_holds_back_is_not_a_runaway_until_it_lets_go() -> None:
    guard = armed()
    guard.limited = GuardFault(FaultKind.LIMITED, "the drive is held back", 0.0)
    for k in range(400):
        if k == 200:
            assert guard.fault is None
            guard.limited = None
        guard.loop(60.0, 25.0, 255.0, k * 0.5)
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.RUNAWAY


def test_while_it_waits_silence_is_not_a_fault() -> None:
    guard = OutputGuard()
    guard.temperature(25.0, 0.0)
    assert guard.output(60.0) == 0.0
    guard.command(100.0, 60.0)
    assert guard.output(60.0) == 0.0
    guard.temperature(25.0, 62.0)
    assert guard.output(62.0) == 0.0
    guard.command(100.0, 62.0)
    assert guard.fault is None
    assert guard.output(62.0) == 100.0


def test_held_it_does_not_arm_and_an_armed_one_latches() -> None:
    guard = OutputGuard()
    guard.hold("two nodes command", 0.0)
    guard.temperature(25.0, 0.0)
    guard.command(100.0, 0.0)
    assert (guard.output(0.0), guard.armed, guard.fault) == (0.0, False, None)
    guard.hold("", 0.1)
    assert guard.output(0.1) == 100.0
    guard.hold("two nodes command", 0.2)
    assert (guard.output(0.2), guard.fault and guard.fault.kind) == (
        0.0,
        FaultKind.SENDERS,
    )
    guard.hold("", 0.3)
    assert guard.output(0.3) == 0.0


def test_what_is_old_on_arrival_is_not_fresh() -> None:
    guard = OutputGuard()
    guard.temperature(25.0, 10.0, age=3.5)
    guard.command(100.0, 10.0)
    assert guard.output(10.0) == 0.0
    guard.temperature(25.0, 10.1, age=2.0)
    assert guard.output(10.1) == 100.0
    for tenth in range(9):
        guard.command(100.0, 10.2 + tenth / 10)
        # the same one again and again
        guard.temperature(25.0, 10.2 + tenth / 10, age=2.1 + tenth / 10)
    assert guard.output(11.0) == 100.0
    assert guard.output(11.2) == 0.0
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.TEMPERATURE_STALE


def test_a_stamp_from_the_future_makes_nothing_fresher_than_now() -> None:
    guard = OutputGuard()
    guard.temperature(25.0, 0.0, age=-1000.0)
    guard.command(100.0, 0.0, age=-1000.0)
    assert guard.output(1.0) == 100.0
    assert guard.output(1.01) == 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GuardLimits(command_timeout=0.0), "command_timeout is 0.0 s"),
        (
            lambda: GuardLimits(temperature_timeout=100.0),
            "temperature_timeout is 100.0 s",
        ),
        (lambda: GuardLimits(lowest=120.0), "must be below"),
        (lambda: RunawayLimits(patience=math.nan), "patience is nan"),
        (lambda: ClockLimits(patience=0.0), "clock limits: patience is 0.0 s"),
        (lambda: ClockLimits(progress=0.0), "clock limits: progress is 0.0 s"),
    ],
)
def test_limits_that_protect_nothing_are_refused(make: object, message: str) -> None:
    with pytest.raises(SafetyError, match=message):
        make()  # type: ignore[operator]


def test_a_temperature_that_the_plant_cannot_have_is_not_believed_and_latches_if_it_stays() -> (
    None
):
    """The dangerous one is cold: the controller heats. A few wrong readings are skipped."""
    guard = OutputGuard()
    for tick in range(120):
        time = tick / 10
        lies = 20 <= tick < 45 or tick >= 70
        guard.temperature(20.0 if lies else 80.0, time)
        guard.command(255.0, time)
        guard.output(time)
        assert guard.armed or tick > 95
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.TEMPERATURE_INVALID
    assert 9.9 < guard.fault.since < 10.2
    assert re.fullmatch(
        "the plate is at 20.0 °C, 3.[01] s after 80.0 °C: faster than it can; check the camera, and who else "
        "publishes temperatures",
        guard.fault.message,
    )
    guard.clear()
    guard.temperature(20.0, 12.0)
    guard.command(100.0, 12.0)
    assert guard.output(12.0) == 100.0, "the operator knows better"


@pytest.mark.parametrize("number", [1, 2, 5, 9, 14, 20, 27])
def test_every_reading_of_a_real_hour_is_believed(
    number: int, recorded_hour: Callable[[int], Window]
) -> None:
    """If one were not, the one before it would be too old when the command passes."""
    guard = OutputGuard(GuardLimits(temperature_timeout=1.5))
    for k, temperature in enumerate(recorded_hour(number).output):
        guard.temperature(float(temperature), float(k))
        guard.command(1.0, k + 0.9)
        assert guard.output(k + 0.9) == 1.0


events = st.one_of(
    st.tuples(st.just("command"), st.floats(allow_nan=True, allow_infinity=True)),
    st.tuples(st.just("temperature"), st.floats(allow_nan=True, allow_infinity=True)),
    st.tuples(st.just("command"), st.floats(-255, 255)),
    st.tuples(st.just("temperature"), st.floats(-5, 105)),
    st.tuples(st.just("driver"), st.just(0.0)),
    st.tuples(st.just("clear"), st.just(0.0)),
)


@given(st.lists(st.tuples(st.floats(0, 2), events), max_size=40))
def test_what_passes_is_always_a_fresh_good_command_on_a_fresh_good_temperature(
    story: list[tuple[float, tuple[str, float]]],
) -> None:
    guard = OutputGuard()
    time = 0.0
    good_command = good_temperature = -math.inf
    newest = 0.0
    broken = False
    for wait, (event, value) in story:
        time += wait
        if event == "clear":
            guard.clear()
            good_command = good_temperature = -math.inf
            broken = False
        elif event == "driver":
            guard.trip(FaultKind.DRIVER, "x", time)
            broken = True
        elif event == "command":
            guard.command(value, time)
            if math.isfinite(value) and abs(value) <= 255:
                good_command = time
                newest = value
            else:
                broken = True
        else:
            guard.temperature(value, time)
            if -10 <= value <= 110:
                good_temperature = time
            else:
                broken = True
        output = guard.output(time)
        assert math.isfinite(output)
        if output != 0.0:
            assert not broken
            assert output == newest
            assert time - good_command <= 1.0
            assert time - good_temperature <= 3.0


RIG = rig(seebeck=0.06, conductance=0.65, heat_capacity=28.0)


def first_alarm(
    reference: Callable[[int], float],
    drive: Callable[[int, float], float],
    ticks: int = 900,
) -> int:
    """Run the rig in its loop with a drive that may fail; the tick of the first alarm, or `ticks`."""
    watch = Runaway()
    pid = Controller(GAINS)
    states = begin(RIG, 22.85)
    for k in range(ticks):
        y = read(RIG, states)
        u = pid.step(reference(k), y)[0]
        if watch.check(float(k), reference(k), y, u):
            return k
        states = advance(RIG, states, drive(k, u), GAINS.period)
    return ticks


def both_ways(k: int) -> float:
    return 70.0 if (k // 300) % 2 == 0 else 25.0


def test_a_healthy_loop_raises_nothing_in_both_directions() -> None:
    assert first_alarm(both_ways, lambda _, u: u) == 900


@pytest.mark.parametrize(("onset", "within"), [(20, 90), (320, 90)])
def test_a_lost_drive_is_found_while_heating_and_while_cooling(
    onset: int, within: int
) -> None:
    alarm = first_alarm(both_ways, lambda k, u: u if k < onset else 0.0)
    # While cooling towards 25 °C a plate without drive still cools by itself; the alarm may only come
    # with the next heating.
    assert onset < alarm < (onset + within if onset < 300 else 600 + within)


def test_a_reversed_cable_is_found_at_once() -> None:
    assert first_alarm(lambda _: 60.0, lambda _, u: -u) < 30


def test_a_clock_set_back_starts_the_watch_again() -> None:
    watch = Runaway()
    assert watch.check(100.0, 60.0, 25.0, 255.0) is None
    assert watch.check(10.0, 60.0, 25.0, 255.0) is None
    assert watch.check(11.0, 60.0, 25.0, 255.0) is None


@pytest.mark.parametrize("number", [1, 2, 5, 9, 14, 20])
def test_no_alarm_over_a_healthy_hour(
    number: int, recorded_hour: Callable[[int], Window]
) -> None:
    assert _alarm_in(recorded_hour(number)) is None


def test_the_lost_drive_of_a_real_hour_is_found(
    recorded_hour: Callable[[int], Window],
) -> None:
    alarm = _alarm_in(recorded_hour(27))
    assert alarm is not None
    assert 2235 < alarm < 2355


def _alarm_in(hour: Window) -> int | None:
    watch = Runaway()
    for k in range(len(hour)):
        if watch.check(float(k), hour.reference[k], hour.output[k], hour.input[k]):
            return k
    return None


SECOND = 1_000_000_000


def test_time_begins_at_zero_and_follows_the_plant() -> None:
    clock = SafetyClock()
    assert clock.read(1_700_000_000 * SECOND, 5) == 0.0
    # ten times as fast as the wall's
    assert clock.read(1_700_000_010 * SECOND, 5 + SECOND) == 10.0
    assert not clock.stopped


def test_a_clock_that_goes_back_again_and_again_is_not_a_way_to_stay_young() -> None:
    clock = SafetyClock()
    times = [clock.read((10 - k % 2) * SECOND, k * SECOND // 10) for k in range(8)]
    assert times[-1] == 3.0


def test_standing_still_is_measured_on_the_wall_clock() -> None:
    clock = SafetyClock()
    clock.read(6 * SECOND, 0)
    assert clock.stopped  # nobody has seen it move
    clock.read(7 * SECOND, 0)
    clock.read(7 * SECOND, SECOND)
    assert not clock.stopped
    clock.read(7 * SECOND, SECOND + 1)
    assert clock.stopped
    assert clock.standing == pytest.approx(1.0)
    clock.read(8 * SECOND, SECOND + 2)
    assert not clock.stopped


def test_creeping_is_standing_still() -> None:
    """Else a deadline of one second could be made to last for a day."""
    clock = SafetyClock()
    clock.read(0, 0)
    for tenth in range(1, 12):
        clock.read(SECOND + tenth * SECOND // 1000, tenth * SECOND // 10)
        assert clock.stopped == (tenth > 11)
    clock.read(SECOND + SECOND // 20, 12 * SECOND // 10)
    assert clock.stopped


@given(
    st.lists(
        st.tuples(st.integers(-(10**12), 10**12), st.integers(0, 10**10)),
        min_size=1,
        max_size=50,
    )
)
def test_it_never_goes_back_and_a_deadline_has_an_end_on_the_wall_clock(
    steps: list[tuple[int, int]],
) -> None:
    """However the plant's clock behaves: while it is not called stopped, it makes its progress."""
    clock = SafetyClock()
    plant = 0
    wall = 0
    time = clock.read(plant, wall)
    mark: tuple[float, float] = (time, -math.inf)
    for step, pause in steps:
        plant = plant + step
        wall = wall + pause
        before = time
        time = clock.read(plant, wall)
        assert time >= before
        assert time - before == pytest.approx(max(0, step) / SECOND)
        if time - mark[0] >= clock.limits.progress:
            mark = (time, wall)
        assert clock.stopped == (wall - mark[1] > SECOND)
