"""Units: which texts may be read as one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twinmatch.units import is_readable, is_unit, measure

ASKING = """
import sys
from twinmatch.units import conversion, measure
print([measure(unit) for unit in ("W/(m² K)", "°C", "PWM", "%", "kg m^2 s^-3", "K^(1/2)")])
print([conversion(*pair) for pair in (("°F", "°C"), ("mbar", "Pa"), ("ms", "s"))])
print("pint" in sys.modules)
"""


def asked(cache: Path) -> list[str]:
    """What a new process answers, line by line; it keeps answers in this folder."""
    environment = {**os.environ, "TWINMATCH_CACHE": str(cache)}
    command = [sys.executable, "-c", ASKING]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout.splitlines()


def test_a_second_process_answers_alike_without_the_library(tmp_path: Path) -> None:
    *answers, first_imports = asked(tmp_path)
    *again, second_imports = asked(tmp_path)
    assert again == answers
    assert (first_imports, second_imports) == ("True", "False")


def test_answers_that_were_cut_off_or_cannot_be_kept_are_made_again(
    tmp_path: Path,
) -> None:
    *answers, _ = asked(tmp_path)
    [file] = tmp_path.glob("units-*.jsonl")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2] + b"\n\xff")
    assert asked(tmp_path) == [*answers, "True"]
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    assert asked(in_the_way) == [*answers, "True"]


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
