"""Dimensional check of a plant's equations.

Every quantity has its declared unit; a rate must have the state's unit per second, the output its own unit,
an initial value the state's. A number in a sum takes the unit of the other terms (273.15), and a whole number
or simple fraction in a product is dimensionless (½, 2). Any other number in a product may have a hidden unit
(an area, 255 counts): such a product is not checked, with a note.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction
from typing import Any, NamedTuple

from twinmatch.adding.trial import Finding
from twinmatch.dynamics import Plant
from twinmatch.dynamics.equations import outputs_of, written_equations
from twinmatch.units import Measure, measure

_SAME = 1e-6
"""Relative difference of two factors that count as one."""


class _Unit(NamedTuple):
    """Unit of an expression."""

    powers: Mapping[str, Fraction]
    factor: float | None
    """In base units; None where a number may have changed it."""


_Known = _Unit | None
"""None: a number, or an expression with a number that may have a hidden unit."""


class Dimensions:
    """Checks the equations of one plant, one combination of parts at a time."""

    def __init__(self, plant: type[Plant]) -> None:
        """Look up every declared unit."""
        self.findings: dict[str, Finding] = {}
        """By text, so that findings shared by several structures appear once."""
        self.unchecked: set[str] = set()
        """Numbers that may have a hidden unit."""
        self._plant = plant
        self._symbols = {
            getattr(plant(), name): d for name, d in plant.declarations.items()
        }
        self._units = {s: measure(d.unit) for s, d in self._symbols.items()}

    @property
    def unknown_units(self) -> list[str]:
        """Declared units that are not known."""
        return sorted(
            {self._symbols[s].unit for s, unit in self._units.items() if not unit.known}
        )

    def check(self, parts: frozenset[str]) -> None:
        """Check the equations with these parts."""
        import sympy  # noqa: PLC0415

        written = written_equations(self._plant(), parts)
        second = measure("s")
        for state, rate in written.rates.items():
            place = f"the rate of {state}"
            expected = _times(
                _unit_of(self._units[state]), _unit_of(second), Fraction(-1)
            )
            unit = self._symbols[state].unit or "1"
            self._compare(place, sympy.sympify(rate), expected, f"{unit} per second")
        outputs = outputs_of(self._plant(), written)
        for place, symbol, expression in (
            *(
                (f"the output {y}" if len(outputs) > 1 else "the output", y, e)
                for y, e in outputs.items()
            ),
            *(
                (f"the start of {state}", state, start)
                for state, start in written.start.items()
            ),
        ):
            shown = sympy.sympify(expression)
            unit = self._symbols[symbol].unit or "a number"
            self._compare(place, shown, _unit_of(self._units[symbol]), unit)
            self._zeros(
                place, [(symbol, -1), *_terms(shown)], numbers=_has_number(shown)
            )

    def _compare(self, place: str, expression: Any, wanted: _Unit, words: str) -> None:
        unit = self._unit(place, expression)
        if unit is None or not expression.free_symbols:
            return
        if not _alike(unit, wanted):
            problem = f"{place}: has the unit {_words(unit)}, but needs {words}"
            todo = "look for a missing or duplicate factor, and for a wrong unit in a declaration"
            self._add(problem, todo)
        elif ratio := _ratio(unit, wanted):
            problem = f"{place}: has {ratio:g} times the unit {words}"
            self._add(
                problem,
                "declare units of one scale (s, not min; W, not kW), or multiply",
            )

    def _add(self, problem: str, todo: str) -> None:
        self.findings.setdefault(problem, Finding(problem, todo))

    def _unit(self, place: str, expression: Any) -> _Known:  # noqa: PLR0911
        import sympy  # noqa: PLC0415

        if expression.is_Symbol:
            return (
                _unit_of(self._units[expression]) if expression in self._units else None
            )
        if expression.is_number:
            return None
        if isinstance(expression, sympy.Mul):
            return self._product(place, expression)
        if isinstance(expression, sympy.Pow):
            return self._power(place, expression)
        if isinstance(expression, sympy.Add | sympy.Max | sympy.Min):
            self._zeros(place, _terms(expression), numbers=_has_number(expression))
            return self._equal(place, expression.args)
        if isinstance(expression, sympy.Abs):
            return self._unit(place, expression.args[0])
        if isinstance(expression, sympy.Piecewise):
            return self._equal(place, [value for value, _ in expression.args])
        for argument in expression.args:
            unit = self._unit(place, argument)
            if unit is not None and unit.powers:
                problem = f"{place}: the argument of {_short(expression)} has the unit {_words(unit)}"
                self._add(
                    problem,
                    "divide by a quantity of that unit: the argument must be a plain number",
                )
        return _Unit({}, 1.0)

    def _product(self, place: str, expression: Any) -> _Known:
        total: _Known = _Unit({}, 1.0)
        for factor in expression.args:
            if factor.is_number:
                if not _plain(factor):
                    self.unchecked.add(f"{float(factor):.6g}")
                    total = None
                continue
            unit = self._unit(place, factor)
            total = (
                None
                if total is None or unit is None
                else _times(total, unit, Fraction(1))
            )
        return total

    def _power(self, place: str, expression: Any) -> _Known:
        base, exponent = expression.args
        base_unit = self._unit(place, base)
        if not exponent.is_number:
            for part in (base, exponent):
                unit = self._unit(place, part)
                if unit is not None and unit.powers:
                    self._add(
                        f"{place}: in {_short(expression)} base or exponent has the unit {_words(unit)}",
                        "make base and exponent plain numbers",
                    )
            return _Unit({}, 1.0)
        if base.is_Symbol and self._units[base].offset and exponent > 1:
            declared = self._symbols[base].unit
            problem = f"{place}: {_short(expression)} takes a power of {base}, which is in {declared}"
            self._add(
                problem,
                f"convert it to absolute temperature first: ({base} + 273.15) in kelvin",
            )
        if base_unit is None:
            return None
        power = Fraction(float(exponent)).limit_denominator(1000)
        return _times(
            _Unit({}, 1.0),
            base_unit,
            Fraction(str(exponent)) if exponent.is_Rational else power,
        )

    def _equal(self, place: str, parts: Any) -> _Known:
        with_units = [
            (part, unit)
            for part in parts
            if (unit := self._unit(place, part)) is not None
        ]
        for part, unit in with_units[1:]:
            first, first_unit = with_units[0]
            if not _alike(unit, first_unit):
                problem = (
                    f"{place}: {_short(part)} in {_words(unit)} is added to or compared with "
                    f"{_short(first)} in {_words(first_unit)}"
                )
                self._add(
                    problem,
                    "look for a missing factor in one of the two, and check their units",
                )
            elif ratio := _ratio(unit, first_unit):
                problem = f"{place}: {_short(part)} has {ratio:g} times the unit of {_short(first)}, in one sum"
                self._add(
                    problem,
                    "declare both in units of one scale, or multiply one of them",
                )
        return with_units[0][1] if with_units else None

    def _zeros(
        self, place: str, terms: list[tuple[Any, Any]], *, numbers: bool
    ) -> None:
        """Find temperatures with different zeros in one sum."""
        if numbers:
            return
        counted = {True: 0, False: 0}
        named: dict[bool, Any] = {}
        for symbol, sign in terms:
            unit = self._units.get(symbol)
            if unit is not None and unit.dimension == (("[temperature]", 1.0),):
                counted[unit.offset] += sign
                named[unit.offset] = symbol
        if counted[True] and counted[False]:
            shifted = named[True]
            absolute = named[False]
            units = (self._symbols[shifted].unit, self._symbols[absolute].unit)
            problem = f"{place}: {shifted} is in {units[0]} and {absolute} in {units[1]}, in one sum"
            self._add(problem, "convert them to one zero: °C + 273.15 is K")


def _unit_of(measured: Measure) -> _Unit:
    powers = {
        name: Fraction(power).limit_denominator(1000)
        for name, power in measured.dimension
    }
    return _Unit(powers, measured.factor)


def _times(unit: _Unit, second: _Unit, power: Fraction) -> _Unit:
    powers = dict(unit.powers)
    for name, value in second.powers.items():
        powers[name] = powers.get(name, Fraction(0)) + value * power
    factor = None
    if unit.factor is not None and second.factor is not None:
        with suppress(OverflowError):
            factor = unit.factor * second.factor ** float(power)
    return _Unit({n: p for n, p in powers.items() if p}, factor or None)


def _alike(first: _Unit, second: _Unit) -> bool:
    return dict(first.powers) == dict(second.powers)


def _ratio(first: _Unit, second: _Unit) -> float | None:
    """How much larger one unit is; None where they are equal, or a number may have changed them."""
    if (
        first.factor is None
        or second.factor is None
        or math.isclose(first.factor, second.factor, rel_tol=_SAME)
    ):
        return None
    return first.factor / second.factor


def _plain(number: Any) -> bool:
    """Whether a factor is dimensionless: a small whole number, a simple fraction, or an exact root of one."""
    if number.is_Pow and number.exp == Fraction(1, 2):
        return _plain(number.base)
    try:
        value = Fraction(float(number)).limit_denominator(12)
    except (TypeError, OverflowError):
        return False
    return abs(float(value) - float(number)) < 1e-12 and abs(value) <= 12


def _terms(expression: Any) -> list[tuple[Any, Any]]:
    """Symbols that are terms of a sum by themselves, with their signs."""
    coefficients = [
        term.as_coeff_Mul()
        for term in (expression.args if expression.is_Add else (expression,))
    ]
    return [
        (symbol, int(number))
        for number, symbol in coefficients
        if symbol.is_Symbol and abs(number) == 1
    ]


def _has_number(expression: Any) -> bool:
    alone = expression.is_Add and any(term.is_number for term in expression.args)
    return bool(alone or expression.is_number)


_BASE = {
    "[mass]": "kg", "[length]": "m", "[time]": "s", "[current]": "A", "[temperature]": "K",
    "[substance]": "mol", "[luminosity]": "cd",
}  # fmt: skip


def _words(unit: _Unit) -> str:
    """Name of a common unit, otherwise the unit in base units."""
    for name in (
        "W",
        "J",
        "V",
        "Ω",
        "N",
        "Pa",
        "W/K",
        "J/K",
        "K/s",
        "N m",
        "V/K",
        "W/m²",
        "m³/s",
        "C",
        "F",
    ):
        if _alike(_unit_of(measure(name)), unit):
            return name
    if not unit.powers:
        return "plain numbers"
    return " ".join(
        f"{_BASE.get(name, name)}{'' if power == 1 else f'^{power}'}"
        for name, power in unit.powers.items()
    )


def _short(expression: Any) -> str:
    text = str(expression)
    return text if len(text) <= 60 else f"{text[:57]}…"
