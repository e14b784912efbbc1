"""A plant tracked with everything unknown: what is true is found, and the filter is the textbook's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.plants import Lag
from twinmatch.dynamics import advance, begin
from twinmatch.dynamics.filters import Readings
from twinmatch.dynamics.tracker import (
    Assumed,
    Belief,
    TrackedCourse,
    Tracker,
    no_traces,
)

PERIOD = 1.0
NOISE = 0.01
TRUTH = Lag.model().parameters(gain=2.4, lag=7.0)


def stretch(seed: int, size: int, share: float = 1.0, rate: float = 0.0) -> Readings:
    """Readings of the true plant, whose drive does a share, and whose readings creep by a rate per second."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-5.0, 5.0, size // 20 + 1), 20)[:size]
    states = begin(TRUTH, 0.0)
    y = np.empty(size)
    for k in range(size):
        y[k] = states[0] + random.normal(0.0, NOISE) + rate * k
        states = advance(TRUTH, states, share * u[k], PERIOD)
    before = np.full(2, np.nan)
    return Readings(
        np.concatenate([before, y]), u, np.zeros((size, 0)), np.full(size, NOISE)
    )


def tracker() -> Tracker:
    return Tracker(Lag.model().parameters(), PERIOD, (0.01, 1.0))


def first(lag_tracker: Tracker) -> Belief:
    return lag_tracker.begin(0.0, 0.0, np.zeros(0), 0)


@settings(max_examples=15)
@given(seed=st.integers(0, 1000))
def test_parameters_are_found_to_within_what_is_believed(seed: int) -> None:
    lag_tracker = tracker()
    belief, _ = lag_tracker.run(first(lag_tracker), stretch(seed, 300), 0)
    for name in lag_tracker.free:
        spread = (
            np.sqrt(belief.covariance[lag_tracker.at[name], lag_tracker.at[name]])
            * TRUTH[name]
        )
        assert lag_tracker.named(belief, name) == pytest.approx(
            TRUTH[name], abs=5 * spread + 1e-3 * TRUTH[name]
        )
        assert spread < 0.02 * TRUTH[name]


def test_in_pieces_is_the_same_as_in_one_piece_to_the_last_bit() -> None:
    lag_tracker = tracker()
    whole = stretch(3, 100)
    at_once, cost = lag_tracker.run(first(lag_tracker), whole, 1)
    belief = first(lag_tracker)
    total = 0.0
    for a in range(0, 100, 20):
        part = Readings(
            whole.output[a : a + 22],
            whole.input[a : a + 20],
            whole.disturbances[a : a + 20],
            whole.noise[:20],
        )
        belief, part_cost = lag_tracker.run(belief, part, 1)
        total += part_cost
    assert np.array_equal(belief.values, at_once.values)
    assert np.array_equal(belief.covariance, at_once.covariance)
    assert total == pytest.approx(cost, rel=1e-12)


def test_with_known_parameters_it_is_the_kalman_filter_of_the_textbook() -> None:
    """Of x' = a x + b u + c, y = x, written out here: means, variances and code length."""
    lag_tracker = tracker()
    closed_belief = first(lag_tracker)
    for index in range(1, lag_tracker.size):
        closed_belief = closed_belief.closed(index)
    for name in lag_tracker.free:
        lag_tracker.drifts[1].each[lag_tracker.at[name]] = 0.0
    record = stretch(5, 60)
    belief, cost = lag_tracker.run(closed_belief, record, 1)
    p = lag_tracker.parameters
    a = np.exp(-PERIOD / p["lag"])
    drift = lag_tracker.drifts[1].each[0] ** 2 * PERIOD
    swift = lag_tracker.drifts[1].swift
    fading = 0.0
    fade, _ = Assumed.of(p, PERIOD).keeps
    strays = lag_tracker.drifts[1].each[lag_tracker.fading] ** 2 * PERIOD
    state = np.zeros(2)
    push = np.array([1.0, 0.0])
    state[0] = closed_belief.values[0]
    covariance = np.diag([closed_belief.covariance[0, 0], fading])
    moved = np.array([[a, PERIOD], [0.0, fade]])
    total = 0.0
    for y, u in zip(record.output[2:], record.input, strict=True):
        variance = push @ covariance @ push + NOISE**2
        surprise = y - state[0]
        variance = max(variance, (surprise / 3.0) ** 2)
        total += 0.5 * np.log(variance) + 0.5 * surprise**2 / variance
        gain = covariance @ push / variance
        state = state + gain * surprise
        covariance = covariance - np.outer(gain, covariance @ push)
        before = state[0]
        driven = a * before + (1 - a) * p["gain"] * u
        state = np.array([driven + PERIOD * state[1], fade * state[1]])
        covariance = moved @ covariance @ moved.T + np.diag(
            [drift + (swift * (driven - before)) ** 2, strays]
        )
    assert cost == pytest.approx(total, rel=1e-4)
    assert belief.values[0] == pytest.approx(state[0], rel=1e-4)
    assert belief.covariance[0, 0] == pytest.approx(covariance[0, 0], rel=1e-2)


def test_what_is_opened_is_found() -> None:
    lag_tracker = tracker()
    learned, _ = lag_tracker.run(first(lag_tracker), stretch(1, 300), 0)
    later = lag_tracker.again(learned, 0.0, 0.0, np.zeros(0))
    weak, saved = lag_tracker.run(
        later.opened(lag_tracker.share, 0.0, 0.3), stretch(2, 100, share=0.7), 0
    )
    _, plain = lag_tracker.run(later, stretch(2, 100, share=0.7), 0)
    assert weak.values[lag_tracker.share] == pytest.approx(-0.3, abs=0.02)
    assert saved < plain - 20
    creeping = stretch(2, 100, rate=0.02)
    crept, _ = TrackedCourse(
        lag_tracker,
        later.opened(lag_tracker.rate, 0.0, 0.02),
        0,
        rising=lag_tracker.offset,
    ).to(creeping)
    assert crept.values[lag_tracker.rate] == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("course_options", [{}, {"rising": -5}, {"lasting": 30}])
def test_readings_tracked_as_they_come_give_the_same_bits_as_all_at_once(
    course_options: dict[str, int],
) -> None:
    lag_tracker = tracker()
    record = stretch(3, 100, share=0.8)
    options = {
        name: lag_tracker.size + value if name == "rising" else value
        for name, value in course_options.items()
    }
    opened = np.full(lag_tracker.size, 0.05)
    before = first(lag_tracker).opened(lag_tracker.rate, 0.0, 0.02)
    whole, cost = TrackedCourse(lag_tracker, before, 0, opened=opened, **options).to(
        record
    )
    course = TrackedCourse(lag_tracker, before, 0, opened=opened, **options)
    for end in (1, 20, 45, 100):
        parts = course.to(record.part(0, end))
    assert (parts[0].values.tolist(), parts[1]) == (whole.values.tolist(), cost)
    assert parts[0].covariance.tolist() == whole.covariance.tolist()
    assert cost != TrackedCourse(lag_tracker, before, 0).to(record)[1] or not options


def test_traces_forecast_what_a_jump_leaves_in_the_surprises() -> None:
    """The gain they promise is the one that following the jump for itself brings."""
    lag_tracker = tracker()
    learned, _ = lag_tracker.run(first(lag_tracker), stretch(1, 300), 0)
    later = lag_tracker.again(learned, 0.0, 0.0, np.zeros(0))
    record = stretch(2, 100, rate=0.0)._replace()
    record.output[2:] += 0.05
    traces = no_traces(lag_tracker.size)._replace(
        effects=np.zeros((lag_tracker.size, 1, 1)),
        hits=np.zeros((1, 1)),
        weights=np.zeros((1, 1)),
    )
    traces.effects[lag_tracker.offset, 0, 0] = 1.0
    _, plain = lag_tracker.run(later, record, 0, traces=traces)
    spread = 0.1
    promised = 0.5 * traces.hits[0, 0] ** 2 / (
        traces.weights[0, 0] + spread**-2
    ) - 0.5 * np.log1p(traces.weights[0, 0] * spread**2)
    _, saved = lag_tracker.run(later.opened(lag_tracker.offset, 0.0, spread), record, 0)
    assert plain - saved == pytest.approx(promised, rel=0.3, abs=1.0)
