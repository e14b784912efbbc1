"""Units in common notations: conversion between them, and the quantity that a unit measures.

An unknown unit (`PWM`, `steps`) counts as a plain number. To import pint and have it read its definitions
takes longer than to start a command, so its answers are kept for the commands to come.
"""

from __future__ import annotations

import importlib.metadata
import math
import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twinmatch.errors import TwinmatchError
from twinmatch.kept import KeptAnswers

if TYPE_CHECKING:
    import pint


_COLUMN_WORDS = {
    "C": "degC",
    "c": "degC",
    "°c": "degC",
    "F": "degF",
    "°f": "degF",
    "k": "K",
}
"""Abbreviations of temperature units that pint would read as coulomb or farad."""
_NAMES = {
    **dict.fromkeys(
        ("celsius", "deg c", "deg_c", "deg.c", "degc", "°c", "ºc", "℃"), "degC"
    ),
    **dict.fromkeys(("fahrenheit", "deg f", "deg_f", "degf", "°f", "℉"), "degF"),
    **dict.fromkeys(("kelvin", "degk", "°k"), "K"),
    **dict.fromkeys(("pct", "percent", "%rh", "% rh"), "%"),
    **dict.fromkeys(("lpm", "slpm", "nl/min", "lit/min"), "l/min"),
    **dict.fromkeys(
        ("rpm", "u/min", "r/min", "rev/min", "min-1", "min^-1", "min⁻¹"), "rpm"
    ),
    **dict.fromkeys(("barg", "bara", "bar(g)", "bar(a)"), "bar"),
    **dict.fromkeys(("", "-", "ph", "none"), "dimensionless"),
    **{
        "volt": "V",
        "volts": "V",
        "amp": "A",
        "amps": "A",
        "watt": "W",
        "watts": "W",
        "ppmv": "ppm",
    },
    **{"ohm": "Ω", "ohms": "Ω", "kohm": "kΩ", "n.m": "N m"},
}
"""Units as people write them, in small letters, and as pint reads them."""
_FORMS = (
    (re.compile(r"√\s*(\w+|\([^()]*\))"), r"(\1)**0.5"),
    # m2, s-2
    (re.compile(r"(?<![A-Za-zµ])([cdkmµu]?m|s|min)\^?(-?[234])(?!\d)"), r"\1**\2"),
    (re.compile(r"/\(?(kg|m²|m\*\*2)K\)?$"), r"/(\1 K)"),  # W/m²K
    (re.compile(r"(?<![A-Za-z])Nm(?![A-Za-z])"), "N m"),
)
"""Forms of compound units, likewise."""
_LONGEST = 100
"""Longest text that is read as a unit, characters."""
_LARGEST_POWER = 1000.0
"""Largest product of all exponents in a unit: pint computes powers of whole numbers digit by digit, so that
`m**9**9**9` would never end."""
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_POWER = re.compile(
    rf"(?:\*\*|\^)\s*(?:(?P<plain>{_NUMBER})(?![\d._])|\(\s*(?P<first>{_NUMBER})\s*(?:/\s*{_NUMBER}\s*)?\))?"
    r"(?P<again>\s*(?:\*\*|\^))?"
)
"""An exponent, a number or a fraction in parentheses; and whether it is raised to a power itself."""
_POWER_WORD = re.compile(r"\b(?:sq|square|squared|cubic|cubed)\b", re.IGNORECASE)
_RAISED = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")
_LOWERED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_QUANTITY = re.compile(
    r"(?P<number>[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>(?:[^\W\d_]|[°%℃℉])[^:]{0,20})"
)
"""A number, and what may be its unit."""
_FAR = 2.0**20
"""Value at which the slope of a conversion is computed: large, so that rounding of offsets is negligible."""
_TEMPERATURE = (("[temperature]", 1.0),)


class UnitError(TwinmatchError):
    """A unit that cannot be read, or two that measure different things."""


class Conversion(NamedTuple):
    """Conversion of a value to another unit: value · scale + offset."""

    scale: float = 1.0
    offset: float = 0.0


class Measure(NamedTuple):
    """The quantity that a unit measures."""

    dimension: tuple[tuple[str, float], ...] = ()
    """Powers of mass, length, time and so on, by name; empty: a plain number."""
    factor: float = 1.0
    """Size of the unit in base units."""
    known: bool = True
    """False for an unknown unit, which counts as a plain number."""
    offset: bool = False
    """Whether its zero differs from the quantity's (°C, °F)."""


class NumberWithUnit(NamedTuple):
    """A number with its unit."""

    number: float
    unit: str


@lru_cache(maxsize=4096)
def quantity_in(text: str) -> NumberWithUnit | None:
    """The number and the unit in a text such as `17.99 °C`, `0%` or `21,5 W`; None for any other text.

    A comma is a decimal one; with three digits behind it, it may separate thousands: then None.
    """
    match = _QUANTITY.fullmatch(text.strip())
    if match is None or re.search(r",\d{3}$", match["number"]):
        return None
    unit = match["unit"].strip()
    if not measure(unit).known:
        return None
    return NumberWithUnit(float(match["number"].replace(",", ".")), unit)


def is_readable(unit: str) -> bool:
    """Whether a text is short, and its powers small, as those of all units are: pint may read it."""
    return len(unit) <= _LONGEST and _power_of(_plain(unit)) <= _LARGEST_POWER


def is_unit(text: str) -> bool:
    """Whether a text is a known unit, or may be one that nobody can convert: a few capitals, such as PWM."""
    return measure(text).known or re.fullmatch(r"[A-Z]{2,5}", text) is not None


def _power_of(text: str) -> float:
    """The product of all exponents above 1; infinity for an exponent that is not a number."""
    text = text.replace(",", "")  # pint ignores commas, also within **
    text = _RAISED.sub(lambda raised: f"**{raised[0].translate(_LOWERED)}", text)
    product = 3.0 ** len(_POWER_WORD.findall(text))
    for power in _POWER.finditer(text):
        exponent = power["plain"] or power["first"]
        if exponent is None or power["again"]:
            return math.inf
        product *= max(abs(float(exponent)), 1.0)
    return product


@lru_cache(maxsize=256)
def measure(unit: str) -> Measure:
    """The quantity that a unit measures; `W/(m² K)`, `kg m^2`, `°C` and `%` are understood."""
    if not is_readable(unit):
        return Measure(known=False)
    plain = _plain(unit)
    kept = _kept_answers().get((plain,))
    if kept is not None:
        powers, factor, is_known, has_offset = kept
        dimension = tuple((name, power) for name, power in powers)
        return Measure(dimension, factor, is_known, has_offset)
    computed = _measured(plain)
    _kept_answers().keep((plain,), computed)
    return computed


def _measured(plain: str) -> Measure:
    """The quantity that a unit, as pint writes it, measures."""
    # Outside: an installation that lacks it knows no unit only for now.
    registry = _registry()
    try:
        parsed: Any = registry.parse_units(plain)
        base = registry.Quantity(1.0, parsed)
        powers = tuple(
            sorted((str(n), float(p)) for n, p in parsed.dimensionality.items())
        )
        offset = not base._is_multiplicative
        factor = 1.0 if offset else float(base.to_base_units().magnitude)
    except Exception:
        return Measure(known=False)
    return Measure(powers, factor, offset=offset)


def of_temperature(unit: str) -> str:
    """The unit that a temperature's column means: °C for `C`, which is a coulomb elsewhere; others as they are."""
    return _COLUMN_WORDS.get(unit.strip(), unit)


@lru_cache(maxsize=256)
def conversion(unit: str, wanted: str) -> Conversion:
    """Conversion from one unit to another.

    Raises:
        UnitError: they measure different things.
    """
    if _plain(unit) == _plain(wanted):
        return Conversion()
    if _TEMPERATURE in (measure(unit).dimension, measure(wanted).dimension):
        unit = of_temperature(unit)
        wanted = of_temperature(wanted)
    source = measure(unit)
    target = measure(wanted)
    if not (source.known and target.known) or source.dimension != target.dimension:
        raise UnitError(
            f"{unit or 'a plain number'} cannot be converted to {wanted or 'a plain number'}"
        )
    pair = (_plain(unit), _plain(wanted))
    kept = _kept_answers().get(pair)
    if kept is None:
        kept = _converted(*pair)
        _kept_answers().keep(pair, kept)
    return Conversion(*kept)


def _converted(plain: str, wanted: str) -> Conversion:
    """Conversion between two units of the same quantity, as pint writes them."""
    quantity = _registry().Quantity
    low, high = (_float(quantity(x, plain).to(wanted).magnitude) for x in (0.0, _FAR))
    return Conversion((high - low) / _FAR if low else high / _FAR, low)


def _float(magnitude: Any) -> float:
    return float(magnitude)


def _plain(unit: str) -> str:
    text = unit.strip().replace("·", " ")
    text = _NAMES.get(text.lower(), text)
    for form, written in _FORMS:
        text = form.sub(written, text)
    return text


@lru_cache(maxsize=1)
def _kept_answers() -> KeptAnswers:
    """What pint has answered to this module: to one unit its measure, to two the conversion."""
    version = importlib.metadata.version("pint")
    source = Path(__file__).read_text(encoding="utf-8")
    return KeptAnswers("units", f"{sys.version_info[:2]} {version} {source}")


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[Any]:
    import pint  # noqa: PLC0415

    return pint.UnitRegistry()
