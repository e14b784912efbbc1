"""Starts around a model, and what they are for: minima that the usual starts miss."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from twinmatch.fitting import FittingError, Order, estimate, parse_order
from twinmatch.fitting.starts import Hops
from twinmatch.signals import FloatArray

DEGREES = st.integers(0, 5)


@given(DEGREES, DEGREES, DEGREES, st.integers(0, 2**31))
def test_hops_keep_the_degrees_and_stay_stable(nc: int, nd: int, nf: int, seed: int) -> None:
    order = Order(1, nc, nd, nf, 1)
    hops = Hops(order)
    assert hops.possible == (nc + nd + nf > 0)
    if not hops.possible:
        return
    rng = np.random.default_rng(seed)
    theta = np.concatenate([np.atleast_1d(np.poly(rng.uniform(-0.9, 0.9, n)))[1:] for n in (nc, nd, nf)])
    for _ in range(5):
        moved = hops.from_model(theta)
        assert moved.shape == theta.shape
        for part in np.split(moved, [nc, nc + nd]):
            roots = np.roots(np.append(1.0, part))
            # Roots stay inside; a cluster of them is known to no better than the root of rounding.
            assert np.all(np.abs(roots) < 1.0)


def test_one_hop_touches_one_polynomial_or_the_noise() -> None:
    theta = np.concatenate([np.poly(r)[1:] for r in ([0.5, 0.2], [0.9, 0.3], [0.8, 0.4])])
    hops = Hops(parse_order("22221"))
    for _ in range(50):
        moved = np.any(np.abs(hops.from_model(theta) - theta).reshape(3, 2) > 1e-12, axis=1)
        assert list(moved) in (
            [True, False, False],
            [False, True, False],
            [False, False, True],
            [True, True, False],
        )


def test_the_sequence_is_always_the_same() -> None:
    theta = np.concatenate([np.poly([0.5, 0.2])[1:]] * 3)
    first, second = (Hops(parse_order("22221")) for _ in range(2))
    for _ in range(20):
        assert first.from_model(theta).tobytes() == second.from_model(theta).tobytes()


def two_tones(seed: int) -> tuple[FloatArray, FloatArray]:
    """Noise with two narrow bands, of which a low order can follow one."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(75), 4)
    narrow = np.real(
        np.poly([*(0.98 * np.exp(s * 0.5j) for s in (1, -1)), *(0.96 * np.exp(s * 1.9j) for s in (1, -1))])
    )
    return u, lfilter([0.0, 0.5], [1.0, -0.8], u) + lfilter([1.0], narrow, 0.1 * rng.standard_normal(300))


def test_more_hops_are_never_worse_and_find_lower_minima() -> None:
    gained = 0
    for seed in range(6):
        losses = [estimate(*two_tones(seed), "33331", hops=hops).variance for hops in (0, 4, 16)]
        # Draws begin alike, so the longer search passes through the shorter one's minima.
        assert all(b <= a * (1.0 + 1e-5) for a, b in pairwise(losses))
        gained += losses[2] < 0.99 * losses[0]
    assert gained > 0


def test_hops_cannot_be_negative() -> None:
    with pytest.raises(FittingError, match="-1 starts requested; give 0 or more"):
        estimate(*two_tones(1), "22221", hops=-1)
