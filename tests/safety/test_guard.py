"""Nothing doubtful passes the guard, and what latched stays latched."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.safety import FaultKind, GuardLimits, OutputGuard, RunawayLimits, SafetyError


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
        (FaultKind.TEMPERATURE_STALE, lambda g: [g.command(100.0, t / 2) for t in range(8)]),
        (FaultKind.COMMAND_INVALID, lambda g: g.command(math.nan, 0.5)),
        (FaultKind.COMMAND_INVALID, lambda g: g.command(255.5, 0.5)),
        (FaultKind.TEMPERATURE_INVALID, lambda g: g.temperature(math.nan, 0.5)),
        (FaultKind.OVER_TEMPERATURE, lambda g: g.temperature(110.1, 0.5)),
        (FaultKind.UNDER_TEMPERATURE, lambda g: g.temperature(-10.1, 0.5)),
        (FaultKind.DRIVER, lambda g: g.trip(FaultKind.DRIVER, "nSF is low", 0.5)),
    ],
)
def test_each_fault_zeroes_the_output_and_latches(kind: FaultKind, break_it: object) -> None:
    guard = armed()
    break_it(guard)  # type: ignore[operator]
    at = 3.4 if kind is FaultKind.TEMPERATURE_STALE else 1.1
    assert guard.output(at) == 0.0
    assert guard.fault is not None
    assert guard.fault.kind is kind
    guard.command(100.0, at)
    guard.temperature(25.0, at)
    assert guard.output(at) == 0.0


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


def test_runaway_latches() -> None:
    guard = armed()
    for k in range(200):
        now = k * 0.5
        guard.command(255.0, now)
        guard.temperature(25.0, now)
        guard.loop(60.0, 25.0, 255.0, now)
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.RUNAWAY
    assert guard.output(100.0) == 0.0


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


def test_what_is_old_on_arrival_is_not_fresh() -> None:
    guard = OutputGuard()
    guard.temperature(25.0, 10.0, age=3.5)
    guard.command(100.0, 10.0)
    assert guard.output(10.0) == 0.0
    guard.temperature(25.0, 10.1, age=2.0)
    assert guard.output(10.1) == 100.0
    for tenth in range(9):
        guard.command(100.0, 10.2 + tenth / 10)
        guard.temperature(25.0, 10.2 + tenth / 10, age=2.1 + tenth / 10)  # the same one again and again
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
        (lambda: GuardLimits(temperature_timeout=100.0), "temperature_timeout is 100.0 s"),
        (lambda: GuardLimits(lowest=120.0), "must be below"),
        (lambda: RunawayLimits(patience=math.nan), "patience is nan"),
    ],
)
def test_limits_that_protect_nothing_are_refused(make: object, message: str) -> None:
    with pytest.raises(SafetyError, match=message):
        make()  # type: ignore[operator]


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
    guard, now = OutputGuard(), 0.0
    good_command = good_temperature = -math.inf
    newest, broken = 0.0, False
    for wait, (what, value) in story:
        now += wait
        if what == "clear":
            guard.clear()
            good_command = good_temperature = -math.inf
            broken = False
        elif what == "driver":
            guard.trip(FaultKind.DRIVER, "x", now)
            broken = True
        elif what == "command":
            guard.command(value, now)
            if math.isfinite(value) and abs(value) <= 255:
                good_command, newest = now, value
            else:
                broken = True
        else:
            guard.temperature(value, now)
            if -10 <= value <= 110:
                good_temperature = now
            else:
                broken = True
        output = guard.output(now)
        assert math.isfinite(output)
        if output != 0.0:
            assert not broken
            assert output == newest
            assert now - good_command <= 1.0
            assert now - good_temperature <= 3.0
