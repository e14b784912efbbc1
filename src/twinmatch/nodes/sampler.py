"""Samples a loop that foreign programs run: their topics in, `plant/sample` out. It commands nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

from twinmatch.ending import end_in_order
from twinmatch.nodes.foreign_topics import ForeignTopics
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import sample_message
from twinmatch.nodes.node import Missed, Readers, TwinmatchNode
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Setting
from twinmatch.parameters.sampler import (
    listener_of,
    sampler_table,
    source_of,
    types_of,
    understood,
)
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.listener import SEARCH
from twinmatch.sampling.sampler import TIMER
from twinmatch_msgs.msg import LoopSample


class SamplerNode(TwinmatchNode):
    """Listens to the mapped places and publishes a sample for each tick of the loop.

    At the start, a topic without publisher, a missing field or an incompatible unit ends the node with one
    error line. Once sampling has started, the node waits for a rig that falls silent.
    """

    NAME = "sampler"
    CLOSING: ClassVar = 3
    PARAMETERS: ClassVar = sampler_table()

    @classmethod
    def table_for(
        cls, overrides: Mapping[str, Any]
    ) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The parameters for the selected plant."""
        return understood(cls.NAME, overrides)

    def read_parameters(self) -> None:
        """Create the listener."""
        self._plant = find_plant(self.values["plant"])
        self._types = types_of(self.NAME, self.values["types"])
        self._listener = listener_of(
            self.NAME, self.values, lambda: int(self.get_clock().now().nanoseconds)
        )

    def open(self) -> None:
        """Start to search for the topics."""
        listener = self._listener
        period = self.values["period"]
        self._publisher = self.create_publisher(LoopSample, "plant/sample", RELIABLE)
        listener.open(
            source_of(self.values) or partial(ForeignTopics, self, types=self._types)
        )
        self._missed = Missed(self.health, "the loop paused: ")
        self._readers = Readers(
            self, self._publisher.topic_name, self.values["readers_timeout"]
        )
        self._index = -1
        self._first: int | None = None
        """The sampler's index of the first published sample, which is published as sample 0."""
        self.wall_timer(SEARCH, self._on_search)
        self.create_timer(listener.interval, self._on_check)
        if self.values["paced_by"] == TIMER:
            self.create_timer(period, listener.tick)
        self.health.say("waiting for topics")
        self.report_on()

    def close(self) -> bool:
        """End the source."""
        return end_in_order(self._listener.close, super().close)

    def report(self) -> Report:
        """Each signal's value and counts, and the reason if there are no samples."""
        listener = self._listener
        sampler = self._listener.sampler
        level = Level.ERROR if self._index >= 0 or listener.late else Level.WARN
        simulated = self.get_parameter("use_sim_time").value
        for name in listener.channels:
            counts = sampler.counts[name]
            newest = sampler.newest(name)
            self.health.set(name, "none yet" if newest is None else f"{newest:g}")
            self.health.set(
                f"{name}: missing, late, out of range, not a number",
                f"{counts.missing}, {counts.late}, {counts.beyond}, {sampler.refused(name)}",
            )
            self.health.set(
                f"{name}: values that could not be read", listener.refusals[name].count
            )
            text = listener.trouble(name)
            if "lag behind" in text and not simulated:
                text = f"{text}; if they are in simulated time, set use_sim_time"
            self.health.flag_if(bool(text), name, level, text)
        for name, text in listener.misnamed.items():
            self.health.flag(f"{name}: names", Level.ERROR, text)
        self.health.flag_if(bool(listener.ahead), "stamps", Level.WARN, listener.ahead)
        timeless = simulated and not self.get_clock().now().nanoseconds
        text = "use_sim_time is set, but there is no time on /clock; start what publishes it"
        self.health.flag_if(bool(timeless), "clock", level, text)
        pace = sampler.troubles.get("pace", "")
        self.health.flag_if(bool(pace), "pace", level, pace)
        for line in listener.news():
            self.get_logger().warning(line)
        self.health.set("messages sent again at once", sampler.repeated)
        self.health.set("missed ticks", sampler.grid.missed)
        self.health.set("ticks without sample", sampler.idle)
        self.health.set("tick late by", f"{sampler.grid.jitter / 1e6:.1f} ms")
        return super().report()

    def _on_search(self) -> None:
        self._listener.search()
        if self._listener.failed is not None:
            self.failed = SamplingError(f"{self.NAME}: {self._listener.failed}")

    def _on_check(self) -> None:
        for sample in self._listener.samples():
            if self._readers.there():
                if self._first is None:
                    self._first = sample.index
                self._index = sample.index - self._first
                self._publisher.publish(
                    sample_message(replace(sample, index=self._index), self._plant.name)
                )
                self.health.set("sample", self._index)
                self.health.say("sampling")
        self._missed.watch(self._listener.sampler.grid.missed, self._index)
