"""Time that only runs forward, out of a clock that stops and goes back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.safety import ClockLimits, FaultKind, OutputGuard, SafetyClock, SafetyError

SECOND = 1_000_000_000


def test_time_begins_at_zero_and_follows_the_plant() -> None:
    clock = SafetyClock()
    assert clock.read(1_700_000_000 * SECOND, 5) == 0.0
    assert clock.read(1_700_000_010 * SECOND, 5 + SECOND) == 10.0  # ten times as fast as the wall's
    assert not clock.stopped


def test_a_clock_that_goes_back_extends_no_deadline() -> None:
    """A guard that received its last command at 100 s trips on time, although the clock went back to 0."""
    clock, guard = SafetyClock(), OutputGuard()
    wall = 0
    now = clock.read(100 * SECOND, wall)
    guard.temperature(25.0, now)
    guard.command(200.0, now)
    assert guard.output(now) == 200.0
    plants = [100.3, 100.6, 0.0, 0.2, 0.4, 0.6]  # 0.6 s before the jump, 0.6 s after it
    outputs = []
    for plant in plants:
        wall += SECOND // 10
        outputs.append(guard.output(clock.read(round(plant * SECOND), wall)))
    assert outputs == [200.0, 200.0, 200.0, 200.0, 200.0, 0.0]
    assert guard.fault is not None
    assert guard.fault.kind is FaultKind.COMMAND_SILENT


def test_a_clock_that_goes_back_again_and_again_is_not_a_way_to_stay_young() -> None:
    clock = SafetyClock()
    now = [clock.read((10 - k % 2) * SECOND, k * SECOND // 10) for k in range(8)]
    assert now[-1] == 3.0


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


@pytest.mark.parametrize("name", ["patience", "progress"])
def test_limits_have_a_range(name: str) -> None:
    with pytest.raises(SafetyError, match=f"clock limits: {name} is 0.0 s"):
        ClockLimits(**{name: 0.0})


@given(st.lists(st.tuples(st.integers(-(10**12), 10**12), st.integers(0, 10**10)), min_size=1, max_size=50))
def test_it_never_goes_back_and_a_deadline_has_an_end_on_the_wall_clock(
    steps: list[tuple[int, int]],
) -> None:
    """However the plant's clock behaves: while it is not called stopped, it makes its progress."""
    clock, plant, wall = SafetyClock(), 0, 0
    now = clock.read(plant, wall)
    mark: tuple[float, float] = (now, -math.inf)
    for step, pause in steps:
        plant, wall = plant + step, wall + pause
        before, now = now, clock.read(plant, wall)
        assert now >= before
        assert now - before == pytest.approx(max(0, step) / SECOND)
        if now - mark[0] >= clock.limits.progress:
            mark = (now, wall)
        assert clock.stopped == (wall - mark[1] > SECOND)
