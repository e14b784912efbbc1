"""Samples a loop that foreign programs run: their topics in, `plant/sample` out. It commands nothing."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final

from rclpy.clock import Clock, ClockType

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.diagnostics import Level, Report
from twinmatch.nodes.foreign_topics import ForeignTopics
from twinmatch.nodes.keeper import Keeper
from twinmatch.nodes.node import TwinmatchNode, missing_readers
from twinmatch.nodes.parameters import Parameter
from twinmatch.nodes.runner import run
from twinmatch.nodes.sample_messages import sample_message
from twinmatch.nodes.sampler_parameters import (
    limits_of,
    sampler_table,
    signals_of,
    types_of,
    understood,
    wires_of,
)
from twinmatch.nodes.samples import RELIABLE, nanoseconds
from twinmatch.plants import find_plant
from twinmatch.sessions.sampling import TIMER, Sampler, SamplingError, Wire, follow
from twinmatch_msgs.msg import LoopSample

__all__ = ["SamplerNode", "main"]

SEARCH: Final = 0.2
"""Interval between two searches for topics, s."""
LOOKS: Final = 20
"""Checks for complete samples per sampling period."""
LOOK: Final = (0.002, 0.05)
"""Shortest and longest interval between two checks, s."""
REMEMBER: Final = 60
"""Ticks for which a missed one is reported."""


class SamplerNode(TwinmatchNode):
    """Subscribes to the mapped topics and publishes a sample for each tick of the loop.

    At the start, a topic without publisher, a missing field or an incompatible unit ends the node with one
    error line. Once sampling has started, the node waits for a rig that falls silent.
    """

    NAME = "sampler"
    PARAMETERS: ClassVar = sampler_table()

    _failure: TwinmatchError | None = None

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Parameter], Mapping[str, Any]]:
        """The parameters for the selected plant."""
        return understood(cls.NAME, given), given

    def read_parameters(self) -> None:
        """Create the sampler and its wires.

        Raises:
            TwinmatchError: parameters contradict each other.
        """
        values = self.values
        self._plant = find_plant(values["plant"])
        self._wires = wires_of(self.NAME, values)
        self._types = types_of(self.NAME, values["types"])
        if values["paced_by"] not in (*self._wires, TIMER):
            pacer = values["paced_by"]
            msg = f"{self.NAME}: paced_by is {pacer}, but map.{pacer} is missing; add it, or change paced_by"
            raise SamplingError(msg)
        self._sampler = Sampler(
            limits_of(values, self._wires),
            values["period"],
            values["paced_by"],
            settle=values["settle"],
            disturbances={name: d.default for name, d in self._plant.disturbances.items()},
        )

    def open(self) -> None:
        """Start to search for the topics."""
        self._publisher = self.create_publisher(LoopSample, "plant/sample", RELIABLE)
        channels = [channel for wire in self._wires.values() for channel in wire.channels]
        self._topics = ForeignTopics(self, channels, self._types, self._on_message)
        self._ready: dict[str, Wire] = {}
        self._fresh: dict[str, dict[int, tuple[float, int]]] = {name: {} for name in self._wires}
        self._begun = time.monotonic()
        self._heard: dict[str, float] = {}
        self._missed_at = (0, 0)
        self._index = -1
        self._first: int | None = None
        """The sampler's index of the first published sample, which is published as sample 0."""
        self._waiting = True
        period = self.values["period"]
        self.create_timer(SEARCH, self._on_search, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_timer(min(max(period / LOOKS, LOOK[0]), LOOK[1]), self._on_look)
        if self.values["paced_by"] == TIMER:
            self.create_timer(period, lambda: self._sampler.tick(self._now()))
        self.health.say("waiting for topics")
        self.report_on()

    @property
    def failure(self) -> Exception | None:
        """The error in the map or the graph that prevents sampling, if any."""
        return self._failure

    def report(self) -> Report:
        """Each signal's value and counts, and the reason if there are no samples."""
        sampler, now = self._sampler, time.monotonic()
        level = Level.ERROR if self._index >= 0 or self._late(now) else Level.WARN
        for name, wire in self._wires.items():
            counts = sampler.counts[name]
            newest = sampler.newest(name)
            self.health.set(name, "none yet" if newest is None else f"{newest:g}")
            self.health.set(
                f"{name}: missing, late, out of range, not a number",
                f"{counts.missing}, {counts.late}, {counts.beyond}, {sampler.refused(name)}",
            )
            trouble = self._silence(name, wire, now) or sampler.troubles.get(name, "")
            self._flag(name, level, self._explained(name, wire, trouble))
        self._flag("pace", level, sampler.troubles.get("pace", ""))
        self.health.set("missed ticks", sampler.grid.missed)
        self.health.set("ticks without sample", sampler.idle)
        self.health.set("tick late by", f"{sampler.grid.jitter / 1e6:.1f} ms")
        return super().report()

    def _on_search(self) -> None:
        try:
            self._topics.look()
            for name, wire in self._wires.items():
                kinds = [self._topics.kinds.get(channel.topic, "") for channel in wire.channels]
                if name not in self._ready and all(kinds):
                    paths = [self._topics.path(channel) for channel in wire.channels]
                    unit = signals_of(self._plant)[name].unit
                    self._ready[name] = wire.to(unit, kinds, paths)
        except TwinmatchError as error:
            self._failure = SamplingError(f"{self.NAME}: {error}")
            return
        missing = self._topics.missing
        if missing and self._late(time.monotonic()):
            waited = self.values["wait_timeout"]
            msg = (
                f"{self.NAME}: no publisher on {' or '.join(missing)} for {waited:g} s; topics with a "
                f"publisher: {self._topics.alternatives()}"
            )
            self._failure = SamplingError(msg)

    def _on_message(self, topic: str, message: Any) -> None:
        """Take the values of a message, for each signal mapped to it."""
        now = self._now()
        header = getattr(message, "header", None)
        stamp = nanoseconds(header.stamp) if header is not None else 0
        step = round(self.values["period"] * 1e9)
        self._flag("stamps", Level.WARN, _ahead(topic, stamp - now) if stamp > now + step else "")
        # A reading stamped in the future would never become stale; one without a stamp counts as new.
        at = min(stamp, now) if stamp else now
        for name, wire in self._ready.items():
            fresh = self._fresh[name]
            for place, channel in enumerate(wire.channels):
                if channel.topic == topic:
                    fresh[place] = follow(message, channel.path), at
            if any(c.topic == topic for c in wire.channels):
                self._heard[name] = time.monotonic()
                if len(fresh) == len(wire.channels):
                    value = wire.value([number for number, _ in fresh.values()])
                    self._sampler.take(name, value, min(when for _, when in fresh.values()), now)
                    fresh.clear()
        self._on_look()

    def _on_look(self) -> None:
        for sample in self._sampler.look(self._now()):
            if self._readers_there():
                if self._first is None:
                    self._first = sample.index
                self._index = sample.index - self._first
                self._publisher.publish(sample_message(replace(sample, index=self._index), self._plant.name))
                self.health.set("sample", self._index)
                self.health.say("sampling")
        missed, index = self._sampler.grid.missed, self._index
        if missed != self._missed_at[0]:
            self._missed_at = (missed, index)
            text = f"the loop paused: ticks were missed, {missed} in all; windows start over"
            self.health.flag("missed", Level.WARN, text)
        elif index - self._missed_at[1] > REMEMBER:
            self.health.withdraw("missed")

    def _readers_there(self) -> bool:
        """Whether all nodes that must not miss a sample subscribe, or the wait for them is over."""
        if self._waiting:
            missing = missing_readers(self, self._publisher.topic_name, self.values["readers"])
            over = time.monotonic() > self._begun + self.values["readers_timeout"]
            if missing and over:
                text = f"{', '.join(missing)} did not subscribe to {self._publisher.topic_name} in time"
                self.health.flag("readers", Level.WARN, text)
            self._waiting = bool(missing) and not over
        return not self._waiting

    def _silence(self, name: str, wire: Wire, now: float) -> str:
        """The report on a signal that is silent; empty if it is not, or if silence is allowed."""
        topics = " and ".join(dict.fromkeys(channel.topic for channel in wire.channels))
        gone = [c.topic for c in wire.channels if not self._topics.publishers(c.topic)]
        limit, heard = self.values[f"max_age.{name}"], self._heard.get(name)
        if heard is None:
            return f"no publisher on {gone[0]}" if gone else f"no message on {topics} yet"
        if limit and now - heard > limit:
            why = f"; {gone[0]} no longer has a publisher" if gone else ""
            return f"no message on {topics} for {now - heard:.1f} s{why}"
        return ""

    def _explained(self, name: str, wire: Wire, trouble: str) -> str:
        """A problem and what to do about it."""
        text = wire.channels[0].text
        if "outside" in trouble:
            unit = signals_of(self._plant)[name].unit
            return (
                f"{trouble} {unit}: no samples; if {text} has another unit, append '; unit=' to its map entry"
            )
        if "s old" in trouble:
            return f"{trouble}: no samples; the stamps of {text} lag behind this machine's clock"
        return f"{name}: {trouble}; no samples" if trouble else ""

    def _late(self, now: float) -> bool:
        waited = self.values["wait_timeout"]
        return bool(waited) and now > self._begun + waited

    def _flag(self, key: str, level: Level, text: str) -> None:
        if text:
            self.health.flag(key, level, text)
        else:
            self.health.withdraw(key)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def _ahead(topic: str, nanos: int) -> str:
    ahead = f"{nanos / 1e9:.1f} s"
    return f"the stamps of {topic} are {ahead} ahead of this machine's clock; the time of arrival is used"


def main() -> None:
    """Console script."""
    sys.exit(run([SamplerNode, Keeper]))


if __name__ == "__main__":
    main()
