"""Stability decided without rounding."""

from __future__ import annotations

from fractions import Fraction
from math import lcm

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing.polynomials import Polynomial, is_hurwitz, multiply

rationals = st.fractions(Fraction(-5), Fraction(5), max_denominator=1000)


def of_roots(real: list[Fraction], pairs: list[tuple[Fraction, Fraction]]) -> Polynomial:
    """The polynomial with these real roots and pairs a ± jb, in whole numbers, the constant first."""
    product: Polynomial = [1]
    for root in real:
        product = multiply(product, [-root.numerator, root.denominator])
    for a, b in pairs:
        factor = [a * a + b * b, -2 * a, Fraction(1)]
        scale = lcm(*(c.denominator for c in factor))
        product = multiply(product, [int(c * scale) for c in factor])
    return product


@given(st.lists(rationals, max_size=5), st.lists(st.tuples(rationals, rationals), max_size=4), st.booleans())
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
    ("polynomial", "stable"), [([7], True), ([-7], True), ([0, 1], False), ([1, 1, 0], False)]
)
def test_constants_roots_at_zero_and_at_infinity(polynomial: Polynomial, stable: bool) -> None:
    assert is_hurwitz(polynomial) == stable
