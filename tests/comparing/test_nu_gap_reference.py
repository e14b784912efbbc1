"""The ν-gap against brute force with 60 digits that shares nothing with it but the definition."""

from __future__ import annotations

from itertools import combinations

import mpmath as mp
import numpy as np
import pytest

from twinmatch.comparing import GraphSymbol, nu_gap

# mpmath 1.4 wants the order of coefficients named, 1.3 does not know the name
pytestmark = pytest.mark.filterwarnings("ignore:Descending:DeprecationWarning")

Fractions = list[tuple[np.ndarray, np.ndarray]]


def on_axis(t: object, discrete: bool) -> object:
    """t ∈ ℝ to the upper half of the unit circle or the positive imaginary axis."""
    s = mp.mpc(0, mp.exp(t))
    return (1 + s) / (1 - s) if discrete else s


def distance(p1: Fractions, p2: Fractions, t: object, discrete: bool) -> object:
    """√(1 − |1 + P2* P1|² / (1 + |P1|²)(1 + |P2|²)), to the letter."""
    x = on_axis(t, discrete)
    a = [mp.polyval(list(n), x) / mp.polyval(list(d), x) for n, d in p1]
    b = [mp.polyval(list(n), x) / mp.polyval(list(d), x) for n, d in p2]
    inner = 1 + sum(mp.conj(v) * w for v, w in zip(b, a, strict=True))
    sizes = (1 + sum(abs(v) ** 2 for v in a)) * (1 + sum(abs(v) ** 2 for v in b))
    return mp.sqrt(max(mp.mpf(0), 1 - abs(inner) ** 2 / sizes))


NODES = 0.06 * np.arange(-200, 201)
"""Of ln Ω: floats say near which of them it is worth to look."""


def in_floats(p1: Fractions, p2: Fractions, discrete: bool) -> np.ndarray:
    """The distance at the nodes, without taking a difference of nearly equal numbers."""
    s = 1j * np.exp(NODES)
    x = (1 + s) / (1 - s) if discrete else s
    a = np.array(
        [np.ones_like(x), *(np.polyval(n, x) / np.polyval(d, x) for n, d in p1)]
    )
    b = np.array(
        [np.ones_like(x), *(np.polyval(n, x) / np.polyval(d, x) for n, d in p2)]
    )
    minors = [a[j] * b[k] - a[k] * b[j] for j, k in combinations(range(len(a)), 2)]
    return np.sqrt(
        np.sum(np.abs(minors) ** 2, axis=0)
        / np.sum(abs(a) ** 2, axis=0)
        / np.sum(abs(b) ** 2, axis=0)
    )


def largest(p1: Fractions, p2: Fractions, discrete: bool) -> object:
    """Golden section around the three highest nodes; and both ends."""
    values = in_floats(p1, p2, discrete)
    best = max(distance(p1, p2, mp.mpf(end), discrete) for end in (-60, 60))
    golden = (mp.sqrt(5) - 1) / 2
    for k in sorted(range(1, len(NODES) - 1), key=lambda k: -values[k])[:3]:
        low = mp.mpf(NODES[k - 1])
        high = mp.mpf(NODES[k + 1])
        for _ in range(32):
            inner_low = high - golden * (high - low)
            inner_high = low + golden * (high - low)
            if distance(p1, p2, inner_low, discrete) > distance(
                p1, p2, inner_high, discrete
            ):
                high = inner_high
            else:
                low = inner_low
        best = max(best, distance(p1, p2, (low + high) / 2, discrete))
    return best


def product(a: list[object], b: list[object]) -> list[object]:
    out = [mp.mpf(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            out[i + j] += x * y
    return out


def exact(polynomial: np.ndarray) -> list[object]:
    """Its coefficients, which are floats, with 60 digits."""
    return [mp.mpf(float(c)) for c in polynomial]


def of_minus_s(polynomial: list[object]) -> list[object]:
    """The polynomial in −s: each odd power changes its sign."""
    degree = len(polynomial) - 1
    return [c * (-1) ** (degree - k) for k, c in enumerate(polynomial)]


def winds(p1: Fractions, p2: Fractions, discrete: bool) -> bool:
    """Roots of d2~ d1 + N2~ N1 on the stable side: as many as the order of the first model."""

    def column(p: Fractions) -> list[list[object]]:
        (n, d), *further = [(exact(n), exact(d)) for n, d in p]
        whole = [d, n]
        for n_more, d_more in further:
            if d_more == d:
                whole.append(n_more)
            else:
                whole = [*(product(e, d_more) for e in whole), product(n_more, d)]
        width = max(map(len, whole))
        return [[mp.mpf(0)] * (width - len(e)) + e for e in whole]

    g1 = column(p1)
    g2 = column(p2)
    mirrored = [e[::-1] if discrete else of_minus_s(e) for e in g2]
    terms = [product(a, b) for a, b in zip(g1, mirrored, strict=True)]
    roots = mp.polyroots(
        [mp.fsum(cs) for cs in zip(*terms, strict=True)], maxsteps=500, extraprec=400
    )
    stable = sum(bool(abs(r) < 1) if discrete else bool(mp.re(r) < 0) for r in roots)
    return stable != len(g1[0]) - 1


def random_model(
    rng: np.random.Generator, order: int, discrete: bool, outputs: int
) -> Fractions:
    """Damping down to 0.1, corner frequencies within two decades, a third of the models unstable."""

    def polynomial(degree: int, stable: bool) -> np.ndarray:
        roots: list[complex] = []
        while len(roots) < degree:
            size = 10 ** rng.uniform(-1.5, 0.5)
            damping = rng.uniform(0.1, 1)
            side = -1 if stable or rng.random() < 0.8 else 1
            if degree - len(roots) > 1:
                pair = size * (side * damping + 1j * np.sqrt(1 - damping**2))
                roots += [pair, pair.conjugate()]
            else:
                roots.append(size * side)
        s = np.array(roots)
        return np.atleast_1d(np.poly((1 + s) / (1 - s) if discrete else s)).real

    fractions = []
    d = polynomial(order, bool(rng.random() < 0.7))
    for _ in range(outputs):
        n = polynomial(order - 1, False)
        gain = 10 ** rng.uniform(-1, 1.5) * abs(np.polyval(d, 1j) / np.polyval(n, 1j))
        fractions.append((n * gain, d))
        if order <= 5:
            d = polynomial(order, True)
    return fractions


def nudged(rng: np.random.Generator, p: Fractions, size: float) -> Fractions:
    share_denominator = all(np.array_equal(d, p[0][1]) for _, d in p)
    shared = p[0][1] * (1 + size * rng.standard_normal(p[0][1].size))
    return [
        (
            n * (1 + size * rng.standard_normal(n.size)),
            shared
            if share_denominator
            else d * (1 + size * rng.standard_normal(d.size)),
        )
        for n, d in p
    ]


@pytest.mark.parametrize(
    ("order", "nudge", "discrete"),
    [
        (1, None, False), (1, 1e-8, True),
        (2, 1e-3, False), (2, None, True),
        (3, 1e-8, False), (3, 1e-3, True),
        (5, None, False), (5, 1e-8, True),
        (10, 1e-3, False), (10, 1e-8, True), (10, None, True),
    ],
)  # fmt: skip
def test_gaps_of_random_models_are_exact_to_twelve_digits(
    order: int, nudge: float | None, discrete: bool
) -> None:
    rng = np.random.default_rng(
        100 * order + 10 * discrete + (0 if nudge is None else -int(np.log10(nudge)))
    )
    outputs = 1 + order % 2
    p1 = random_model(rng, order, discrete, outputs)
    p2 = (
        random_model(rng, order, discrete, outputs)
        if nudge is None
        else nudged(rng, p1, nudge)
    )
    gap = nu_gap(
        *(
            GraphSymbol.of_transfer_functions(p, 1.0 if discrete else 0.0)
            for p in (p1, p2)
        )
    )
    with mp.workdps(60):
        expected = mp.mpf(1) if winds(p1, p2, discrete) else largest(p1, p2, discrete)
        assert abs(gap - expected) <= 1e-12 * expected


def test_the_winding_condition_is_decided_as_the_roots_decide_it() -> None:
    """First and second order, half of them unstable: both verdicts have to occur often."""
    rng = np.random.default_rng(11)
    failures = 0
    for _ in range(40):
        order = int(rng.integers(1, 3))
        p1, p2 = (
            [(rng.normal(size=order), np.poly(rng.normal(0, 1, order)))]
            for _ in range(2)
        )
        g1, g2 = (GraphSymbol.of_transfer_functions(p, 0.0) for p in (p1, p2))
        with mp.workdps(40):
            expected = winds(p1, p2, False)
        assert (nu_gap(g1, g2) == 1.0) == expected
        failures += expected
    assert 10 < failures < 30


def on_the_boundary(rng: np.random.Generator, discrete: bool, order: int) -> Fractions:
    """Two outputs with an integrator or an undamped pair each, exactly on the boundary, and damped poles."""
    fractions = []
    for k in range(2):
        if k == 0:
            edge = np.array([1.0, -1.0]) if discrete else np.array([1.0, 0.0])
        else:  # binary fractions: the circle is hit exactly
            edge = (
                np.array([1.0, -1.25, 1.0])
                if discrete
                else np.array([1.0, 0.0, 0.5625])
            )
        damped = np.atleast_1d(
            np.poly(rng.uniform(0.2, 0.9, order) - (0 if discrete else 1))
        )
        fractions.append(
            (rng.normal(size=edge.size + order - 1), np.polymul(edge, damped))
        )
    return fractions


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("nudge", [None, 1e-8])
@pytest.mark.parametrize("order", [1, 3])
def test_poles_on_the_boundary_cost_no_digit(
    order: int, nudge: float | None, discrete: bool
) -> None:
    rng = np.random.default_rng(1000 + order)
    p1 = on_the_boundary(rng, discrete, order)
    if nudge is None:
        p2 = on_the_boundary(rng, discrete, order)
    else:  # only the numerators: both keep their poles on the boundary
        p2 = [(n * (1 + nudge * rng.standard_normal(n.size)), d) for n, d in p1]
    gap = nu_gap(
        *(
            GraphSymbol.of_transfer_functions(p, 1.0 if discrete else 0.0)
            for p in (p1, p2)
        )
    )
    with mp.workdps(60):
        expected = mp.mpf(1) if winds(p1, p2, discrete) else largest(p1, p2, discrete)
        assert abs(gap - expected) <= 1e-12 * expected
    assert (gap < 1e-6) == (nudge is not None)


def balanced(
    rng: np.random.Generator, order: int, discrete: bool, outputs: int
) -> Fractions:
    """Small gain, one denominator, every root as likely unstable as stable."""
    s = rng.uniform(0.1, 2.0, order) * rng.choice([-1, 1], order) + 0j
    if order > 1:
        s[1] = s[0].conjugate() if rng.random() < 0.5 else s[1]
        s[:2] += 1j * rng.uniform(0, 2) * np.array([1, -1]) if s[0] == s[1] else 0
    d = np.atleast_1d(np.poly((1 + s) / (1 - s) if discrete else s)).real
    return [(0.05 * rng.normal(size=order + discrete), d) for _ in range(outputs)]


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("outputs", [1, 2])
def test_every_failing_of_the_winding_condition_is_found(
    outputs: int, discrete: bool
) -> None:
    """With small gains distances stay below 1 but near a pole, so that mostly the winding makes a 1."""
    rng = np.random.default_rng(7 * outputs + discrete)
    failures = 0
    for k in range(16):
        p1, p2 = (balanced(rng, 1 + k % 4, discrete, outputs) for _ in range(2))
        g1, g2 = (
            GraphSymbol.of_transfer_functions(p, 1.0 if discrete else 0.0)
            for p in (p1, p2)
        )
        with mp.workdps(30):
            expected = winds(p1, p2, discrete)
        assert (nu_gap(g1, g2) == 1.0) == expected
        failures += expected
    assert 4 <= failures <= 14
