"""Samples a loop that foreign programs run: their topics in, `plant/sample` out. It commands nothing.

Its parameters depend on the plant: a map entry and an age limit for each signal.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final

from twinmatch.dynamics import Plant, PlantError
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import nanoseconds, sample_message
from twinmatch.nodes.node import READERS, Missed, Readers, TwinmatchNode
from twinmatch.nodes.topics import RELIABLE, ForeignTopics
from twinmatch.parameters.declared import ParameterError, Setting
from twinmatch.plants import Peltier, find_plant, written_name
from twinmatch.sampling.channels import Followed, SamplingError
from twinmatch.sampling.names import LoopNames, signal_called, signals_of
from twinmatch.sampling.sampler import TIMER, Limits, Sampler
from twinmatch.sampling.sources import FollowedSignal, SignalSource, parse_source
from twinmatch_msgs.msg import LoopSample

_PERIODS: Final = 3.0
"""Default age from which a reading or a command is stale, in periods."""
_SLOWLY: Final = 60.0
"""The same for disturbances, which change slowly."""
_SLACK: Final = 1e-9
"""Relative tolerance of a limit, for rounding in unit conversions."""


def sampler_table(plant: type[Plant] = Peltier, period: float | None = None) -> tuple[Setting, ...]:
    """The parameters for a plant and a sampling period, s."""
    usual = plant.loop.period if plant.loop else 1.0
    signals, step, loop = signals_of(plant), period or usual, LoopNames.of(plant)
    ages = dict.fromkeys(loop.references, 0.0) | dict.fromkeys((*loop.outputs, *loop.inputs), _PERIODS)
    pacer = "What paces the ticks: a signal with one message per period, or the sampler's own timer."
    types = "Type of each topic that has several, comma-separated: /cmd std_msgs/msg/Float64, …"
    wait = "Longest wait for topics without publisher; 0: for ever."
    maps, limits = [], []
    for name, known in signals.items():
        unit = f", in {known.unit}" if known.unit else ""
        optional = "; empty: none" if name not in (*loop.outputs, *loop.inputs) else ""
        text = f"Topic and field of the {name} ({known.text or known.name}){unit}{optional}."
        maps.append(Setting(f"map.{name}", "", text))
        age = round(ages.get(name, _SLOWLY) * step, 9)
        text = f"Age from which a value of the {name} is stale; 0: never."
        limits.append(Setting(f"max_age.{name}", age, text, "s", 0.0, 1e6))
    return (
        Setting("plant", written_name(plant), "Plant of the rig: its name, or the file that defines it."),
        Setting("period", usual, "Sampling period of the running loop.", "s", 0.01, 60.0),
        Setting("paced_by", loop.inputs[0], pacer, choices=(*signals, TIMER)),
        Setting("settle", 0.1, "Wait after such a message for those sent with it.", "periods", 0.0, 0.45),
        *maps,
        *limits,
        Setting("types", "", types),
        Setting("wait_timeout", 10.0, wait, "s", 0.0, 1e6),
        READERS,
        Setting("readers_timeout", 30.0, "Longest wait for those nodes.", "s", 0.1, 3600.0),
    )


def understood(place: str, given: Mapping[str, Any]) -> tuple[tuple[Setting, ...], dict[str, Any]]:
    """The table for the plant selected by the given values, and these by its own names of the signals.

    Raises:
        ParameterError: there is no such plant, or a signal is given by two of its names.
    """
    try:
        plant = find_plant(str(given.get("plant", Peltier.name)))
    except PlantError as error:
        raise ParameterError(f"{place}: {error}") from error
    called, used = signal_called(plant), dict[str, str]()
    for name in given:
        kind, _, signal = name.partition(".")
        own = f"{kind}.{called.get(signal, signal)}" if kind in {"map", "max_age"} else name
        if own in used:
            raise ParameterError(f"{place}: {used[own]} and {name} are the same signal; give it once")
        used[own] = name
    values = {own: given[name] for own, name in used.items()}
    if isinstance(pacer := values.get("paced_by"), str):
        values["paced_by"] = called.get(pacer, pacer)
    period = given.get("period")
    known = float(period) if isinstance(period, int | float) and period > 0 else None
    return sampler_table(plant, known), values


def sources_of(place: str, values: Mapping[str, Any]) -> dict[str, SignalSource]:
    """The sources of the mapped signals, by name in the plant's order.

    Raises:
        TwinmatchError: a map entry cannot be parsed, or that of an output, an input or one of several
            set-points is missing.
    """
    sources, plant = {}, find_plant(values["plant"])
    for name in signals_of(plant):
        text = values[f"map.{name}"]
        if text.strip():
            sources[name] = parse_source(f"{place}: map.{name}", text)
            sources[name].channels(name)
    loop = LoopNames.of(plant)
    closed = loop.references if sources.keys() & {*loop.references} else ()
    for name in (*loop.outputs, *loop.inputs, *closed):
        if name not in sources:
            more = "; give all set-points, or none" if name in closed else ""
            msg = f"{place}: map.{name} is missing; give its topic and field, such as /topic:data{more}"
            raise ParameterError(msg)
    return sources


def limits_of(values: Mapping[str, Any], mapped: Mapping[str, SignalSource]) -> dict[str, Limits]:
    """The limits of each mapped signal."""
    plant = find_plant(values["plant"])
    known, outputs = signals_of(plant), LoopNames.of(plant).outputs

    def limits(name: str) -> Limits:
        low, high = known[name].low, known[name].high
        slack = _SLACK * max(abs(low), abs(high)) if high - low < float("inf") else 0.0
        return Limits(values[f"max_age.{name}"], low - slack, high + slack, lenient=name in outputs)

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


SEARCH: Final = 0.2
"""Interval between two searches for topics, s."""
CHECKS: Final = 20
"""Checks for complete samples per sampling period."""
INTERVAL: Final = (0.002, 0.05)
"""Shortest and longest interval between two checks, s."""


class SamplerNode(TwinmatchNode):
    """Subscribes to the mapped topics and publishes a sample for each tick of the loop.

    At the start, a topic without publisher, a missing field or an incompatible unit ends the node with one
    error line. Once sampling has started, the node waits for a rig that falls silent.
    """

    NAME = "sampler"
    PARAMETERS: ClassVar = sampler_table()

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The parameters for the selected plant."""
        return understood(cls.NAME, given)

    def read_parameters(self) -> None:
        """Create the sampler and its sources."""
        values = self.values
        self._plant = find_plant(values["plant"])
        self._sources = sources_of(self.NAME, values)
        self._types = types_of(self.NAME, values["types"])
        if values["paced_by"] not in (*self._sources, TIMER):
            pacer = values["paced_by"]
            msg = f"{self.NAME}: paced_by is {pacer}, but map.{pacer} is missing; add it, or change paced_by"
            raise SamplingError(msg)
        self._sampler = Sampler(
            limits_of(values, self._sources),
            values["period"],
            values["paced_by"],
            settle=values["settle"],
            disturbances={name: d.default for name, d in self._plant.disturbances.items()},
            loop=LoopNames.of(self._plant),
        )

    def open(self) -> None:
        """Start to search for the topics."""
        self._publisher = self.create_publisher(LoopSample, "plant/sample", RELIABLE)
        self._channels = {name: source.channels(name) for name, source in self._sources.items()}
        channels = [channel for each in self._channels.values() for channel in each]
        self._topics = ForeignTopics(self, channels, self._types, self._on_message)
        self._ready: dict[str, FollowedSignal] = {}
        self._followed: dict[str, list[Followed]] = {}
        """How the numbers of a ready signal are found, by its channels."""
        self._fresh: dict[str, dict[int, tuple[float, int]]] = {name: {} for name in self._sources}
        self._begun = time.monotonic()
        self._heard: dict[str, float] = {}
        self._missed = Missed(self.health, "the loop paused: ")
        self._readers = Readers(self, self._publisher.topic_name, self.values["readers_timeout"])
        self._index = -1
        self._first: int | None = None
        """The sampler's index of the first published sample, which is published as sample 0."""
        period = self.values["period"]
        self.wall_timer(SEARCH, self._on_search)
        self.create_timer(min(max(period / CHECKS, INTERVAL[0]), INTERVAL[1]), self._on_check)
        if self.values["paced_by"] == TIMER:
            self.create_timer(period, lambda: self._sampler.tick(self._now()))
        self.health.say("waiting for topics")
        self.report_on()

    def report(self) -> Report:
        """Each signal's value and counts, and the reason if there are no samples."""
        sampler, now = self._sampler, time.monotonic()
        level = Level.ERROR if self._index >= 0 or self._late(now) else Level.WARN
        for name in self._sources:
            counts = sampler.counts[name]
            newest = sampler.newest(name)
            self.health.set(name, "none yet" if newest is None else f"{newest:g}")
            self.health.set(
                f"{name}: missing, late, out of range, not a number",
                f"{counts.missing}, {counts.late}, {counts.beyond}, {sampler.refused(name)}",
            )
            trouble = self._silence(name, now) or sampler.troubles.get(name, "")
            text = self._explain(name, trouble)
            self.health.flag_if(bool(text), name, level, text)
        timeless = self.get_parameter("use_sim_time").value and not self._now()
        text = "use_sim_time is set, but there is no time on /clock; start what publishes it"
        self.health.flag_if(bool(timeless), "clock", level, text)
        pace = sampler.troubles.get("pace", "")
        self.health.flag_if(bool(pace), "pace", level, pace)
        self.health.set("missed ticks", sampler.grid.missed)
        self.health.set("ticks without sample", sampler.idle)
        self.health.set("tick late by", f"{sampler.grid.jitter / 1e6:.1f} ms")
        return super().report()

    def _on_search(self) -> None:
        try:
            self._topics.search()
            for name, source in self._sources.items():
                kinds = [self._topics.kinds.get(c.topic, "") for c in self._channels[name]]
                if name not in self._ready and all(kinds):
                    channels = [c._replace(path=self._topics.path(c)) for c in self._channels[name]]
                    unit = signals_of(self._plant)[name].unit
                    self._ready[name] = source.follow(name, unit, channels, kinds)
                    self._followed[name] = list(map(Followed, channels))
        except TwinmatchError as error:
            self.failed = SamplingError(f"{self.NAME}: {error}")
            return
        missing = self._topics.missing
        if missing and self._late(time.monotonic()):
            waited = self.values["wait_timeout"]
            msg = (
                f"{self.NAME}: no publisher on {' or '.join(missing)} for {waited:g} s; topics with a "
                f"publisher: {self._topics.alternatives()}"
            )
            self.failed = SamplingError(msg)

    def _on_message(self, topic: str, message: Any) -> None:
        now = self._now()
        header = getattr(message, "header", None)
        stamp = nanoseconds(header.stamp) if header is not None else 0
        step = round(self.values["period"] * 1e9)
        ahead = f"{(stamp - now) / 1e9:.1f} s ahead of this machine's clock; the time of arrival is used"
        self.health.flag_if(stamp > now + step, "stamps", Level.WARN, f"the stamps of {topic} are {ahead}")
        # A reading stamped in the future would never become stale; one without a stamp counts as new.
        at = min(stamp, now) if stamp else now
        for name, source in self._ready.items():
            fresh = self._fresh[name]
            numbers = self._numbers(name, source, topic, message)
            fresh |= {place: (number, at) for place, number in numbers.items()}
            if numbers:
                self._heard[name] = time.monotonic()
                if len(fresh) == len(source.channels):
                    value = source.value([number for number, _ in fresh.values()])
                    self._sampler.take(name, value, min(when for _, when in fresh.values()), now)
                    fresh.clear()
        self._on_check()

    def _numbers(self, name: str, source: FollowedSignal, topic: str, message: Any) -> dict[int, float]:
        """The numbers of a signal in a message, by their places; none where it does not have the signal's.

        Before the first sample a message that names its elements otherwise than the one before ends the node;
        later it is left out: the loop that was sampled until then may still run.
        """
        each = enumerate(zip(source.channels, self._followed[name], strict=True))
        try:
            found = {k: by.number(message) for k, (channel, by) in each if channel.topic == topic}
        except SamplingError as error:
            if self._index < 0:
                self.failed = SamplingError(f"{self.NAME}: {name}: {error}")
            self.health.flag(f"{name}: names", Level.ERROR, f"{error}; other messages are left out")
            return {}
        return {place: number for place, number in found.items() if number is not None}

    def _on_check(self) -> None:
        for sample in self._sampler.collect(self._now()):
            if self._readers.there():
                if self._first is None:
                    self._first = sample.index
                self._index = sample.index - self._first
                self._publisher.publish(sample_message(replace(sample, index=self._index), self._plant.name))
                self.health.set("sample", self._index)
                self.health.say("sampling")
        self._missed.watch(self._sampler.grid.missed, self._index)

    def _silence(self, name: str, now: float) -> str:
        """The report on a signal that is silent; empty if it is not, or if silence is allowed."""
        topics = " and ".join(dict.fromkeys(channel.topic for channel in self._channels[name]))
        gone = [c.topic for c in self._channels[name] if not self._topics.publishers(c.topic)]
        limit, heard = self.values[f"max_age.{name}"], self._heard.get(name)
        if heard is None:
            return f"no publisher on {gone[0]}" if gone else f"no message on {topics} yet"
        if limit and now - heard > limit:
            why = f"; {gone[0]} no longer has a publisher" if gone else ""
            return f"no message on {topics} for {now - heard:.1f} s{why}"
        return ""

    def _explain(self, name: str, trouble: str) -> str:
        text = self._channels[name][0].text
        if "outside" in trouble:
            unit = signals_of(self._plant)[name].unit
            return (
                f"{trouble} {unit}: no samples; if {text} has another unit, append '; unit=' to its map entry"
            )
        if "s old" in trouble:
            lag = f"{trouble}: no samples; the stamps of {text} lag behind this machine's clock"
            simulated = self.get_parameter("use_sim_time").value
            return lag if simulated else f"{lag}; if they are in simulated time, set use_sim_time"
        return f"{name}: {trouble}; no samples" if trouble else ""

    def _late(self, now: float) -> bool:
        waited = self.values["wait_timeout"]
        return bool(waited) and now > self._begun + waited

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)
