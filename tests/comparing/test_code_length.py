from __future__ import annotations

from collections.abc import Callable
from decimal import ROUND_HALF_EVEN, Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twinmatch.comparing import (
    DiscriminationError,
    code_length,
    information_gain,
    two_part_length,
)
from twinmatch.signals import KELVIN, Window

finite = st.floats(allow_nan=False, allow_infinity=False)
halves = st.builds(
    lambda n, d: n / 2 * 10.0**-d, st.integers(-(10**6), 10**6), st.integers(0, 6)
)
powers = st.builds(
    lambda k, s, e: s * 10.0**k + e,
    st.integers(-12, 22),
    st.sampled_from([1, -1]),
    halves,
)


def spelled_out(value: float, decimals: int) -> str:
    """The rule on paper: decimal arithmetic and plain text, sharing nothing with the product."""
    with_room = Decimal(value)
    rounded = with_room.quantize(
        Decimal(1).scaleb(-decimals), rounding=ROUND_HALF_EVEN, context=_roomy()
    )
    text = format(rounded.copy_abs(), "f")
    if "." in text:
        while text.endswith("0"):
            text = text[:-1]
        text = text.replace(".", "")
    while text.startswith("0") and len(text) > 1:
        text = text[1:]
    text = text or "0"
    return ("-" if rounded < 0 else "+") + text


def _roomy() -> object:
    from decimal import Context

    return Context(prec=1200)


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (10.34, 2, "+1034"),
        (-0.45, 2, "-45"),
        (0.0, 2, "+0"),
        (-0.0, 2, "+0"),
        (-0.004, 2, "+0"),
        (323.15, 2, "+32315"),
        (323.10, 2, "+3231"),
        (323.00, 2, "+323"),
        (320.00, 2, "+320"),
        (0.10, 2, "+1"),
        (0.01, 2, "+1"),
        # the float is a hair above 99.995: it rounds up and loses its decimals
        (99.995, 2, "+100"),
        # the float is below 1.115 although 1.115 · 100 computes to more than 111.5
        (1.115, 2, "+111"),
        (0.125, 2, "+12"),  # a true tie goes to the even digit
        (999.9999, 2, "+1000"),
        (1000.0, 0, "+1000"),
        (2.0**53 + 2, 3, "+9007199254740994"),
        (1e22, 2, "+1" + 22 * "0"),
        (-1e300, 15, "-" + str(int(1e300))),
        (5e-324, 15, "+0"),
        (0.1, 15, "+1"),
        (1 / 3, 15, "+" + 15 * "3"),
    ],
)
def test_a_number_is_written_by_the_rules(
    value: float, decimals: int, text: str
) -> None:
    assert spelled_out(value, decimals) == text
    assert code_length(value, decimals) == len(text)


@given(st.lists(st.one_of(finite, halves, powers), max_size=30), st.integers(0, 15))
def test_a_table_is_as_long_as_its_text(values: list[float], decimals: int) -> None:
    assert code_length(values, decimals) == sum(
        len(spelled_out(v, decimals)) for v in values
    )


@given(st.integers(0, 18), st.integers(0, 15), st.integers(-3, 3))
def test_powers_of_ten_count_every_digit(
    exponent: int, decimals: int, steps: int
) -> None:
    value = 10.0**exponent
    for _ in range(abs(steps)):
        value = float(np.nextafter(value, np.inf if steps > 0 else 0.0))
    assert code_length(value, decimals) == len(spelled_out(value, decimals))


def test_a_table_of_any_shape_is_a_sum_and_an_empty_one_costs_nothing() -> None:
    assert code_length([[10.34, -0.45], [0.0, 1.0]], 2) == 5 + 3 + 2 + 2
    assert code_length([], 2) == 0


def test_recorded_temperatures_cost_what_was_published(
    recorded_hour: Callable[[int], Window],
) -> None:
    for number in (1, 2, 5, 9, 14, 20):
        kelvin = recorded_hour(number).output + KELVIN
        assert 5.87 <= code_length(kelvin, 2) / kelvin.size <= 5.94


def test_gain_adds_programs_and_tables() -> None:
    ig = information_gain([323.15, 323.1, 300.0], [323.15, 323.05, 301.0], copied=1)
    assert ig.trivial_length == 15 + 6 + 5 + 4
    assert ig.model_length == 176 + 6 + 2 + 2  # the copied value, +5 (0.05), -1
    assert ig.gain == 30 - 186


def test_a_perfect_model_costs_two_characters_a_sample() -> None:
    measured = np.linspace(300.01, 350.02, 500)
    ig = information_gain(measured, measured)
    assert ig.model_length == 176 + 1000
    assert 0.6 < ig.explanation < 1


@given(
    arrays(np.float64, 12, elements=st.floats(-1e6, 1e6)),
    st.integers(0, 12),
    st.integers(0, 6),
)
def test_copied_samples_hide_what_the_model_says(
    y: np.ndarray, copied: int, decimals: int
) -> None:
    wild = y.copy()
    wild[:copied] = np.nan
    ig = information_gain(y, wild, decimals, copied)
    assert ig.trivial_length == 15 + code_length(y, decimals)
    assert ig.model_length == 176 + code_length(y[:copied], decimals) + 2 * (
        12 - copied
    )


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (lambda: code_length([1.0, np.nan], 2), "entry 1 of the table is nan"),
        (lambda: code_length([-np.inf], 2), "entry 0 of the table is -inf"),
        (lambda: code_length([1.0], -1), "-1 decimals; give 0 to 15"),
        (lambda: code_length([1.0], 16), "16 decimals; give 0 to 15"),
        (
            lambda: information_gain([1.0, 2.0, 3.0], [1.0, 2.0, np.nan], copied=1),
            r"at sample 2 the measured value is 3\.0 and .* nan",
        ),
        (
            lambda: information_gain([1, 2], [1, 2, 3]),
            r"shape \(2,\), the simulated one \(3,\)",
        ),
        (lambda: information_gain([], []), r"shape \(0,\)"),
        (lambda: information_gain([1, 2], [1, 2], copied=3), "3 of 2 samples copied"),
        (lambda: information_gain([1, 2], [1, 2], copied=-1), "-1 of 2 samples copied"),
        (lambda: two_part_length(100, -1, 10), "give at least 0 and 1"),
        (lambda: two_part_length(100, 3, 0), "give at least 0 and 1"),
    ],
)
def test_what_has_no_code_length_is_refused(
    asked: Callable[[], object], message: str
) -> None:
    with pytest.raises(DiscriminationError, match=message):
        asked()


def test_the_two_part_length_charges_sign_and_digits_of_every_parameter() -> None:
    """N = 10 000 determines two digits; with the sign three characters each."""
    assert two_part_length(500, 4, 10_000) == 500 + 4 * 3
    assert two_part_length(500, 0, 10_000) == 500
    assert two_part_length(500, 10, 1) == 510  # one sample says no more than the sign
    # ½ log₂ N bits per parameter (Rissanen 1978), a character holding log₂ 10 of them
    bits = 0.5 * np.log2(361.0) * 7
    assert two_part_length(0, 7, 361) - 7 == pytest.approx(bits / np.log2(10.0))
