"""Formulas of a map: what they compute, for one moment and for many, and what they refuse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sampling.channels import SamplingError, parse_channel
from twinmatch.sampling.formulas import Computing, MapFormula
from twinmatch.sampling.sources import parse_source
from twinmatch.sessions.files import RecordingError

FINITE = st.floats(-50.0, 50.0)


def at(text: str, **arguments: float) -> float:
    """A formula's value for single arguments."""
    series = {name: np.array([value]) for name, value in arguments.items()}
    return float(MapFormula(text).values(series, np.zeros(1))[0])


@pytest.mark.parametrize(
    ("text", "arguments", "value"),
    [
        ("v * 10**f", {"v": 80.0, "f": -1.0}, 8.0),
        ("u * m", {"u": 40.0, "m": -1.0}, -40.0),
        ("u * (a == 1)", {"u": 0.7, "a": 0.0}, 0.0),
        ("u if a == 1 else 0", {"u": 0.7, "a": 1.0}, 0.7),
        ("u if a > 0 and not b else -u", {"u": 3.0, "a": 1.0, "b": 1.0}, -3.0),
        ("max(a, b, 2) - min(a, b) + abs(-1)", {"a": 5.0, "b": 1.0}, 5.0),
        ("1 / a", {"a": 0.0}, math.nan),
        ("u * (a == 1)", {"u": 0.7, "a": math.nan}, math.nan),
        ("9**9**9 * a", {"a": 1.0}, math.nan),
    ],
)
def test_arithmetic_of_a_map(
    text: str, arguments: dict[str, float], value: float
) -> None:
    assert at(text, **arguments) == pytest.approx(value, nan_ok=True)


@given(st.lists(st.tuples(FINITE, FINITE), min_size=1, max_size=20))
def test_many_moments_are_computed_as_one_after_the_other(
    rows: list[tuple[float, float]],
) -> None:
    formula = MapFormula("rate(a) + (b if b > 0 else -b)")
    seconds = np.arange(len(rows), dtype=float)
    columns = {"a": np.array([a for a, _ in rows]), "b": np.array([b for _, b in rows])}
    computing = Computing(formula)
    singly = [
        computing.value({"a": a, "b": b}, float(k)) for k, (a, b) in enumerate(rows)
    ]
    np.testing.assert_array_equal(singly, formula.values(columns, seconds))


def test_a_rate_is_that_of_a_counter() -> None:
    values = MapFormula("rate(c) * 3600").values(
        {"c": np.array([10.0, 12.0, 12.0, 1.0, 2.0])},
        np.array([0.0, 3600.0, 7200.0, 10800.0, 12600.0]),
    )
    np.testing.assert_allclose(values, [math.nan, 2.0, 0.0, math.nan, 2.0])


def test_a_message_that_is_sent_again_at_once_has_the_rate_of_the_first() -> None:
    computing = Computing(MapFormula("rate(c)"))
    times = (0.0, 0.002, 10.0, 10.002, 20.0)
    rates = [
        computing.value({"c": count}, seconds)
        for count, seconds in zip((1, 1, 6, 6, 8), times, strict=True)
    ]
    np.testing.assert_allclose(rates, [math.nan, math.nan, 0.5, 0.5, 0.2])


@pytest.mark.parametrize(
    "text",
    [
        "", "a +", "__import__('os')", "a.b", "a[0]", "lambda: 1", "open('x')", "a if", "'text'", "f(a)",
        "abs(a, b)", "abs(x=1)", "(a := 1)", "[a]", "a < b < c", "True", "1j", "min()", "a // b", "a" * 400,
        "(" * 200 + ")" * 200, "rate(a, b)", "-" * 290 + "a", "{a}", "f'{a}'", "a is b", "*a", "max(*a)",
    ],
)  # fmt: skip
def test_what_is_not_arithmetic_is_refused_in_one_message(text: str) -> None:
    if text.startswith("-"):
        assert MapFormula(text).names == ("a",)  # deep, and harmless
        return
    with pytest.raises(SamplingError) as caught:
        MapFormula(text)
    assert "\n" not in str(caught.value)


def test_a_map_names_what_its_formula_computes_with() -> None:
    text = "v * 10**f; v=holding/40:uint16; f=holding/41; unit=°F; N/A=0"
    source = parse_source("here", text)
    assert (source.formula, source.names) == ("v * 10**f", ("v", "f"))
    assert source.separate == ("holding/40:uint16", "holding/41")
    assert source.words == {"n/a": 0.0}
    assert parse_source("here", source.text) == source
    channels = source.channels(
        "output", lambda place: parse_channel(f"/{place.partition(':')[0]}")
    )
    followed = source.follow("output", "°C", channels, ["", ""])
    assert followed.value([680.0, -1.0], 0.0) == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("v * f; v=a", "f in 'v * f' is not named; write '; f=PLACE' behind it"),
        ("v; v=a; f=b", "'v' has no f"),
        ("v * ; v=a", "is not a formula"),
    ],
)
def test_names_and_formula_belong_together(text: str, words: str) -> None:
    with pytest.raises(RecordingError) as caught:
        parse_source("here", text)
    assert words in str(caught.value)
