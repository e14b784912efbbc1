"""The forecasts that need no twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinmatch.dynamics import PidGains, PidState
from twinmatch.forecasting import Arx
from twinmatch.signals import FloatArray, Sample

GAINS = PidGains(2.0, 0.4, 0.1, 1.0, -5.0, 5.0)


def plant(y: float, y_before: float, u: float, u_before: float, room: float) -> float:
    return y + 0.3 - 0.1 * y + 0.4 * (y - y_before) + 0.2 * u + 0.05 * u_before + 0.02 * room


def record(n: int, gains: PidGains | None, seed: int = 1) -> tuple[list[Sample], list[PidState]]:
    """An exact run of `plant`: of the loop if there are gains, otherwise under random inputs."""
    from twinmatch.dynamics import Pid

    random = np.random.default_rng(seed)
    y = y_before = u_before = 0.0
    pid, samples, states = Pid(gains or GAINS), [], []
    for k in range(n):
        room, reference = (
            20.0 + random.uniform(),
            float(random.integers(0, 8)) if k % 25 == 0 else samples[-1].reference,
        )
        u = pid.step(reference, y) if gains else random.uniform(-1.0, 1.0)
        samples.append(Sample(k, 0, reference, y, u, (room,)))
        states.append(pid.state)
        y, y_before, u_before = plant(y, y_before, u, u_before, room), y, u
    return samples, states


def fed(samples: list[Sample], gains: PidGains | None, kept: float = 1.0) -> Arx:
    arx = Arx(gains, kept)
    for sample in samples:
        arx.push(sample)
    return arx


def future(
    samples: list[Sample], at: int, gains: PidGains | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Condition, disturbances and measured signals after the sample `at`."""
    rest = samples[at + 1 :]
    given = np.array([s.reference if gains else s.input for s in rest])
    return (
        given,
        np.array([s.disturbances for s in samples[at:]]),
        np.array([[s.output, s.input] for s in rest]).T,
    )


@pytest.mark.parametrize("gains", [GAINS, None], ids=["closed loop", "given inputs"])
def test_a_plant_of_its_form_is_forecast_exactly(gains: PidGains | None) -> None:
    samples, states = record(300, gains)
    given_ahead, rows, came = future(samples, 199, gains)
    found = fed(samples[:200], gains).departure(states[199]).forecast(given_ahead, rows)
    np.testing.assert_allclose(found, came, atol=1e-6)


def test_until_there_are_enough_samples_nothing_changes() -> None:
    samples, states = record(12, GAINS)
    found = fed(samples, GAINS).departure(states[11]).forecast(np.ones(4), np.ones((5, 1)))
    np.testing.assert_array_equal(found, np.repeat([[samples[-1].output], [samples[-1].input]], 4, axis=1))


def test_it_does_not_leave_what_was_visited_by_more_than_its_width() -> None:
    """A plant that runs away while it is watched."""
    samples = [Sample(k, 0, 0.0, float(np.exp(0.05 * k)), 0.1 * (k % 3)) for k in range(80)]
    found = fed(samples, None).departure(PidState()).forecast(np.zeros(400), None)
    low, high = samples[0].output, samples[-1].output
    assert found[0, -1] == pytest.approx(2.0 * high - low)


@settings(max_examples=20)
@given(st.sets(st.integers(3, 195), max_size=60), st.integers(0, 3))
def test_lost_samples_and_gaps_teach_nothing_wrong(lost: set[int], seed: int) -> None:
    """Values of stand-ins are nonsense here; whatever is learned comes from the others."""
    samples, states = record(400, GAINS, seed)
    with_gap = [
        Sample(s.index, 0, s.reference, 1e3, -1e3, s.disturbances, seen=False) if k in lost and k % 2 else s
        for k, s in enumerate(samples[:250])
        if k not in lost or k % 2
    ]
    given_ahead, rows, came = future(samples, 249, GAINS)
    arx = fed(with_gap, GAINS)
    found = arx.departure(states[249]).forecast(given_ahead, rows)
    np.testing.assert_allclose(found, came, atol=1e-4)


def test_older_samples_weigh_less() -> None:
    """The plant doubles its input's effect in the middle."""
    samples, _ = record(400, None)
    doubled = []
    y = y_before = u_before = 0.0
    for k, s in enumerate(samples):
        factor = 2.0 if k >= 200 else 1.0
        doubled.append(Sample(k, 0, 0.0, y, s.input, s.disturbances))
        y, y_before, u_before = (
            plant(y, y_before, factor * s.input, factor * u_before, s.disturbances[0]),
            y,
            s.input,
        )
    slopes = [fed(doubled, None, kept).departure(PidState()).coefficients[3] for kept in (1.0, 0.9)]
    assert slopes[1] == pytest.approx(0.4, abs=1e-3)
    assert slopes[0] < 0.38
