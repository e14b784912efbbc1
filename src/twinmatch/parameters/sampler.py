"""The parameters of a sampler: where each signal of a plant comes from, what paces the samples, and limits.

They depend on the plant: a map entry and an age limit for each signal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from twinmatch.dynamics import Plant, PlantError
from twinmatch.links.sources import protocol_of
from twinmatch.parameters.declared import (
    READERS,
    ParameterError,
    Setting,
    Values,
    check,
    sections_of,
)
from twinmatch.parameters.twin import at_period, read_settings
from twinmatch.plants import Peltier, find_plant, written_name
from twinmatch.sampling.channels import Channel, SamplingError, parse_channel
from twinmatch.sampling.listener import Open, SignalListener
from twinmatch.sampling.names import (
    LoopNames,
    by_signal,
    signal_called,
    signals_of,
    turns_of,
)
from twinmatch.sampling.sampler import TIMER, Limits, Sampler
from twinmatch.sampling.sources import SignalMap, SignalSource, parse_source
from twinmatch.twin import TwinSettings

SAMPLER: Final = "sampler"
_SIM_TIME: Final = Setting("use_sim_time", False, "Whether the time is that of /clock.")
_PERIODS: Final = 3.0
"""Default age from which a reading or a command is stale, in periods."""
_SLOWLY: Final = 60.0
"""The same for disturbances, which change slowly."""
_SLACK: Final = 1e-9
"""Relative tolerance of a limit, for rounding in unit conversions."""


def sampler_table(
    plant: type[Plant] = Peltier, period: float | None = None
) -> tuple[Setting, ...]:
    """The parameters for a plant and a sampling period, s."""
    usual = plant.loop.period if plant.loop else 1.0
    signals = signals_of(plant)
    step = period or usual
    loop = LoopNames.of(plant)
    ages = dict.fromkeys(loop.references, 0.0) | dict.fromkeys(
        (*loop.outputs, *loop.inputs), _PERIODS
    )
    pacer = "What paces the ticks: a signal with one message per period, or the sampler's own timer."
    types = "Type of each topic that has several, comma-separated: /cmd std_msgs/msg/Float64, …"
    wait = "Longest wait for topics of ROS without publisher; 0: for ever."
    maps = []
    limits = []
    for name, signal in signals.items():
        unit = f", in {signal.unit}" if signal.unit else ""
        optional = "; empty: none" if name not in (*loop.outputs, *loop.inputs) else ""
        text = f"Place (topic and field) of the {name} ({signal.text or signal.name}){unit}{optional}."
        maps.append(Setting(f"map.{name}", "", text))
        age = round(ages.get(name, _SLOWLY) * step, 9)
        text = f"Age from which a value of the {name} is stale; 0: never."
        limits.append(Setting(f"max_age.{name}", age, text, "s", 0.0, 1e6))
    return (
        Setting(
            "plant",
            written_name(plant),
            "Plant of the rig: its name, or the file that defines it.",
        ),
        Setting(
            "source",
            "",
            "Where the signals come from: mqtt://…, modbus://…; empty: topics of ROS.",
        ),
        Setting(
            "period", usual, "Sampling period of the running loop.", "s", 0.01, 60.0
        ),
        Setting("paced_by", loop.inputs[0], pacer, choices=(*signals, TIMER)),
        Setting(
            "settle",
            0.1,
            "Wait after such a message for those sent with it.",
            "periods",
            0.0,
            0.45,
        ),
        *maps,
        *limits,
        Setting("types", "", types),
        Setting("wait_timeout", 10.0, wait, "s", 0.0, 1e6),
        READERS,
        Setting(
            "readers_timeout", 30.0, "Longest wait for those nodes.", "s", 0.1, 3600.0
        ),
    )


def understood(
    place: str, given_values: Mapping[str, Any]
) -> tuple[tuple[Setting, ...], dict[str, Any]]:
    """The table for the plant selected by the given values, and these by its own names of the signals.

    Raises:
        ParameterError: there is no such plant, or a signal is given by two of its names.
    """
    try:
        plant = find_plant(str(given_values.get("plant", Peltier.name)))
    except PlantError as error:
        raise ParameterError(f"{place}: {error}") from error
    called = signal_called(plant)
    used = dict[str, str]()
    for name in given_values:
        kind, _, signal = name.partition(".")
        usual_name = (
            f"{kind}.{called.get(signal, signal)}"
            if kind in {"map", "max_age"}
            else name
        )
        if usual_name in used:
            raise ParameterError(
                f"{place}: {used[usual_name]} and {name} are the same signal; give it once"
            )
        used[usual_name] = name
    values = {usual_name: given_values[name] for usual_name, name in used.items()}
    if isinstance(pacer := values.get("paced_by"), str):
        values["paced_by"] = called.get(pacer, pacer)
    period = given_values.get("period")
    valid_period = (
        float(period) if isinstance(period, int | float) and period > 0 else None
    )
    return sampler_table(plant, valid_period), values


def sources_of(place: str, values: Mapping[str, Any]) -> dict[str, SignalSource]:
    """The sources of the mapped signals, by name in the plant's order.

    Raises:
        TwinmatchError: a map entry cannot be parsed, or that of an output, an input or one of several
            set-points is missing.
    """
    sources = {}
    plant = find_plant(values["plant"])
    parse = _parse_of(values)
    for name in signals_of(plant):
        text = values[f"map.{name}"]
        if text.strip():
            sources[name] = parse_source(f"{place}: map.{name}", text)
            sources[name].channels(name, parse)
    loop = LoopNames.of(plant)
    closed = loop.references if sources.keys() & {*loop.references} else ()
    for name in (*loop.outputs, *loop.inputs, *closed):
        if name not in sources:
            hint = "; give all set-points, or none" if name in closed else ""
            msg = f"{place}: map.{name} is missing; give its topic and field, such as /topic:data{hint}"
            raise ParameterError(msg)
    return sources


def _parse_of(values: Mapping[str, Any]) -> Callable[[str], Channel]:
    """How a place is written in a map."""
    return (
        protocol_of(values["source"]).parse_place if values["source"] else parse_channel
    )


def limits_of(
    values: Mapping[str, Any], mapped: Mapping[str, SignalSource]
) -> dict[str, Limits]:
    """The limits of each mapped signal."""
    plant = find_plant(values["plant"])
    signals = signals_of(plant)
    outputs = LoopNames.of(plant).outputs
    readable = {
        name: output.readable
        for name, output in zip(outputs, plant.outputs.values(), strict=True)
    }

    def limits(name: str) -> Limits:
        low, high = readable.get(name, (signals[name].low, signals[name].high))
        slack = _SLACK * max(abs(low), abs(high)) if high - low < float("inf") else 0.0
        return Limits(
            values[f"max_age.{name}"],
            low - slack,
            high + slack,
            lenient=name in outputs,
        )

    return {name: limits(name) for name in mapped}


def types_of(place: str, text: str) -> dict[str, str]:
    """The configured types, by topic.

    Raises:
        SamplingError: the text is not a list of topics and types.
    """
    types = {}
    for entry in filter(str.strip, text.split(",")):
        words = entry.split()
        if len(words) != 2 or words[1].count("/") != 2:
            msg = f"{place}: types has {entry.strip()!r}; write TOPIC TYPE, such as /cmd std_msgs/msg/Float64"
            raise SamplingError(msg)
        types[words[0]] = words[1]
    return types


def listener_of(
    place: str, values: Mapping[str, Any], now: Callable[[], int]
) -> SignalListener:
    """The listener with these parameters; `now` is the time of the clock of the stamps, ns.

    Raises:
        TwinmatchError: they contradict each other.
    """
    plant = find_plant(values["plant"])
    sources = sources_of(place, values)
    pacer = values["paced_by"]
    if pacer not in (*sources, TIMER):
        msg = f"{place}: paced_by is {pacer}, but map.{pacer} is missing; add it, or change paced_by"
        raise SamplingError(msg)
    sampler = Sampler(
        limits_of(values, sources),
        values["period"],
        pacer,
        settle=values["settle"],
        disturbances={name: d.default for name, d in plant.disturbances.items()},
        loop=LoopNames.of(plant),
        turns=turns_of(plant, sources),
    )
    parse = _parse_of(values)
    channels = {name: source.channels(name, parse) for name, source in sources.items()}
    return SignalListener(
        sampler, plant, sources, channels, now=now, wait=values["wait_timeout"]
    )


def source_of(values: Mapping[str, Any]) -> Open | None:
    """What opens the source; None: it is ROS."""
    url = values["source"]
    return partial(protocol_of(url).open_source, url, values["period"]) if url else None


def sampler_values(
    config: Path | None, signal_map: SignalMap, source: str = ""
) -> tuple[Values, bool]:
    """The sampler's parameters, and whether it has the time of /clock.

    Args:
        config: parameter file with a section `sampler`; None: there is none.
        signal_map: plant, sampling period and map of the command line; they override the file.
        source: the URL of the source; it overrides the file, too.

    Raises:
        TwinmatchError: one of them cannot be used.
    """
    given_values = sections_of(config, SAMPLER) if config is not None else {}
    if source:
        given_values["source"] = source
    if signal_map.plant:
        given_values["plant"] = signal_map.plant
    if signal_map.period is not None:
        given_values["period"] = signal_map.period
    place = str(config) if config is not None else "attach"
    plant = find_plant(str(given_values.get("plant", "peltier")))
    table, given_values = understood(place, given_values)
    for signal, signal_source in by_signal(plant, signal_map.sources).items():
        given_values[f"map.{signal}"] = signal_source.text
    values = check(place, table, given_values)
    sources_of(place, values)
    return values, bool(
        _SIM_TIME.accept(given_values.get(_SIM_TIME.name, False), place)
    )


def twin_beside(values: Mapping[str, Any], config: Path | None) -> TwinSettings:
    """The settings of a twin beside a sampler with these parameters; those of a file, if it has any.

    Raises:
        TwinmatchError: the file cannot be used, or contradicts the sampler's parameters.
    """
    plant = find_plant(values["plant"])
    driven = LoopNames.of(plant).references[0] not in sources_of(SAMPLER, values)
    as_written = read_settings(config, written_name(plant), driven=driven)
    if driven and as_written.law is not None:
        raise ParameterError(
            f"{config}: the twin runs in closed loop, but nothing is mapped to its reference; map it, or set "
            "loop: unknown"
        )
    return at_period(as_written, values["period"], config)
