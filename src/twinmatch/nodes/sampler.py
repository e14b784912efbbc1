"""Samples a loop that other programs run: their topics in, `plant/sample` out. It commands nothing."""

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
from twinmatch.sampling import TIMER, Sampler, SamplingError, Wire, follow
from twinmatch_msgs.msg import LoopSample

__all__ = ["SamplerNode", "main"]

SEARCH: Final = 0.2
"""Seconds between two looks for topics."""
LOOKS: Final = 20
"""Looks for complete samples in a period."""
LOOK: Final = (0.002, 0.05)
"""Shortest and longest time between two of them, s."""
REMEMBER: Final = 60
"""Ticks for which a missed one is complained of."""


class SamplerNode(TwinmatchNode):
    """Hears the topics that are mapped and publishes a sample for each tick of the loop.

    A topic that nobody publishes, a field that is not there and a unit that does not fit end it with one
    line, as long as it has not begun; later, a rig that is silent is waited for.
    """

    NAME = "sampler"
    PARAMETERS: ClassVar = sampler_table()

    _failure: TwinmatchError | None = None

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Parameter], Mapping[str, Any]]:
        """The parameters for the plant that is named."""
        return understood(cls.NAME, given), given

    def read_parameters(self) -> None:
        """Make wires and rules.

        Raises:
            TwinmatchError: some parameters do not go together.
        """
        values = self.values
        self._plant = find_plant(values["plant"])
        self._wires = wires_of(self.NAME, values)
        self._types = types_of(self.NAME, values["types"])
        if values["paced_by"] not in (*self._wires, TIMER):
            pacer = values["paced_by"]
            msg = f"{self.NAME}: paced_by is {pacer}, and there is no map.{pacer}; give it, or another pacer"
            raise SamplingError(msg)
        self._sampler = Sampler(
            limits_of(values, self._wires),
            values["period"],
            values["paced_by"],
            settle=values["settle"],
            disturbances={name: d.default for name, d in self._plant.disturbances.items()},
        )

    def open(self) -> None:
        """Look for the topics."""
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
        """What the sampler calls the first sample that was published, which is sample 0."""
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
        """What was asked for and is not there."""
        return self._failure

    def report(self) -> Report:
        """What comes of each signal, and why there are no samples."""
        sampler, now = self._sampler, time.monotonic()
        level = Level.ERROR if self._index >= 0 or self._late(now) else Level.WARN
        for name, wire in self._wires.items():
            counts = sampler.counts[name]
            newest = sampler.newest(name)
            self.health.set(name, "none yet" if newest is None else f"{newest:g}")
            self.health.set(
                f"{name}: missing, late, beyond, no number",
                f"{counts.missing}, {counts.late}, {counts.beyond}, {sampler.refused(name)}",
            )
            trouble = self._silence(name, wire, now) or sampler.troubles.get(name, "")
            self._tell(name, level, self._explained(name, wire, trouble))
        self._tell("pace", level, sampler.troubles.get("pace", ""))
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
                f"{self.NAME}: nobody publishes {' or '.join(missing)}, for {waited:g} s now; there are "
                f"{self._topics.instead()}"
            )
            self._failure = SamplingError(msg)

    def _on_message(self, topic: str, message: Any) -> None:
        """Take the numbers of a message, for each signal that has some of it."""
        now = self._now()
        header = getattr(message, "header", None)
        stamp = nanoseconds(header.stamp) if header is not None else 0
        step = round(self.values["period"] * 1e9)
        self._tell("stamps", Level.WARN, _ahead(topic, stamp - now) if stamp > now + step else "")
        # A reading stamped in the time to come would never grow old; one without stamp is new.
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
            text = f"the loop paused: ticks were missed, {missed} in all; windows begin anew"
            self.health.complain("missed", Level.WARN, text)
        elif index - self._missed_at[1] > REMEMBER:
            self.health.withdraw("missed")

    def _readers_there(self) -> bool:
        """Whether those who must not miss a sample listen, or were waited for long enough."""
        if self._waiting:
            missing = missing_readers(self, self._publisher.topic_name, self.values["readers"])
            over = time.monotonic() > self._begun + self.values["readers_timeout"]
            if missing and over:
                text = f"{', '.join(missing)} did not come to read {self._publisher.topic_name}"
                self.health.complain("readers", Level.WARN, text)
            self._waiting = bool(missing) and not over
        return not self._waiting

    def _silence(self, name: str, wire: Wire, now: float) -> str:
        """What to say of a signal of which nothing comes; empty if something does, or nothing has to."""
        topics = " and ".join(dict.fromkeys(channel.topic for channel in wire.channels))
        gone = [c.topic for c in wire.channels if not self._topics.publishers(c.topic)]
        limit, heard = self.values[f"max_age.{name}"], self._heard.get(name)
        if heard is None:
            return f"nobody publishes {gone[0]}" if gone else f"nothing came of {topics} yet"
        if limit and now - heard > limit:
            why = f"; nobody publishes {gone[0]} any more" if gone else ""
            return f"nothing of {topics} for {now - heard:.1f} s{why}"
        return ""

    def _explained(self, name: str, wire: Wire, trouble: str) -> str:
        """A trouble and what may be done about it."""
        text = wire.channels[0].text
        if "beyond" in trouble:
            unit = signals_of(self._plant)[name].unit
            return f"{trouble} {unit}: no samples; if {text} is in another unit, write '; unit=' behind it"
        if "s old" in trouble:
            return f"{trouble}: no samples; the stamps of {text} are behind this machine's clock"
        return f"{name}: {trouble}; no samples" if trouble else ""

    def _late(self, now: float) -> bool:
        waited = self.values["wait_timeout"]
        return bool(waited) and now > self._begun + waited

    def _tell(self, about: str, level: Level, text: str) -> None:
        if text:
            self.health.complain(about, level, text)
        else:
            self.health.withdraw(about)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def _ahead(topic: str, nanos: int) -> str:
    return f"the stamps of {topic} are {nanos / 1e9:.1f} s ahead of this machine's clock; its own is taken"


def main() -> None:
    """Console script."""
    sys.exit(run([SamplerNode, Keeper]))


if __name__ == "__main__":
    main()
