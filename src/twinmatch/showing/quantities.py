"""Numbers, parameters and signals in readable form: rounded, with symbol, name and unit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from twinmatch.dynamics import Drive, Output, Parameter, Plant, State
from twinmatch.signals import KELVIN, OperatingPoint, one_of_each, point_values

_TAKE_PREFIXES: Final = frozenset(
    {"V", "A", "W", "J", "N", "Ω", "m", "s", "F", "H", "Pa", "Hz", "rad"}
)


class ParameterFormat(NamedTuple):
    """One parameter, or the initial value of a state, and how it is shown."""

    name: str
    symbol: str
    unit: str
    """Unit it is shown in."""
    words: str
    factor: float = 1.0
    """From its own unit to the one it is shown in."""
    offset: float = 0.0
    """Added after that."""
    decimals: int = 2

    @property
    def label(self) -> str:
        """Symbol and unit, as an axis label."""
        return (
            f"{self.symbol} / ({self.unit})"
            if "/" in self.unit
            else f"{self.symbol} / {self.unit}"
        )

    def shown(self, value: float) -> float:
        """Convert a value to the unit it is shown in."""
        return value * self.factor + self.offset

    def text(self, value: float) -> str:
        """The value in that unit, without the unit; a dash where it is not known."""
        return number(self.shown(value), self.decimals)

    def error_text(self, value: float) -> str:
        """A standard error, in the same unit with one more digit."""
        return number(value * self.factor, self.decimals + 1)


def parameter_format(plant: type[Plant], name: str) -> ParameterFormat:
    """A parameter of the plant, or the initial value of a state; other names are shown unchanged."""
    start = name in plant.states
    declared: Parameter | State | None = (
        plant.states.get(name) if start else plant.parameters.get(name)
    )
    if declared is None:
        return ParameterFormat(name, name, "–", name, decimals=4)
    symbol = declared.symbol or name
    prefix, factor = _prefix(declared.unit, declared.scale)
    # Where the output is in °C, absolute temperatures are shown in °C too; none is below zero kelvin.
    difference = isinstance(declared, Parameter) and (
        declared.relative or declared.bounds[0] < 0.0
    )
    celsius = (
        declared.unit == "K"
        and not difference
        and any(y.unit == "°C" for y in plant.outputs.values())
    )
    return ParameterFormat(
        name,
        f"{symbol}(0)" if start else symbol,
        "°C" if celsius else f"{prefix}{declared.unit}" or "1",
        f"{declared.text} at the start" if start else declared.text,
        factor,
        -KELVIN if celsius else 0.0,
        max(0, 2 - math.floor(math.log10(declared.scale * factor))),
    )


def in_order(plant: type[Plant], names: Iterable[str]) -> tuple[str, ...]:
    """The names in the plant's order: parameters, then states; then names the plant does not have."""
    wanted = dict.fromkeys(names)
    of_plant = [name for name in (*plant.parameters, *plant.states) if name in wanted]
    return (*of_plant, *(name for name in wanted if name not in of_plant))


def _prefix(unit: str, scale: float) -> tuple[str, float]:
    """A prefix that makes a small number readable, m or µ, with its factor; none if the unit takes none."""
    first = re.match(r"[A-Za-zΩ]+(?![A-Za-zΩ²³^0-9])", unit)
    if scale >= 0.1 or first is None or first.group() not in _TAKE_PREFIXES:
        return "", 1.0
    return ("m", 1e3) if scale >= 1e-3 else ("µ", 1e6)


def point_number(point: OperatingPoint, plant: type[Plant]) -> str:
    """An operating point with the decimals of the plant's outputs."""
    outputs = zip(point_values(point), plant.outputs.values(), strict=True)
    return ", ".join(number(value, output.decimals) for value, output in outputs)


def outputs_unit(plant: type[Plant]) -> str:
    """The unit of all outputs, or their units in turn."""
    units = [output.unit for output in plant.outputs.values()]
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def number(value: float | None, decimals: int = 2, *, plus: bool = False) -> str:
    """A number with a true minus sign; a dash for None or NaN, ∞ for infinity."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:{'+' if plus else ''}.{decimals}f}"
    if float(text) == 0:
        text = text.replace("-", "")
    return text.replace("-", "−")


def span_text(
    low: float, high: float, decimals: int = 3, separator: str = " to "
) -> str:
    """An interval; a dash where an end is not known."""
    both_known = not (math.isnan(low) or math.isnan(high))
    return (
        f"{number(low, decimals)}{separator}{number(high, decimals)}"
        if both_known
        else number(None)
    )


def percent(share: float, decimals: int = 1) -> str:
    """A share, 0 to 1, in percent without the sign."""
    return number(100 * share, decimals)


class ShownSignal(NamedTuple):
    """A signal as it is shown."""

    name: str
    """For example temperature; "control" for an input of which the plant file names only the unit."""
    unit: str
    """May be empty."""
    decimals: int
    """Decimal places of its values; an error has one more."""

    def __str__(self) -> str:
        """The name."""
        return self.name

    def text(self, *values: float, finer: int = 0) -> str:
        """One value, or a range of two, with the unit; `finer` more decimal places, as for an error."""
        shown = " to ".join(
            number(float(value), self.decimals + finer) for value in values
        )
        return f"{shown} {self.unit}".rstrip()

    @property
    def label(self) -> str:
        """Name and unit, as an axis label."""
        return with_unit(self.name, self.unit)


class ShownSignals(NamedTuple):
    """The output and the input of a single loop: of a plant with one, or of one of its `channels`."""

    output: ShownSignal
    input: ShownSignal


def signal_names(plant: type[Plant]) -> ShownSignals:
    """The output and the input of a single loop, as they are shown.

    Raises:
        SignalError: the plant has several; ask one of its `channels`.
    """
    return ShownSignals(
        one_of_each("output", shown_outputs(plant)),
        one_of_each("input", shown_inputs(plant)),
    )


def shown_outputs(plant: type[Plant]) -> list[ShownSignal]:
    """The outputs of a plant; several are called as the texts in the plant file say."""
    return [
        ShownSignal(name, y.unit, y.decimals)
        for name, y in zip(_called(plant.outputs), plant.outputs.values(), strict=True)
    ]


def shown_inputs(plant: type[Plant]) -> list[ShownSignal]:
    """The inputs of a plant; several are called as their texts say."""
    signals = []
    for name, u in zip(_called(plant.drives), plant.drives.values(), strict=True):
        is_unit = name.lower() == u.unit.lower()
        signals.append(ShownSignal("control" if is_unit else name, u.unit, u.decimals))
    return signals


def shown_signals(plant: type[Plant]) -> list[ShownSignal]:
    """The outputs of a plant, then its inputs."""
    return [*shown_outputs(plant), *shown_inputs(plant)]


def _called(declared: Mapping[str, Output] | Mapping[str, Drive]) -> list[str]:
    """What outputs or inputs are called: several by their texts, a single one by its name."""
    several = len(declared) > 1
    names = [
        (several and quantity.text) or quantity.name for quantity in declared.values()
    ]
    return [name.replace("_", " ") for name in names]


def with_unit(name: str, unit: str) -> str:
    """A name and its unit, as an axis label."""
    return f"{name} / {unit}" if unit else name
