"""Units: against the definitions of the International System, and what people write in brackets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.units import UnitError, conversion, measure


@pytest.mark.parametrize(
    ("given_unit", "wanted", "value", "is_"),
    [
        ("K", "°C", 300.0, 26.85),
        ("degC", "°C", 20.0, 20.0),
        ("C", "°C", 20.0, 20.0),  # in brackets behind a temperature it is not a coulomb
        ("F", "°C", 212.0, 100.0),
        ("°C", "K", -273.15, 0.0),
        ("ns", "s", 1.5e9, 1.5),
        ("min", "s", 2.0, 120.0),
        ("", "%", 0.25, 25.0),
        ("mV", "V", 1.0, 1e-3),
        ("L/min", "m³/s", 60.0, 1e-3),
        ("PWM", "PWM", 17.0, 17.0),
    ],
)
def test_values_are_brought_to_another_unit(given_unit: str, wanted: str, value: float, is_: float) -> None:
    scale, offset = conversion(given_unit, wanted)
    assert scale * value + offset == pytest.approx(is_, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(("given_unit", "wanted"), [("V", "°C"), ("PWM", "V"), ("s", ""), ("W/K", "W")])
def test_what_measures_something_else_is_refused(given_unit: str, wanted: str) -> None:
    with pytest.raises(UnitError, match="cannot be converted"):
        conversion(given_unit, wanted)


@given(
    st.sampled_from([("K", "°C"), ("°F", "°C"), ("kW", "W"), ("h", "s"), ("%", "")]),
    st.floats(-1e4, 1e4),
)
def test_there_and_back_is_the_same(units: tuple[str, str], value: float) -> None:
    there, back = conversion(*units), conversion(units[1], units[0])
    again = (value * there.scale + there.offset) * back.scale + back.offset
    assert again == pytest.approx(value, rel=1e-9, abs=1e-6)


def test_what_a_unit_measures() -> None:
    assert measure("V A").dimension == measure("W").dimension == measure("J/s").dimension
    assert measure("kW").factor == pytest.approx(1000 * measure("W").factor)
    assert measure("°C").offset
    assert not measure("K").offset
    assert not measure("PWM").known
    assert not measure("(%").known
    assert measure("PWM").dimension == measure("%").dimension == measure("").dimension == ()
