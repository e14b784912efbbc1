"""The forecasts that need no twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinmatch.dynamics import Controller, PidGains
from twinmatch.fitting.arx import Arx
from twinmatch.signals import FloatArray, Sample

GAINS = PidGains(2.0, 0.4, 0.1, 1.0, -5.0, 5.0)


def plant(y: float, y_before: float, u: float, u_before: float, room: float) -> float:
    return (
        y
        + 0.3
        - 0.1 * y
        + 0.4 * (y - y_before)
        + 0.2 * u
        + 0.05 * u_before
        + 0.02 * room
    )


def record(
    n: int, gains: PidGains | None, seed: int = 1
) -> tuple[list[Sample], list[np.ndarray]]:
    """An exact run of `plant`: of the loop if there are gains, otherwise under random inputs."""
    random = np.random.default_rng(seed)
    y = y_before = u_before = 0.0
    pid = Controller(gains or GAINS)
    samples = []
    states = []
    for k in range(n):
        room = 20.0 + random.uniform()
        reference = (
            float(random.integers(0, 8)) if k % 25 == 0 else samples[-1].reference
        )
        u = float(pid.step(reference, y)[0]) if gains else random.uniform(-1.0, 1.0)
        samples.append(Sample(k, 0, reference, y, u, (room,)))
        states.append(pid.state)
        y_next = plant(y, y_before, u, u_before, room)
        y_before = y
        u_before = u
        y = y_next
    return samples, states


def fed(samples: list[Sample], gains: PidGains | None, forgetting: float = 1.0) -> Arx:
    arx = Arx(gains, forgetting)
    for sample in samples:
        arx.push(sample)
    return arx


def future(
    samples: list[Sample], newest: int, gains: PidGains | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Condition, disturbances and measured signals after the sample `newest`."""
    later = samples[newest + 1 :]
    condition = np.array([s.reference if gains else s.input for s in later])
    return (
        condition,
        np.array([s.disturbances for s in samples[newest:]]),
        np.array([[s.output, s.input] for s in later]).T,
    )


@pytest.mark.parametrize("gains", [GAINS, None], ids=["closed loop", "given inputs"])
def test_a_plant_of_its_form_is_forecast_exactly(gains: PidGains | None) -> None:
    samples, states = record(300, gains)
    given_ahead, rows, came = future(samples, 199, gains)
    forecast = (
        fed(samples[:200], gains).departure(states[199]).forecast(given_ahead, rows)
    )
    np.testing.assert_allclose(forecast, came, atol=1e-6)


def test_a_plant_of_its_form_with_several_signals_is_forecast_exactly() -> None:
    """Three outputs that act on one another, two inputs and a disturbance."""
    random = np.random.default_rng(2)
    by_y, by_step, by_u = (
        random.uniform(-0.1, 0.1, shape) for shape in ((3, 3), (3, 3), (3, 2))
    )
    u = random.uniform(-1.0, 1.0, (300, 2))
    room = random.uniform(size=300)
    y = np.zeros((300, 3))
    for k in range(1, 299):
        rate = (
            by_y @ y[k]
            + by_step @ (y[k] - y[k - 1])
            + by_u @ (u[k] + 0.5 * u[k - 1])
            + 0.1 * room[k]
        )
        y[k + 1] = 0.9 * y[k] + rate
    rows = zip(y.tolist(), u.tolist(), room.tolist(), strict=True)
    samples = [
        Sample(k, 0, (0.0,) * 3, tuple(y), tuple(u), (d,))
        for k, (y, u, d) in enumerate(rows)
    ]
    forecast = (
        fed(samples[:200], None)
        .departure(np.zeros(0))
        .forecast(u[200:], room[199:, None])
    )
    np.testing.assert_allclose(forecast, np.hstack([y[200:], u[200:]]).T, atol=1e-9)


@given(st.sets(st.integers(0, 119)), st.booleans())
@settings(max_examples=20, deadline=None)
def test_who_asks_in_between_changes_no_bit(asked: set[int], gap: bool) -> None:
    """Forecasts asked for beside a run, on a page or by a service, are not in its verdicts."""
    samples = [s for s in record(120, GAINS)[0] if not (gap and 60 <= s.index < 63)]
    quiet = Arx(GAINS, 0.99)
    curious = Arx(GAINS, 0.99)
    for sample in samples:
        quiet.push(sample)
        curious.push(sample)
        if sample.index in asked:
            curious.departure(np.zeros(2))
    for quiet_part, curious_part in zip(
        quiet.departure(np.zeros(2)), curious.departure(np.zeros(2)), strict=True
    ):
        if isinstance(quiet_part, np.ndarray):
            np.testing.assert_array_equal(quiet_part, curious_part)


def test_until_there_are_enough_samples_nothing_changes() -> None:
    samples, states = record(12, GAINS)
    forecast = (
        fed(samples, GAINS).departure(states[11]).forecast(np.ones(4), np.ones((5, 1)))
    )
    np.testing.assert_array_equal(
        forecast, np.repeat([[samples[-1].output], [samples[-1].input]], 4, axis=1)
    )


def test_it_does_not_leave_what_was_visited_by_more_than_its_width() -> None:
    """A plant that runs away while it is watched."""
    samples = [
        Sample(k, 0, 0.0, float(np.exp(0.05 * k)), 0.1 * (k % 3)) for k in range(80)
    ]
    forecast = fed(samples, None).departure(np.zeros(0)).forecast(np.zeros(400), None)
    low = samples[0].output
    high = samples[-1].output
    assert forecast[0, -1] == pytest.approx(2.0 * high - low)


@settings(max_examples=20)
@given(st.sets(st.integers(3, 195), max_size=60), st.integers(0, 3))
def test_lost_samples_and_gaps_teach_nothing_wrong(lost: set[int], seed: int) -> None:
    """Values of stand-ins are nonsense here; whatever is learned comes from the others."""
    samples, states = record(400, GAINS, seed)
    with_gap = [
        Sample(s.index, 0, s.reference, 1e3, -1e3, s.disturbances, seen=False)
        if k in lost and k % 2
        else s
        for k, s in enumerate(samples[:250])
        if k not in lost or k % 2
    ]
    given_ahead, rows, came = future(samples, 249, GAINS)
    arx = fed(with_gap, GAINS)
    forecast = arx.departure(states[249]).forecast(given_ahead, rows)
    np.testing.assert_allclose(forecast, came, atol=1e-4)


def test_older_samples_weigh_less() -> None:
    """The plant doubles its input's effect in the middle."""
    samples, _ = record(400, None)
    doubled = []
    y = y_before = u_before = 0.0
    for k, s in enumerate(samples):
        factor = 2.0 if k >= 200 else 1.0
        doubled.append(Sample(k, 0, 0.0, y, s.input, s.disturbances))
        y_next = plant(
            y, y_before, factor * s.input, factor * u_before, s.disturbances[0]
        )
        y_before = y
        u_before = s.input
        y = y_next
    slopes = [
        fed(doubled, None, forgetting).departure(np.zeros(0)).coefficients[0, 2]
        for forgetting in (1.0, 0.97)
    ]
    assert slopes[1] == pytest.approx(0.4, abs=0.01)
    assert slopes[0] < 0.38


def resonator(size: int, lost: frozenset[int]) -> list[Sample]:
    """A weakly damped mass on a spring under a random force; where a reading is lost, something far off
    stands in for it."""
    random = np.random.default_rng(11)
    forces = np.cumsum(random.standard_normal(size)) * 0.05
    place = np.zeros(size)
    for k in range(2, size):
        place[k] = 1.6 * place[k - 1] - 0.96 * place[k - 2] + 0.3 * forces[k - 1]
    read = place + 0.001 * random.standard_normal(size)
    return [
        Sample(k, k * 10**9, 0.0, 9.0 if k in lost else y, u, seen=k not in lost)
        for k, (y, u) in enumerate(zip(read.tolist(), forces.tolist(), strict=True))
    ]


def test_behind_lost_readings_arx_continues_from_its_own_expectation_and_persistence_from_what_was_read() -> (
    None
):
    """Without that, what stands in for a reading is a blow to a model of differences."""
    lost = frozenset({290, 291, 292, 297, 299})
    whole = fed(resonator(320, frozenset())[:300], None).departure(np.zeros(0))
    with_lost = fed(resonator(320, lost)[:300], None).departure(np.zeros(0))
    samples = resonator(320, lost)
    given_ahead = np.array([sample.inputs for sample in samples[300:]])
    of_whole = whole.referees(given_ahead, None)
    of_lost = with_lost.referees(given_ahead, None)
    assert of_lost[0, 0, 0] == samples[298].outputs[0]
    true = np.array([sample.outputs[0] for sample in samples[300:]])
    error = np.sqrt(np.mean(np.square(of_lost[1, 0] - true)))
    error_of_whole = np.sqrt(np.mean(np.square(of_whole[1, 0] - true)))
    # Five expectations in place of five readings: a few of its one-step errors, which are its noise.
    assert error < error_of_whole + 0.02
    assert error < np.sqrt(np.mean(np.square(of_lost[0, 0] - true)))
