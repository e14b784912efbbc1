"""Numbers of ticks: one after the other however they jitter and drift, and a gap where ticks are missing."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sessions.sampling import Grid, Rate

SECOND = 1_000_000_000


def numbers(times: np.ndarray, period: float = 1.0) -> list[int | None]:
    grid = Grid(round(period * SECOND))
    return [grid.place(round(at * SECOND)) for at in times]


@given(
    st.floats(0.02, 30.0),
    st.floats(-0.01, 0.01),
    st.lists(st.floats(0.0, 0.4), min_size=2, max_size=400),
)
def test_no_tick_is_missed_that_is_late_or_drifts(period: float, drift: float, late: list[float]) -> None:
    """A loop whose second is 1 % wrong and whose messages come up to 0.4 periods late: lateness on the grid
    stays below 0.4 + 0.01/0.1 + what the leak moved it, and so below one period."""
    times = period * (np.arange(len(late)) * (1 + drift) + np.array(late))
    assert numbers(times, period) == list(range(len(late)))


@given(st.integers(1, 50), st.integers(2, 1000), st.floats(0.0, 0.9))
def test_a_gap_in_time_is_a_gap_in_the_numbers(before: int, gap: int, phase: float) -> None:
    """Behind it ticks may come at any moment of the period: a loop was restarted."""
    times = np.concatenate([np.arange(before), before - 1 + gap + phase + np.arange(50)])
    expected = [*range(before), *range(before - 1 + gap, before + 49 + gap)]
    assert numbers(times) == expected


def test_a_burst_is_one_tick() -> None:
    assert numbers(np.array([0.0, 1.0, 4.2, 4.21, 4.22, 5.0, 6.0])) == [0, 1, 4, None, None, 5, 6]


def test_a_clock_that_is_set_back_starts_over_behind_a_gap() -> None:
    assert numbers(np.array([100.0, 101.0, 5.0, 6.0])) == [0, 1, 3, 4]


def test_a_message_a_little_before_the_last_is_not_a_tick() -> None:
    assert numbers(np.array([0.0, 1.0, 0.9, 2.0])) == [0, 1, None, 2]


def rate_of(times: np.ndarray) -> Rate:
    rate = Rate()
    for at in times:
        rate.push(round(at * SECOND))
    return rate


@given(st.integers(6, 300), st.floats(0.0, 0.3), st.integers(0, 2**31))
def test_a_rate_is_never_doubted_for_its_jitter(size: int, jitter: float, seed: int) -> None:
    """Lateness of single ticks, uniform, up to a third of a period."""
    late = np.random.default_rng(seed).uniform(0.0, jitter, size)
    assert not rate_of(np.arange(size) + late).differs_from(1.0)


@given(st.sampled_from([0.5, 0.9, 1.03, 1.5, 2.0, 10.0]), st.integers(0, 2**31))
def test_another_rate_is_reported_with_its_period(true: float, seed: int) -> None:
    late = np.random.default_rng(seed).uniform(0.0, 0.02 * true, 40)
    rate = rate_of(true * np.arange(40) + late)
    assert rate.differs_from(1.0)
    assert abs(rate.period - true) < 0.01 * true


def test_gaps_and_bursts_do_not_count_for_the_rate() -> None:
    rate = rate_of(np.concatenate([np.arange(20), [24.5, 24.51], 25.0 + np.arange(20)]))
    assert not rate.differs_from(1.0)
    assert rate_of(np.arange(3.0)).period is None
