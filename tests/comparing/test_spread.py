"""The kernels behind the intervals, against the formulas they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import GraphSymbol, nu_gap_of
from twinmatch.comparing.uncertainty import (
    directions,
    disturbed_pair,
    estimates,
    failing_draws,
    fitting_scales,
    turn,
)

Responses = np.ndarray


def responses(rng: np.random.Generator, *shape: int) -> Responses:
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def chordal(p1: Responses, p2: Responses) -> np.ndarray:
    """√(1 − |1 + P2* P1|²/(1 + |P1|²)(1 + |P2|²)), outputs along the last axis."""
    inner = 1 + np.sum(p1 * p2.conj(), axis=-1)
    sizes = (1 + np.sum(np.abs(p1) ** 2, axis=-1)) * (1 + np.sum(np.abs(p2) ** 2, axis=-1))
    return np.sqrt(1 - np.abs(inner) ** 2 / sizes)


@given(st.integers(0, 10**9), st.integers(1, 3))
def test_at_scale_one_the_estimates_are_the_disturbed_models_distances(seed: int, outputs: int) -> None:
    rng = np.random.default_rng(seed)
    p1, p2 = responses(rng, 6, outputs), responses(rng, 6, outputs)
    m1, m2 = p1 + 0.2 * responses(rng, 4, 6, outputs), p2 + 0.2 * responses(rng, 4, 6, outputs)
    still = directions(np.array([p1, p2]))
    a, b, c = disturbed_pair(still[0], still[1], directions(m1), directions(m2))
    np.testing.assert_allclose(np.sqrt(a), chordal(p1, p2), rtol=1e-9)
    found = estimates(np.array([0]), a[None], b[None], c[None], 1.0)
    np.testing.assert_allclose(found, chordal(m1, m2).max(axis=1), rtol=1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_the_winding_condition_of_stable_models_on_a_grid(seed: int) -> None:
    """As the exact ν-gap decides it: equal to 1 or not."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(0, np.pi, 2000)
    z = np.exp(1j * angles)
    symbols, columns = [], []
    for _ in range(2):
        d = np.poly(rng.uniform(-0.9, 0.95, 2))
        n = rng.normal(0, 1.5, 2)
        symbols.append(GraphSymbol.of_polynomials(d, [n], 1.0))
        columns.append((np.polyval(n, z) / np.polyval(d, z))[:, None])
    still = directions(np.array(columns))
    expected = nu_gap_of(*symbols) == 1.0
    assert (abs(turn(still[0], still[1])) > 0.5 * np.pi) == expected
    moved = still[:, None].copy()
    a, _, c = disturbed_pair(still[0], still[1], moved[0], moved[1])
    pair = (still[0], still[1]), (moved[0], moved[1])
    assert failing_draws(a, c, *pair, np.array([expected])).tolist() == [expected]


def test_a_draw_that_takes_one_point_through_zero_fails_there() -> None:
    """Two lags of gain 2 are near each other at both points; a draw turns one of them round at the second."""
    z = np.exp(1j * np.linspace(0, np.pi, 400))
    lag = (0.2 / (z - 0.9))[:, None]
    near, far = np.concatenate([lag, lag]), np.concatenate([lag, -lag])
    still, other = directions(np.array([near, 1.1 * near]))
    moved = directions(np.array([near, near])), directions(np.array([1.1 * near, 1.1 * far]))
    a, _, c = disturbed_pair(still, other, *moved)
    assert failing_draws(a, c, (still, other), moved, np.zeros(2, dtype=bool)).tolist() == [False, True]
    # and where it had failed without the draws, that draw makes it whole
    across = directions(np.array([1.1 * far]))[0]
    a, _, c = disturbed_pair(still, across, *moved)
    failed = np.array([False, True])
    assert failing_draws(a, c, (still, across), moved, failed).tolist() == [False, True]


def test_scales_of_a_known_spread() -> None:
    """One frequency, |t·v + e| with v = 0.5 and real e: t·v = 0.5 − e at its own quantiles."""
    e = np.linspace(-0.2, 0.2, 1001)
    a, b, c = np.array([[0.25]]), (2 * 0.5 * e).reshape(1, 1, -1), (e**2).reshape(1, 1, -1)
    least, most = fitting_scales(np.array([0]), a, b, c, 0.05)
    assert 0.5 * least == pytest.approx(0.5 - 0.18, abs=2e-3)
    assert 0.5 * most == pytest.approx(0.5 + 0.18, abs=2e-3)


def test_what_noise_alone_explains_may_be_nothing() -> None:
    rng = np.random.default_rng(3)
    e = 0.1 * (rng.normal(size=(1, 400, 20)) + 1j * rng.normal(size=(1, 400, 20)))
    held = []
    for _ in range(60):
        v = 0.1 * (rng.normal(size=(1, 20)) + 1j * rng.normal(size=(1, 20)))  # estimated: noise again
        moved = np.swapaxes(e, 1, 2)
        a, b, c = np.abs(v) ** 2, 2 * (v.conj()[:, :, None] * moved).real, np.abs(moved) ** 2
        least, most = fitting_scales(np.array([0]), a, b, c, 0.05)
        held.append(least == 0.0)
        assert most < 3.0
    assert 0.85 <= np.mean(held) < 1.0
