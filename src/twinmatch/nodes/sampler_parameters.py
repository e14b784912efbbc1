"""The sampler's parameters, which depend on the plant: a map entry and an age limit for each signal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from twinmatch.dynamics import Plant, PlantError
from twinmatch.nodes.node import READERS
from twinmatch.nodes.parameters import Parameter, ParameterError
from twinmatch.plants import Peltier, find_plant, written_name
from twinmatch.sessions.column_map import parse_source
from twinmatch.sessions.sampling import INPUT, OUTPUT, REFERENCE, TIMER, Limits, SamplingError, Wire

__all__ = ["Signal", "limits_of", "sampler_table", "signals_of", "types_of", "understood", "wires_of"]

_PERIODS: Final = 3.0
"""Default age from which a reading or a command is stale, in periods."""
_SLOWLY: Final = 60.0
"""The same for disturbances, which change slowly."""
_SLACK: Final = 1e-9
"""Relative tolerance of a limit, for rounding in unit conversions."""


class Signal(NamedTuple):
    """Description, unit and range of one of a plant's signals."""

    text: str
    unit: str
    low: float
    high: float


def signals_of(plant: type[Plant]) -> dict[str, Signal]:
    """The signals of a plant: reference, output, input, and its disturbances in their order."""
    y, u = plant.output, plant.drive
    free = float("-inf"), float("inf")
    return {
        REFERENCE: Signal(f"set-point of {y.text or y.name}", y.unit, *free),
        OUTPUT: Signal(y.text or y.name, y.unit, *y.span),
        INPUT: Signal(u.text or u.name, u.unit, *u.limits),
        **{name: Signal(d.text or name, d.unit, *free) for name, d in plant.disturbances.items()},
    }


def sampler_table(plant: type[Plant] = Peltier, period: float | None = None) -> tuple[Parameter, ...]:
    """The parameters for a plant and a sampling period, s."""
    usual = plant.loop.period if plant.loop else 1.0
    signals = signals_of(plant)
    ages = {REFERENCE: 0.0, OUTPUT: _PERIODS, INPUT: _PERIODS}
    step = period or usual
    return (
        Parameter("plant", written_name(plant), "Plant of the rig: its name, or the file that defines it."),
        Parameter("period", usual, "Sampling period of the running loop.", "s", 0.01, 60.0),
        Parameter(
            "paced_by",
            INPUT,
            "What paces the ticks: a signal with one message per period, or the sampler's own timer.",
            choices=(*signals, TIMER),
        ),
        Parameter("settle", 0.1, "Wait after such a message for those sent with it.", "periods", 0.0, 0.45),
        *(
            Parameter(
                f"map.{name}",
                "",
                f"Topic and field of the {name} ({known.text}){_in(known.unit)}{_may_be(name)}.",
            )
            for name, known in signals.items()
        ),
        *(
            Parameter(
                f"max_age.{name}",
                round(ages.get(name, _SLOWLY) * step, 9),
                f"Age from which a value of the {name} is stale; 0: never.",
                "s",
                0.0,
                1e6,
            )
            for name in signals
        ),
        Parameter(
            "types", "", "Type of each topic that has several, comma-separated: /cmd std_msgs/msg/Float64, …"
        ),
        Parameter(
            "wait_timeout", 10.0, "Longest wait for topics without publisher; 0: for ever.", "s", 0.0, 1e6
        ),
        READERS,
        Parameter("readers_timeout", 30.0, "Longest wait for those nodes.", "s", 0.1, 3600.0),
    )


def understood(place: str, given: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The table for the plant selected by the given values.

    Raises:
        ParameterError: there is no such plant.
    """
    try:
        plant = find_plant(str(given.get("plant", Peltier.name)))
    except PlantError as error:
        msg = f"{place}: {error}"
        raise ParameterError(msg) from error
    period = given.get("period")
    return sampler_table(plant, float(period) if isinstance(period, int | float) and period > 0 else None)


def wires_of(place: str, values: Mapping[str, Any]) -> dict[str, Wire]:
    """The wires of the mapped signals, by name in the plant's order.

    Raises:
        TwinmatchError: a map entry cannot be parsed, or that of output or input is missing.
    """
    found = {}
    for name in signals_of(find_plant(values["plant"])):
        text = values[f"map.{name}"]
        if text.strip():
            source = parse_source(f"{place}: map.{name}", text)
            found[name] = Wire.of(name, source.columns, source.unit, source.scale, source.offset)
    for name in (OUTPUT, INPUT):
        if name not in found:
            msg = f"{place}: map.{name} is missing; give its topic and field, such as /topic:data"
            raise ParameterError(msg)
    return found


def limits_of(values: Mapping[str, Any], mapped: Mapping[str, Wire]) -> dict[str, Limits]:
    """The limits of each mapped signal."""
    known = signals_of(find_plant(values["plant"]))

    def limits(name: str) -> Limits:
        low, high = known[name].low, known[name].high
        slack = _SLACK * max(abs(low), abs(high)) if high - low < float("inf") else 0.0
        return Limits(values[f"max_age.{name}"], low - slack, high + slack, lenient=name == OUTPUT)

    return {name: limits(name) for name in mapped}


def types_of(place: str, text: str) -> dict[str, str]:
    """The configured types, by topic.

    Raises:
        SamplingError: the text is not a list of topics and types.
    """
    found = {}
    for entry in filter(str.strip, text.split(",")):
        words = entry.split()
        if len(words) != 2 or words[1].count("/") != 2:
            msg = f"{place}: types has {entry.strip()!r}; write TOPIC TYPE, such as /cmd std_msgs/msg/Float64"
            raise SamplingError(msg)
        found[words[0]] = words[1]
    return found


def _in(unit: str) -> str:
    return f", in {unit}" if unit else ""


def _may_be(name: str) -> str:
    return "; empty: none" if name not in (OUTPUT, INPUT) else ""
