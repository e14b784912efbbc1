from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import DiscriminationError, GraphSymbol, graph_symbol, nu_gap_of
from twinmatch.comparing.polynomials import column_of, even_part, exact, multiply, to_half_plane

wholes = st.lists(st.integers(-50, 50), min_size=1, max_size=6)


@given(wholes, wholes, st.integers(-5, 5))
def test_products_and_mapped_polynomials_take_the_right_values(a: list[int], b: list[int], x: int) -> None:
    def at(p: list[int], point: float) -> float:
        return sum(c * point**k for k, c in enumerate(p))

    assert at(multiply(a, b), x) == at(a, x) * at(b, x)
    degree = len(a) - 1
    mapped = to_half_plane([a])[0]
    if x != 1:
        assert at(mapped, x) == pytest.approx(
            at(a, (1 + x) / (1 - x)) * (1 - x) ** degree, rel=1e-9, abs=1e-6
        )
    square = sum(abs(at(p, 1j * x)) ** 2 for p in (a, mapped))
    assert at(even_part([a, mapped]), x**2) == pytest.approx(square, rel=1e-12)


def test_floats_become_whole_numbers_exactly() -> None:
    column = exact([np.array([0.1, -0.75, 0.0]), np.array([3.0])])
    scale = column[1][0] // 3
    assert [c / scale for c in column[0]] == [0.1, -0.75, 0.0]
    assert column[1] == [3 * scale, 0, 0]


def test_the_spectral_factor_is_stable_and_has_the_right_size() -> None:
    g = graph_symbol(control.tf([1, 2], [1, -3, 2]))
    assert g.outputs == 1
    assert g.spectral_roots.shape == (2,)
    assert np.all(g.spectral_roots.real > 0)
    for w in (0.0, 0.7, 3.0):
        size = abs((1j * w) ** 2 - 3j * w + 2) ** 2 + abs(1j * w + 2) ** 2
        assert abs(np.prod(1j * w + g.spectral_roots)) ** 2 == pytest.approx(size, rel=1e-12)


def gap_of(
    pair1: list[tuple[list[float], list[float]]], pair2: list[tuple[list[float], list[float]]]
) -> float:
    return nu_gap_of(*(GraphSymbol.of_transfer_functions(p, 0.0) for p in (pair1, pair2)))


def poly(*roots: float) -> list[float]:
    return [float(c) for c in np.atleast_1d(np.poly(roots))]


@pytest.mark.parametrize("shared", [-1.0, 0.0, 1.3, 5.0])
def test_a_pole_both_outputs_share_counts_once(shared: float) -> None:
    """y with the poles p, a and u with p, b: the product of the denominators has p twice."""
    y1, u1 = ([1.0], poly(shared, -2.0)), ([3.0, 1.0], poly(shared, -5.0))
    y2, u2 = ([1.1], poly(shared, -2.0)), ([3.0, 1.2], poly(shared, -5.0))
    common = poly(shared, -2.0, -5.0)
    y1c, y2c = ([1.0, 5.0], common), ([1.1, 5.5], common)
    u1c, u2c = (poly(-1 / 3, -2.0), common), (poly(-0.4, -2.0), common)
    u1c, u2c = ([3 * c for c in u1c[0]], common), ([3 * c for c in u2c[0]], common)
    assert gap_of([y1, u1], [y2, u2]) == pytest.approx(gap_of([y1c, u1c], [y2c, u2c]), rel=1e-11)
    assert gap_of([y1, u1], [y2, u2]) < 0.3


@given(st.integers(0, 10**9), st.sampled_from([1.0, 1.001, 1.02, 1.3]))
def test_an_unstable_pole_shared_by_rounded_denominators_counts_once(seed: int, shared: float) -> None:
    """Each denominator is multiplied out on its own, so the pole is common only to within rounding."""
    rng = np.random.default_rng(seed)
    y, u = rng.uniform(0.3, 0.9, 2), rng.uniform(0.3, 0.9, 2)

    def pair(gain: float) -> tuple[GraphSymbol, GraphSymbol]:
        apart = [([gain], np.poly([shared, *y])), ([2.0], np.poly([shared, *u]))]
        whole = np.poly([shared, *y, *u])
        together = [(gain * np.poly(u), whole), (2.0 * np.poly(y), whole)]
        return tuple(GraphSymbol.of_transfer_functions(p, 1.0) for p in (apart, together))

    (apart1, together1), (apart2, together2) = pair(1.0), pair(1.1)
    # the coefficients of the two ways to write it differ by rounding, and slow poles amplify that
    assert nu_gap_of(apart1, apart2) == pytest.approx(nu_gap_of(together1, together2), rel=1e-8)
    assert nu_gap_of(apart1, apart2) < 0.2


def test_double_integrators_shared_by_both_outputs() -> None:
    def discrete(gains: tuple[float, float], common: bool) -> GraphSymbol:
        poles = (poly(1.0, 1.0, 0.7), poly(1.0, 1.0, 0.3))
        if not common:
            return GraphSymbol.of_transfer_functions(
                [([g], p) for g, p in zip(gains, poles, strict=True)], 1.0
            )
        numerators = [[gains[0], -0.3 * gains[0]], [gains[1], -0.7 * gains[1]]]
        return GraphSymbol.of_polynomials(poly(1.0, 1.0, 0.7, 0.3), numerators, 1.0)

    products = nu_gap_of(discrete((0.1, 0.2), False), discrete((0.12, 0.2), False))
    assert products == pytest.approx(
        nu_gap_of(discrete((0.1, 0.2), True), discrete((0.12, 0.2), True)), rel=1e-9
    )


@pytest.mark.parametrize("hidden", [(1.3,), (0.0,), (2.0, 0.1), (1.0, 1.0), (0.5, -1.0)])
def test_hidden_unstable_modes_are_cancelled(hidden: tuple[float, ...]) -> None:
    plain, other = ([1.0], [1.0, 2.0]), ([1.1], [1.0, 2.1])
    clouded = (poly(*hidden), [float(c) for c in np.polymul(poly(*hidden), [1.0, 2.0])])
    assert gap_of([clouded], [other]) == pytest.approx(gap_of([plain], [other]), rel=1e-9)


def test_a_mere_zero_has_no_poles() -> None:
    assert gap_of([([0.0], [1.0, -2.0])], [([1.0], [1.0, 1.0])]) == pytest.approx(np.sqrt(0.5), rel=1e-14)


def test_powers_of_the_delay_are_padded_at_the_end() -> None:
    delayed = GraphSymbol.of_fractions([([0.0, 0.0, 0.3], [1.0, -0.7])], 1.0)
    forward = GraphSymbol.of_polynomials([1.0, -0.7, 0.0], [[0.3]], 1.0)
    assert nu_gap_of(delayed, forward) == 0.0
    assert nu_gap_of(delayed, GraphSymbol.of_polynomials([1.0, -0.7], [[0.3]], 1.0)) > 0.1


@given(st.integers(0, 10**9), st.integers(0, 6))
def test_state_space_models_are_converted_exactly(seed: int, order: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = rng.integers(-9, 9, (order, order)) / 4, rng.integers(-9, 9, (order, 1)) / 2
    C, D = rng.integers(-9, 9, (2, order)) / 8, rng.integers(-9, 9, (2, 1)) / 1
    column = column_of(A, B, C, D)
    s = 1.75
    resolvent = s * np.eye(order) - A
    values = [sum(c * s**k for k, c in enumerate(p)) for p in column]
    determinant = np.linalg.det(resolvent) if order else 1.0
    if abs(determinant) > 1e-6:
        response = C @ np.linalg.solve(resolvent, B) + D
        assert values[0] != 0
        assert [v / values[0] for v in values[1:]] == pytest.approx(
            response[:, 0].tolist(), rel=1e-7, abs=1e-7
        )


def test_state_space_and_transfer_function_are_the_same_model() -> None:
    """Order 6, discrete, two outputs, with direct feed-through."""
    d = np.poly([0.999, 0.97, 0.9, 0.5, 0.3, -0.2])
    n = [np.poly([0.9, 0.8, 0.1, 0.0, 0.0]) * 0.01, np.poly([0.98, 0.5, 0.1, 0.2, 0.7, 0.1]) * 45]
    A = np.vstack([-d[1:], np.eye(5, 6)])
    B = np.eye(6, 1)
    C = np.vstack([n[0], n[1][1:] - n[1][0] * d[1:]])
    realised = graph_symbol(control.ss(A, B, C, [[0.0], [n[1][0]]], 1.0))
    # the products n·d round once
    assert nu_gap_of(realised, GraphSymbol.of_polynomials(d, n, 1.0)) < 1e-9
    assert graph_symbol(realised) is realised


def test_what_is_not_a_model_is_refused() -> None:
    with pytest.raises(DiscriminationError, match="a list cannot be compared"):
        graph_symbol([1, 2])
    with pytest.raises(DiscriminationError, match="it has 2 inputs"):
        graph_symbol(control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    with pytest.raises(DiscriminationError, match="use another unit of time"):
        GraphSymbol.of_polynomials([1.0, 1e-200], [[1e-200]], 0.0)
    with pytest.raises(DiscriminationError, match="it has no output"):
        GraphSymbol.of_polynomials([1.0], [], 0.0)
    with pytest.raises(DiscriminationError, match="denominator of output 1 is zero"):
        GraphSymbol.of_transfer_functions([([1.0], [1.0]), ([1.0], [0.0, 0.0])], 0.0)
    with pytest.raises(DiscriminationError, match="not all finite"):
        GraphSymbol.of_polynomials([1.0, np.nan], [[1.0]], 0.0)
    with pytest.raises(DiscriminationError, match=r"state-space matrix .* is not finite"):
        column_of(np.array([[np.inf]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))
    with pytest.raises(DiscriminationError, match=r"a polynomial has shape \(1, 2\)"):
        GraphSymbol.of_polynomials([[1.0, 2.0]], [[1.0]], 0.0)
