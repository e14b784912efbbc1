"""The sampler's parameters, which follow the plant: a map entry and an age limit for each of its signals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from twinmatch.dynamics import Plant, PlantError
from twinmatch.nodes.node import READERS
from twinmatch.nodes.parameters import Parameter, ParameterError
from twinmatch.plants import Peltier, find_plant, written_name
from twinmatch.sampling import INPUT, OUTPUT, REFERENCE, TIMER, Limits, SamplingError, Wire
from twinmatch.sessions.column_map import parse_source

__all__ = ["Signal", "limits_of", "sampler_table", "signals_of", "types_of", "understood", "wires_of"]

_PERIODS: Final = 3.0
"""Age of a reading or a command, in periods, from which it is not used, where nothing else is said."""
_SLOWLY: Final = 60.0
"""The same for disturbances, which change slowly."""
_SLACK: Final = 1e-9
"""Part of a limit by which digits of a conversion may pass it."""


class Signal(NamedTuple):
    """What a plant says of one of its signals."""

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
    """The parameters for a plant and a sample time, s."""
    usual = plant.loop.period if plant.loop else 1.0
    signals = signals_of(plant)
    ages = {REFERENCE: 0.0, OUTPUT: _PERIODS, INPUT: _PERIODS}
    step = period or usual
    return (
        Parameter("plant", written_name(plant), "Whose signals they are: name of a plant, or its file."),
        Parameter("period", usual, "Sample time of the loop that runs.", "s", 0.01, 60.0),
        Parameter(
            "paced_by",
            INPUT,
            "What makes the ticks: messages of a signal, one a period, or a timer of our own.",
            choices=(*signals, TIMER),
        ),
        Parameter("settle", 0.1, "Wait behind such a message for those sent with it.", "periods", 0.0, 0.45),
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
                f"Age from which a value of the {name} is not used; 0: any age will do.",
                "s",
                0.0,
                1e6,
            )
            for name in signals
        ),
        Parameter("types", "", "Types of topics with several, with commas: /cmd std_msgs/msg/Float64, …"),
        Parameter(
            "wait_timeout", 10.0, "Longest wait for topics that nobody publishes; 0: for ever.", "s", 0.0, 1e6
        ),
        READERS,
        Parameter("readers_timeout", 30.0, "Longest wait for them.", "s", 0.1, 3600.0),
    )


def understood(place: str, given: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The table for the plant that is named among given values.

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
    """Where the mapped signals come from, by name in the plant's order.

    Raises:
        TwinmatchError: an entry is no map, or output or input has none.
    """
    found = {}
    for name in signals_of(find_plant(values["plant"])):
        text = values[f"map.{name}"]
        if text.strip():
            source = parse_source(f"{place}: map.{name}", text)
            found[name] = Wire.of(name, source.columns, source.unit, source.scale, source.offset)
    for name in (OUTPUT, INPUT):
        if name not in found:
            msg = f"{place}: there is no map.{name}; give its topic and field, such as /topic:data"
            raise ParameterError(msg)
    return found


def limits_of(values: Mapping[str, Any], mapped: Mapping[str, Wire]) -> dict[str, Limits]:
    """What is asked of each mapped signal."""
    known = signals_of(find_plant(values["plant"]))

    def limits(name: str) -> Limits:
        low, high = known[name].low, known[name].high
        slack = _SLACK * max(abs(low), abs(high)) if high - low < float("inf") else 0.0
        return Limits(values[f"max_age.{name}"], low - slack, high + slack, lenient=name == OUTPUT)

    return {name: limits(name) for name in mapped}


def types_of(place: str, text: str) -> dict[str, str]:
    """The types that were given, by topic.

    Raises:
        SamplingError: it is no list of topics and types.
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
    return "; empty: there is none" if name not in (OUTPUT, INPUT) else ""
