"""The ν-gap between models: published values, closed forms, and what a distance promises."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import combinations
from math import lcm

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from tests.support.servo import PERIOD, Servo
from twinmatch.comparing import (
    Candidate,
    DiscriminationError,
    GraphSymbol,
    LoopConditions,
    akaike_weights,
    chordal,
    identify,
    nu_gap,
    nu_gap_matrix,
    plant_gaps,
    score_orders,
    spans_of,
)
from twinmatch.comparing.chordal import cubic_top
from twinmatch.comparing.graph_symbol import graph_symbol
from twinmatch.comparing.plant_gap import ANGLES, response_slopes
from twinmatch.comparing.polynomials import Polynomial, is_hurwitz, multiply
from twinmatch.comparing.uncertainty import family_uncertainty
from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, FloatArray, Window

S = control.tf("s")

PUBLISHED = [
    (1 / (S - 0.001), 1 / (S + 0.001), 0.00199999, 1e-8),
    ((S + 2) / (S**2 + 5 * S + 10), (S + 1) / (S**2 + 3 * S + 10), 0.1390482, 1e-7),
    (100 / (S + 1), 100 / (S - 1), 0.019998, 1e-6),
    (100 / (S + 1), 100 / ((S + 1) * (0.025 * S + 1) ** 2), 0.88841, 1e-5),
    (0.1 / (S + 1), 0.1 / (S - 1), 1.0, 0),
    (1 / (S + 1), -1 / (S + 1), 1.0, 0),
]

seeds = st.integers(0, 10**9)
slopes = st.floats(-8.0, 8.0)


def chordal_distance(p1: object, p2: object, frequencies: FloatArray) -> FloatArray:
    """Chordal distance at frequencies in rad/s, from exact coefficients."""
    g1 = graph_symbol(p1)
    g2 = graph_symbol(p2)
    omega = np.asarray(frequencies, dtype=np.float64)
    minors = tuple(
        map(
            chordal.with_powers_of_j, chordal.minors(*g1.coefficients, *g2.coefficients)
        )
    )
    half = float(g1.period or 0.0) / 2
    with np.errstate(divide="ignore"):
        places = np.log(
            np.tan(np.minimum(omega * half, math.pi / 2)) if half else omega
        )
    return np.vectorize(
        lambda t: chordal.exact_distance(g1.signed, g2.signed, minors, t)
    )(places)


@pytest.mark.parametrize(("p1", "p2", "published", "digit"), PUBLISHED)
def test_gaps_are_those_that_were_published(
    p1: object, p2: object, published: float, digit: float
) -> None:
    assert nu_gap(p1, p2) == pytest.approx(published, abs=digit)
    assert nu_gap(control.ss(p1), control.ss(p2)) == pytest.approx(published, abs=digit)
    tustin = [control.sample_system(p, 0.5, method="bilinear") for p in (p1, p2)]
    assert nu_gap(*tustin) == pytest.approx(published, abs=digit + 1e-11)


def test_gaps_are_those_of_closed_forms() -> None:
    """First-order pairs whose maximum can be found by hand."""
    # static gains: |a − b| / √(1 + a²) √(1 + b²)
    assert nu_gap(control.tf([2], [1]), control.tf([3], [1])) == pytest.approx(
        1 / math.sqrt(50), rel=1e-15
    )
    # 1/s and a/s: at Ω² = a the distance is (a − 1)/(a + 1)
    assert nu_gap(1 / S, 1.1 / S) == pytest.approx(0.1 / 2.1, rel=1e-14)
    # 1/s and 1/s²: largest where Ω⁴ = 1: 1/√2
    assert nu_gap(1 / S, 1 / S**2) == pytest.approx(math.sqrt(0.5), rel=1e-14)
    # a lag against its own gain: antipodal nowhere, largest at infinity
    assert nu_gap(2 / (S + 1), control.tf([2], [1])) == pytest.approx(
        2 / math.sqrt(5), rel=1e-14
    )


@pytest.mark.parametrize("damping", [1e-3, 1e-6, 1e-9])
def test_a_resonance_of_vanishing_width_is_not_missed(damping: float) -> None:
    """A residue as small as the damping moves the gain at resonance by a half, however narrow it is."""
    resonant = [damping * p for p in (1.0, 1.0)]
    pole = np.array([1.0, 2 * damping, 1.0])
    g1 = GraphSymbol.of_polynomials([1.0, 1.0], [[1.0]], 0.0)
    g2 = GraphSymbol.of_polynomials(
        np.polymul([1.0, 1.0], pole), [np.polyadd(pole, resonant)], 0.0
    )
    assert nu_gap(g1, g2) == pytest.approx(0.27472, abs=3e-5)


def test_an_unstable_pole_that_nearly_cancels_fails_the_winding_condition() -> None:
    near = np.polymul([1.0, 2.0], [1.0, -1.3])
    p1 = GraphSymbol.of_polynomials(near, [[1.0, -1.3 + 1e-6]], 0.0)
    p2 = GraphSymbol.of_polynomials([1.0, 2.1], [[1.1]], 0.0)
    assert chordal_distance(p1, p2, np.logspace(-3, 3, 50)).max() < 0.03
    assert nu_gap(p1, p2) == 1.0


def closed_loop(rng: np.random.Generator, order: int) -> GraphSymbol:
    """Like a model from set-point to [temperature; control]: slow poles, gains 1 and some 45."""
    fractions = []
    for gain in (1.0, 45.0):
        poles = [1 - 10 ** rng.uniform(-3, -1.5)]
        while len(poles) < order:
            if order - len(poles) > 1 and rng.random() < 0.5:
                pole = rng.uniform(0.8, 0.99) * np.exp(1j * rng.uniform(0, 0.3))
                poles += [pole, pole.conjugate()]
            else:
                poles.append(rng.uniform(0.2, 0.99))
        f = np.poly(poles).real
        b = np.poly(rng.uniform(0, 0.995, order - 1)).real
        b *= (f.sum() if gain == 1 else gain * rng.uniform(0.5, 1)) / (
            b.sum() if gain == 1 else 1
        )
        fractions.append((np.concatenate([[0.0], b]), f))
    return GraphSymbol.of_fractions(fractions, 1.0)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_the_gap_of_closed_loop_models_bounds_a_dense_grid(order: int) -> None:
    """The gap bounds every sample; where it is not a winding failure, a dense grid comes close to it."""
    rng = np.random.default_rng(order)
    grid = np.concatenate([[0], np.logspace(-6, math.log10(math.pi), 4000), [math.pi]])
    reached = 0
    for g1, g2 in combinations([closed_loop(rng, order) for _ in range(5)], 2):
        gap = nu_gap(g1, g2)
        top = float(chordal_distance(g1, g2, grid).max())
        assert gap >= top * (1 - 1e-14)
        reached += gap == pytest.approx(top, rel=1e-5)
        assert gap == pytest.approx(top, rel=1e-5) or gap == 1.0
    assert reached >= 3


def model(
    rng: np.random.Generator, outputs: int = 2, order: int = 3, period: float = 0.0
) -> GraphSymbol:
    """Poles anywhere, some unstable."""
    fractions = []
    for _ in range(outputs):
        roots = (
            rng.normal(-0.5, 1.0, order)
            if period == 0
            else rng.uniform(-1.1, 1.1, order)
        )
        fractions.append((rng.normal(size=order), np.poly(roots)))
    return GraphSymbol.of_transfer_functions(fractions, period)


@given(seeds, st.integers(1, 3), st.integers(1, 4), st.sampled_from([0.0, 1.0]))
def test_the_gap_is_a_distance(
    seed: int, outputs: int, order: int, period: float
) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (model(rng, outputs, order, period) for _ in range(3))
    ab = nu_gap(a, b)
    bc = nu_gap(b, c)
    ac = nu_gap(a, c)
    assert all(0 <= gap <= 1 for gap in (ab, bc, ac))
    assert nu_gap(b, a) == pytest.approx(ab, rel=1e-12)
    assert nu_gap(a, a) == 0.0
    assert ac <= ab + bc + 1e-12


@given(seeds, st.sampled_from([0.0, 0.5]))
def test_it_bounds_the_chordal_distance_at_every_frequency(
    seed: int, period: float
) -> None:
    rng = np.random.default_rng(seed)
    a = model(rng, period=period)
    b = model(rng, period=period)
    frequencies = (
        np.exp(rng.normal(0, 3, 20))
        if period == 0
        else rng.uniform(0, math.pi / period, 20)
    )
    assert np.all(chordal_distance(a, b, frequencies) <= nu_gap(a, b) + 1e-14)


@given(seeds, st.integers(1, 3), st.floats(0.1, 10))
def test_it_does_not_change_under_the_bilinear_map(
    seed: int, order: int, rate: float
) -> None:
    rng = np.random.default_rng(seed)
    continuous = []
    discrete = []
    for _ in range(2):
        polynomials = [
            np.poly(rng.normal(-0.5, 1.0, order)),
            rng.normal(size=order + 1),
        ]
        continuous.append(
            GraphSymbol.of_polynomials(polynomials[0], polynomials[1:], 0.0)
        )
        mapped = []
        for p in polynomials:  # s = rate·(z − 1)/(z + 1)
            terms = [
                c * rate ** (order - k) * np.poly([1.0] * (order - k) + [-1.0] * k)
                for k, c in enumerate(p)
            ]
            mapped.append(np.sum(terms, axis=0))
        discrete.append(GraphSymbol.of_polynomials(mapped[0], mapped[1:], 1.0))
    # the map itself rounds the coefficients; what that does depends on how ill-placed they are
    assert nu_gap(*discrete) == pytest.approx(nu_gap(*continuous), rel=1e-7)


@given(seeds)
def test_small_gain_changes_are_small_gaps(seed: int) -> None:
    """P and (1 + ε)P are ε|P|/(1 + |P|²) apart, at most ε/2, to first order in ε."""
    rng = np.random.default_rng(seed)
    d = np.poly(rng.normal(-0.5, 1.0, 3))
    n = rng.normal(size=3)
    g1 = GraphSymbol.of_polynomials(d, [n], 0.0)
    g2 = GraphSymbol.of_polynomials(d, [n * (1 + 2.0**-27)], 0.0)
    frequencies = np.logspace(-4, 4, 4000)
    size = np.abs(np.polyval(n, 1j * frequencies) / np.polyval(d, 1j * frequencies))
    assert nu_gap(g1, g2) <= 2.0**-28 * (1 + 1e-7)
    assert nu_gap(g1, g2) >= 2.0**-27 * np.max(size / (1 + size**2)) * (1 - 1e-7)


def test_the_matrix_of_all_pairs_is_symmetric_with_zeros_on_its_diagonal() -> None:
    systems = [1 / (S + k) for k in (1, 2, 3)]
    gaps = nu_gap_matrix(systems)
    assert gaps.shape == (3, 3)
    assert np.array_equal(gaps, gaps.T)
    assert np.all(np.diag(gaps) == 0)
    assert gaps[0, 2] == nu_gap(systems[2], systems[0])
    assert nu_gap_matrix([]).shape == (0, 0)


def test_the_chordal_distance_is_that_of_its_formula() -> None:
    p1 = 1 / S
    p2 = 1.1 / S
    w = np.array([[0.0, 1.0], [2.0, 1e9]])
    expected = 0.1 * w / np.sqrt((1 + w**2) * (1.21 + w**2))
    assert np.allclose(chordal_distance(p1, p2, w), expected, rtol=1e-14, atol=0)
    z = control.tf([1, 0], [1], 0.1)
    d = chordal_distance(0.5 / (z - 0.5), 0.25 / (z - 0.5), [0.0, math.pi / 0.1])
    assert d == pytest.approx(
        [0.5 / math.sqrt(2 * 1.25), (1 / 6) / math.sqrt((1 + 1 / 9) * (1 + 1 / 36))]
    )


def test_models_of_different_kinds_are_refused() -> None:
    z = control.tf([1, 0], [1], 0.1)
    with pytest.raises(DiscriminationError, match=r"period 0\.0, the other 0\.1"):
        nu_gap(1 / (S + 1), 1 / (z - 0.5))
    with pytest.raises(DiscriminationError, match=r"period 0\.1, the other 0\.2"):
        nu_gap(1 / (z - 0.5), control.tf([1], [1, -0.5], dt=0.2))
    with pytest.raises(
        DiscriminationError, match="one model has 1 outputs, the other 2"
    ):
        nu_gap(1 / (S + 1), control.tf([[[1]], [[1]]], [[[1, 1]], [[1, 2]]]))


def test_open_time_bases_agree_with_any_that_fits() -> None:
    sampled = control.tf([1], [1, -0.5], dt=0.1)
    unspecified = control.tf([1], [1, -0.5], dt=True)
    assert nu_gap(sampled, unspecified) == 0.0
    assert nu_gap(unspecified, sampled) == 0.0
    with pytest.raises(DiscriminationError, match=r"period True, the other 0\.0"):
        nu_gap(unspecified, 1 / (S + 1))
    gain = control.tf([2], [1], dt=None)
    assert nu_gap(gain, control.tf([2], [1], dt=0.1)) == 0.0
    assert nu_gap(1 / (S + 1), gain) == nu_gap(1 / (S + 1), control.tf([2], [1]))
    assert graph_symbol(control.tf([1], [1, 1], dt=None)).period == 0.0


# Stability decided without rounding.

rationals = st.fractions(Fraction(-5), Fraction(5), max_denominator=1000)


def of_roots(
    real: list[Fraction], pairs: list[tuple[Fraction, Fraction]]
) -> Polynomial:
    """The polynomial with these real roots and pairs a ± jb, in whole numbers, the constant first."""
    product: Polynomial = [1]
    for root in real:
        product = multiply(product, [-root.numerator, root.denominator])
    for a, b in pairs:
        factor = [a * a + b * b, -2 * a, Fraction(1)]
        scale = lcm(*(c.denominator for c in factor))
        product = multiply(product, [int(c * scale) for c in factor])
    return product


@given(
    st.lists(rationals, max_size=5),
    st.lists(st.tuples(rationals, rationals), max_size=4),
    st.booleans(),
)
def test_it_agrees_with_the_roots(
    real: list[Fraction], pairs: list[tuple[Fraction, Fraction]], negative: bool
) -> None:
    polynomial = of_roots(real, pairs)
    stable = all(r < 0 for r in real) and all(a < 0 for a, _ in pairs)
    assert is_hurwitz([-c for c in polynomial] if negative else polynomial) == stable


def test_a_root_that_no_float_separates_from_the_axis_is_reported() -> None:
    tiny = Fraction(1, 10**40)
    assert is_hurwitz(of_roots([Fraction(-1)], [(-tiny, Fraction(3))]))
    assert not is_hurwitz(of_roots([Fraction(-1)], [(tiny, Fraction(3))]))
    assert not is_hurwitz(of_roots([Fraction(-1)], [(Fraction(0), Fraction(3))]))


@pytest.mark.parametrize(
    ("polynomial", "stable"),
    [([7], True), ([-7], True), ([0, 1], False), ([1, 1, 0], False)],
)
def test_constants_are_stable_and_roots_at_zero_or_infinity_are_not(
    polynomial: Polynomial, stable: bool
) -> None:
    assert is_hurwitz(polynomial) == stable


# Twins of an integrating plant: their responses at frequency zero are infinite.

TERMS = LoopConditions(None, spans_of(Servo), 240, PERIOD)
POINTS = (0.0, 90.0)


def test_responses_are_those_of_an_integrator() -> None:
    """By formula: k/(s (1 + t s)) with a hold, at frequencies at which the hold does not matter."""
    servo = Servo.model("free").parameters(k=50.0, t=0.12)
    response, slopes = response_slopes(servo, ("k", "t"), 0.0, TERMS)
    assert np.isfinite(response).all()
    assert np.isfinite(slopes).all()
    s = 1j * ANGLES[1:3] / PERIOD
    expected = TERMS.scales.ratio * 50.0 / (s * (1.0 + 0.12 * s))
    np.testing.assert_allclose(response[1:3], expected, rtol=0.01)
    np.testing.assert_allclose(slopes[0], response / 50.0, rtol=1e-6)


def test_a_family_of_integrators_has_distances_with_intervals() -> None:
    """Twins with the same integrator differ at higher frequencies only."""
    quick = Servo.model("free").parameters(k=50.0, t=0.12)
    slow = quick.replace(t=0.2)
    covariance = np.diag([0.1, 1e-3]) ** 2
    twins = [
        Candidate("", 0.0, servo, None, ("k", "t"), covariance)
        for servo in (quick, slow)
    ]
    gaps = plant_gaps([quick, slow], POINTS, TERMS)
    uncertainty = family_uncertainty(twins, gaps, TERMS, seed=1)
    low = uncertainty.nu_gap_low[0, 1]
    high = uncertainty.nu_gap_high[0, 1]
    assert 0.0 < low < gaps.matrix[0, 1] < high < 1.0


def test_weights_are_those_that_were_published() -> None:
    """Printed on the reference page of `ic_weights` in the R package tidySEM."""
    akaike = akaike_weights([100, 200, 102, 300])
    expected = [7.310586e-01, 1.410029e-22, 2.689414e-01, 2.719593e-44]
    np.testing.assert_allclose(akaike.weights, expected, rtol=5e-7)
    np.testing.assert_array_equal(akaike.differences, [0, 100, 2, 200])


def test_a_difference_of_two_ln_k_makes_k_to_one() -> None:
    """A difference of 2 ln k makes k to 1."""
    assert akaike_weights([0.0, 2 * math.log(3)]).weights == pytest.approx([0.75, 0.25])
    assert akaike_weights([7.0]).weights == pytest.approx([1.0])


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=8), st.floats(-1e3, 1e3))
def test_weights_are_shares_that_only_differences_decide(
    values: list[float], shift: float
) -> None:
    akaike = akaike_weights(values)
    assert akaike.weights.sum() == pytest.approx(1.0)
    assert akaike.differences.min() == 0.0
    assert akaike.weights[np.argmin(values)] == akaike.weights.max()
    np.testing.assert_allclose(
        akaike_weights(np.array(values) + shift).weights, akaike.weights, atol=1e-9
    )


def test_a_perfect_prediction_takes_all() -> None:
    assert akaike_weights([-math.inf, 3.0]).weights.tolist() == [1.0, 0.0]
    assert akaike_weights([-math.inf, 3.0, -math.inf]).weights.tolist() == [
        0.5,
        0.0,
        0.5,
    ]


@pytest.mark.parametrize("values", [[], [math.nan], [1.0, math.inf], [[1.0]]])
def test_what_is_not_a_criterion_is_refused(values: list[float]) -> None:
    with pytest.raises(DiscriminationError, match="give one number per model"):
        akaike_weights(values)


def test_orders_are_weighed_by_the_aic_of_both_outputs() -> None:
    reference = np.repeat([30.0, 50.0, 70.0], [60, 120, 150])
    rig = Peltier.model().parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
    sensor = Peltier.sensor.realise(len(reference), 1.0, 3)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 30.0), sensor=sensor)
    window = Window(reference, run.output, run.input)
    models = identify(window)
    scores = score_orders(models, window, absolute=KELVIN)
    totals = []
    for model, s in zip(models, scores, strict=True):
        # AIC from nAIC: both differ by a constant that no order changes
        assert s.y.naic + s.u.naic == s.total.naic
        totals.append(len(window) * s.total.naic)
        assert model.order == s.order
    best = min(totals)
    assert [s.aic_difference for s in scores] == pytest.approx(
        [t - best for t in totals]
    )
    assert sum(s.weight for s in scores) == pytest.approx(1.0)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), slopes, slopes)
def test_the_top_of_a_cubic_between_two_places_is_its_largest_value(
    begin_value: float, end_value: float, begin_slope: float, end_slope: float
) -> None:
    """Against scipy's Hermite interpolation at a thousand places, a curvature of 100 beside which adds 1e-5."""
    cubic = CubicHermiteSpline(
        [0.0, 1.0], [begin_value, end_value], [begin_slope, end_slope]
    )
    largest = float(np.max(cubic(np.linspace(0.0, 1.0, 1001))))
    top = cubic_top(begin_value, end_value, begin_slope, end_slope)
    assert largest - 1e-12 <= top <= largest + 2e-5
