"""The stability margin: published values, two independent computations, and what Vinnicombe proved of it."""

from __future__ import annotations

import math
from typing import Any

import control
import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from twinmatch.comparing import (
    DiscriminationError,
    GraphSymbol,
    nu_gap,
    stability_margin,
)

# mpmath 1.4 wants the order of coefficients named, 1.3 does not know the name
pytestmark = pytest.mark.filterwarnings("ignore:Descending:DeprecationWarning")

S = control.tf("s")
seeds = st.integers(0, 10**9)

PUBLISHED = [
    # MathWorks, Robust Control Toolbox, page of ncfmargin: four digits
    (4 / (S - 0.001), control.tf([1], [1]), 0.7069),
    (4 / (S - 0.001), control.tf([10], [1]), 0.0995),
    ((S + 2) / (S**2 + 5 * S + 10), 4.4 / S, 0.1961),
]


@pytest.mark.parametrize(("plant", "controller", "published"), PUBLISHED)
def test_margins_are_those_that_were_published(
    plant: Any, controller: Any, published: float
) -> None:
    assert stability_margin(plant, controller) == pytest.approx(published, abs=5e-5)
    spaces = control.ss(plant), control.ss(controller)
    assert stability_margin(*spaces) == pytest.approx(
        stability_margin(plant, controller), rel=1e-9
    )


def test_margins_are_those_of_closed_forms() -> None:
    gain = control.tf([2], [1])
    # of gains: (1 + kc)/√(1 + k²)√(1 + c²)
    assert stability_margin(gain, control.tf([3], [1])) == pytest.approx(
        7 / math.sqrt(50), rel=1e-14
    )
    # 1/s under unit gain: the same at all frequencies; b of 1/s is never better than that
    assert stability_margin(1 / S, control.tf([1], [1])) == pytest.approx(
        math.sqrt(0.5), rel=1e-14
    )
    # 1/s under k: smallest at zero frequency or at infinity, k/√(1 + k²) or 1/√(1 + k²)
    assert stability_margin(1 / S, control.tf([3], [1])) == pytest.approx(
        1 / math.sqrt(10), rel=1e-14
    )
    assert stability_margin(1 / S, control.tf([0.2], [1])) == pytest.approx(
        0.2 / math.sqrt(1.04), rel=1e-14
    )
    assert stability_margin(gain, control.tf([0], [1])) == pytest.approx(
        1 / math.sqrt(5), rel=1e-14
    )


def test_a_loop_that_is_not_stable_has_none() -> None:
    assert stability_margin(1 / (S - 1), control.tf([0.5], [1])) == 0.0
    assert stability_margin(1 / (S - 1), control.tf([1], [1])) == 0.0  # a pole at zero
    assert stability_margin(1 / (S + 1), control.tf([-2], [1])) == 0.0
    # cancelling an unstable pole does not make a loop stable
    assert stability_margin((S - 1) / (S + 2), (S + 2) / (S - 1)) == 0.0
    # not well posed
    assert stability_margin(control.tf([-1], [1]), control.tf([1], [1])) == 0.0
    z = control.tf([1, 0], [1], 1.0)
    # a pole at −1
    assert stability_margin(1 / (z - 1), control.tf([2], [1], 1.0)) == 0.0
    assert stability_margin(1 / (z - 1), control.tf([1.999], [1], 1.0)) > 0.0


@pytest.mark.parametrize("room", [1e-3, 1e-6, 1e-9, 1e-12])
def test_small_margins_keep_their_digits(room: float) -> None:
    """1/(s − 1) under 1 + ε: at zero frequency ε/√2√(1 + (1 + ε)²)."""
    gain = 1 + room
    expected = (gain - 1) / math.sqrt(2) / math.sqrt(1 + gain**2)
    assert stability_margin(1 / (S - 1), control.tf([gain], [1])) == pytest.approx(
        expected, rel=1e-12
    )


def system(
    rng: np.random.Generator, order: int, outputs: int, discrete: bool
) -> list[Any]:
    """Fractions over one denominator, proper, a quarter of the roots unstable."""

    def polynomial(degree: int) -> np.ndarray:
        roots: list[complex] = []
        while len(roots) < degree:
            side = -1 if rng.random() < 0.75 else 1
            size = 10 ** rng.uniform(-1.5, 0.5)
            damping = rng.uniform(0.1, 1)
            if degree - len(roots) > 1:
                pair = size * (side * damping + 1j * np.sqrt(1 - damping**2))
                roots += [pair, pair.conjugate()]
            else:
                roots.append(side * size)
        s = np.array(roots)
        return np.atleast_1d(np.poly((1 + s) / (1 - s) if discrete else s)).real

    d = polynomial(order)
    degree = max(0, order - int(rng.integers(0, 2)))
    return [(polynomial(degree) * 10 ** rng.uniform(-1, 1), d) for _ in range(outputs)]


def symbol(fractions: list[Any], discrete: bool) -> GraphSymbol:
    return GraphSymbol.of_transfer_functions(fractions, 1.0 if discrete else 0.0)


def exact(polynomial: np.ndarray) -> list[Any]:
    """Its coefficients, which are floats, with 40 digits."""
    return [mp.mpf(float(c)) for c in polynomial]


def by_brute_force(plant: list[Any], controller: list[Any], discrete: bool) -> Any:
    """40 digits: roots for stability, ‖[P; 1](1 + CP)⁻¹[1 C]‖ sampled and refined for the margin."""
    common_p = plant[0][1]
    common_c = controller[0][1]
    terms = [product(exact(common_p), exact(common_c))]
    for (n, _), (m, _) in zip(plant, controller, strict=True):
        terms.append(product(exact(n), exact(m)))
    width = max(map(len, terms))
    of_one_length = [[mp.mpf(0)] * (width - len(t)) + t for t in terms]
    loop = [mp.fsum(coefficients) for coefficients in zip(*of_one_length, strict=True)]
    if loop[0] == 0:
        return mp.mpf(0)
    roots = mp.polyroots(loop, maxsteps=500, extraprec=400) if len(loop) > 1 else []
    if not all(abs(r) < 1 if discrete else mp.re(r) < 0 for r in roots):
        return mp.mpf(0)

    def margin(
        t: Any, exp: Any = mp.exp, polyval: Any = lambda p, x: mp.polyval(list(p), x)
    ) -> Any:
        s = 1j * exp(t)
        x = (1 + s) / (1 - s) if discrete else s
        p = [polyval(n, x) / polyval(d, x) for n, d in plant]
        c = [polyval(n, x) / polyval(d, x) for n, d in controller]
        sizes = (1 + sum(abs(v) ** 2 for v in p)) * (1 + sum(abs(v) ** 2 for v in c))
        return abs(1 + sum(v * w for v, w in zip(p, c, strict=True))) / sizes**0.5

    nodes = 0.06 * np.arange(-200, 201)
    values = margin(nodes, np.exp, np.polyval)  # floats say where to look
    best = min(margin(mp.mpf(-60)), margin(mp.mpf(60)))
    golden = (mp.sqrt(5) - 1) / 2
    for k in sorted(range(1, len(nodes) - 1), key=lambda k: values[k])[:3]:
        low = mp.mpf(nodes[k - 1])
        high = mp.mpf(nodes[k + 1])
        for _ in range(34):
            inner_low = high - golden * (high - low)
            inner_high = low + golden * (high - low)
            if margin(inner_low) < margin(inner_high):
                high = inner_high
            else:
                low = inner_low
        best = min(best, margin((low + high) / 2))
    return best


def product(a: list[Any], b: list[Any]) -> list[Any]:
    out = [mp.mpf(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            out[i + j] += x * y
    return out


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_margins_of_random_loops_are_exact_to_twelve_digits(
    order: int, discrete: bool
) -> None:
    rng = np.random.default_rng(10 * order + discrete)
    stable = unstable = 0
    while stable < 2 or unstable < 2:
        outputs = 1 + order % 2
        plant, controller = (
            system(rng, n, outputs, discrete) for n in (order, max(0, order - 1))
        )
        margin = stability_margin(symbol(plant, discrete), symbol(controller, discrete))
        if (margin > 0 and stable >= 2) or (margin == 0 and unstable >= 2):
            continue
        with mp.workdps(40):
            expected = by_brute_force(plant, controller, discrete)
            assert abs(margin - expected) <= 1e-12 * expected
        stable += margin > 0
        unstable += margin == 0


@pytest.mark.parametrize("seed", range(6))
def test_a_margin_is_the_inverse_of_the_closed_loops_norm(seed: int) -> None:
    """1/‖·‖∞ of the closed loop in state space, a bisection over Hamiltonian matrices."""
    rng = np.random.default_rng(seed)
    p = control.rss(3, 1, 1, strictly_proper=True)
    c = control.rss(2, 1, 1)
    for part in (p, c):
        for matrix in (part.A, part.B, part.C, part.D):
            matrix[:] = rng.normal(0, 1, matrix.shape)
        part.A -= 2.5 * np.eye(len(part.A))
    p.D[:] = 0
    a = np.block([[p.A, -p.B @ c.C], [c.B @ p.C, c.A]])
    a[: len(p.A), : len(p.A)] -= p.B @ c.D @ p.C
    b = np.block([[p.B, -p.B @ c.D], [np.zeros_like(c.B), c.B]])
    rows = np.block([[p.C, np.zeros_like(c.C)], [-c.D @ p.C, -c.C]])
    loop = control.ss(a, b, rows, np.array([[0.0, 0.0], [1.0, -c.D.item()]]))
    margin = stability_margin(p, c)
    if np.all(np.linalg.eigvals(a).real < 0):
        assert margin == pytest.approx(
            1 / control.system_norm(loop, "inf", tol=1e-10), rel=1e-8
        )
    else:
        assert margin == 0.0


def stabilised(
    seed: int, discrete: bool
) -> tuple[GraphSymbol, GraphSymbol, np.random.Generator]:
    rng = np.random.default_rng(seed)
    plant, controller = (symbol(system(rng, n, 1, discrete), discrete) for n in (3, 2))
    assume(stability_margin(plant, controller) > 0)
    return plant, controller, rng


@given(seeds, st.booleans())
def test_plant_and_controller_may_change_places(seed: int, discrete: bool) -> None:
    plant, controller, _ = stabilised(seed, discrete)
    margin = stability_margin(plant, controller)
    assert 0 < margin <= 1
    assert stability_margin(controller, plant) == pytest.approx(margin, rel=1e-12)


@given(seeds, st.booleans(), st.floats(1e-4, 1.0))
def test_the_controller_holds_for_every_plant_within_the_gap(
    seed: int, discrete: bool, size: float
) -> None:
    """arcsin b(P2, C) ≥ arcsin b(P1, C) − arcsin δν(P1, P2) (Vinnicombe 1993); so δν < b leaves it stable."""
    rng = np.random.default_rng(seed)
    fractions = system(rng, 3, 1, discrete)
    controller = symbol(system(rng, 2, 1, discrete), discrete)
    first = symbol(fractions, discrete)
    margin = stability_margin(first, controller)
    assume(margin > 0)
    second = symbol(
        [
            (
                n * (1 + size * rng.normal(size=n.size)),
                d * (1 + size * rng.normal(size=d.size)),
            )
            for n, d in fractions
        ],
        discrete,
    )
    gap = nu_gap(first, second)
    least = math.asin(margin) - math.asin(gap)
    assert math.asin(stability_margin(second, controller)) >= least - 1e-9
    if gap < margin:
        assert stability_margin(second, controller) > 0


def test_the_bound_is_tight() -> None:
    """1/s under 3 has the margin 1/√10 and is lost to 1/s − 1/3, which is just so far away."""
    margin = stability_margin(1 / S, control.tf([3], [1]))
    for near, holds in ((0.999, True), (1.001, False)):
        # 1/s and 1/s − g are farthest apart at infinity, where the loop is lost when 3g = 1
        g = near / 3
        neighbour = (1 - g * S) / S
        gap = nu_gap(
            *(
                GraphSymbol.of_polynomials([1.0, 0.0], n, 0.0)
                for n in ([[1.0]], [[-g, 1.0]])
            )
        )
        assert (gap < margin) == holds
        assert (stability_margin(neighbour, control.tf([3], [1])) > 0) == holds


def test_a_controller_of_two_inputs_has_the_margin_of_its_closed_form() -> None:
    """[1/s; 2] under [3 1]: K G = (3 + 3s)/s."""
    plant = control.tf([[[1.0]], [[2.0]]], [[[1.0, 0.0]], [[1.0]]])
    controller = control.tf([[[3.0], [1.0]]], [[[1.0], [1.0]]])
    # |3 + 3s|²/(11·(5|s|² + 1)): least at infinity
    expected = math.sqrt(9 / 55)
    assert stability_margin(plant, controller) == pytest.approx(expected, rel=1e-14)
    gains = control.ss([], [], [], [[3.0, 1.0]])
    assert stability_margin(plant, gains) == pytest.approx(expected, rel=1e-14)


def test_what_does_not_fit_is_refused() -> None:
    z = control.tf([1, 0], [1], 0.1)
    with pytest.raises(
        DiscriminationError, match="plant has 1 outputs, the controller 2 inputs"
    ):
        stability_margin(1 / (S + 1), control.tf([[[1], [1]]], [[[1], [1]]]))
    with pytest.raises(DiscriminationError, match=r"period 0\.0, the other 0\.1"):
        stability_margin(1 / (S + 1), 1 / (z - 0.5))
    with pytest.raises(DiscriminationError, match="it has 2 inputs"):
        stability_margin(control.tf([[[1], [1]]], [[[1], [1]]]), control.tf([1], [1]))
