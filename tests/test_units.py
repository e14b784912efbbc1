"""Units: which texts may be read as one."""

from __future__ import annotations

import pytest

from twinmatch.units import is_readable, is_unit, measure


@pytest.mark.parametrize(
    "endless",
    [
        "m**9**9**9**9",
        "m^9^9^9^9",
        "9 ** 9 ** 9 ** 9",
        "9⁹⁹⁹⁹⁹⁹⁹⁹⁹",
        "m**(9*9*9*9*9*9*9*9*9)",
        "9**(9**9**9)",
        "9*,*9*,*9*,*9",
        "9**-9**9**9",
        "9**9_9_9_9_9_9",
        "(((((9**20)**20)**20)**20)**20)",
        "9" + " squared" * 11,
        "sq " * 30 + "9",
        "m**k",
        "1" * 101,
    ],
)
def test_a_unit_that_would_take_for_ever_is_not_read(endless: str) -> None:
    assert not is_readable(endless)
    assert not measure(endless).known


@pytest.mark.parametrize(
    ("unit", "powers"),
    [
        ("W/(m² K)", {"[mass]": 1.0, "[time]": -3.0, "[temperature]": -1.0}),
        ("kg m^2 s^-3", {"[mass]": 1.0, "[length]": 2.0, "[time]": -3.0}),
        ("K^(1/2)", {"[temperature]": 0.5}),
        ("m**2 K**4", {"[length]": 2.0, "[temperature]": 4.0}),
        ("min⁻¹", {"[time]": -1.0}),
        ("square meter", {"[length]": 2.0}),
    ],
)
def test_units_as_people_write_them_are_read(
    unit: str, powers: dict[str, float]
) -> None:
    assert is_readable(unit)
    assert dict(measure(unit).dimension) == powers


@pytest.mark.parametrize(
    "unit", ["°C", "%", "rpm", "mS/cm", "PWM", "NTU", "", "W/(m² K)"]
)
def test_what_people_write_behind_a_name_is_a_unit(unit: str) -> None:
    assert is_unit(unit)


@pytest.mark.parametrize(
    "text", ["left", "inside", "raw value", "banana", "m**9**9**9", "Sensor"]
)
def test_a_remark_in_its_place_is_not(text: str) -> None:
    assert not is_unit(text)
