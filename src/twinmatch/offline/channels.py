"""The health of a recorded plant with several signals, channel by channel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from twinmatch.dynamics import Plant
from twinmatch.health.channels import HOUR, ChannelAlarm, ChannelMonitor
from twinmatch.offline.judging import EVERY, Watch
from twinmatch.record import finite
from twinmatch.sessions import Session

_WRITTEN: Final = ("signal", "size", "first", "flagged", "last", "reason", "rivals")
"""Fields of an alarm in a document."""


@dataclass(eq=False)
class EstimatedCourse:
    """What a sensor should have read while it was not believed; values in its unit."""

    signal: str
    text: str
    unit: str
    first: int
    """First sample."""
    wide: float
    """Half width of a band up to which the estimate is good …"""
    good: float
    """… and for how long it was to be that, s; at most an hour is looked ahead."""
    values: list[float] = field(default_factory=list)
    bands: list[float] = field(default_factory=list)
    """Half of the width that holds 90 % of what it would have read."""
    readings: list[float] = field(default_factory=list)

    @property
    def last(self) -> int:
        """Last sample."""
        return self.first + len(self.values) - 1

    def document(self) -> dict[str, Any]:
        """All of it, for JSON."""
        own = ("signal", "unit", "first", "wide", "good", "values", "bands")
        return {name: finite(getattr(self, name)) for name in own}

    def line(self, period: float) -> str:
        """When it was read through, what it should read in the end, and for how long that was good."""
        long = "at least an hour" if self.good >= HOUR else f"{self.good / 60.0:.2g} min"
        return (
            f"the twin reads through {self.text} from {self.first * period:g} to {self.last * period:g} s: "
            f"at the end it should read {self.values[-1]:.1f} ± {self.bands[-1]:.1f} {self.unit}, not "
            f"{self.readings[-1]:.1f}; good to ± {self.wide:.1f} {self.unit} for {long}"
        )


@dataclass(frozen=True, eq=False)
class ChannelHealth:
    """What a monitor said of a session."""

    session: str
    plant: type[Plant]
    period: float
    """Sample time, s."""
    samples: int
    unjudged: int
    """Samples at which the equations described the plant too badly to accuse anything."""
    alarms: tuple[ChannelAlarm, ...]
    course: dict[str, list[tuple[int, float]]]
    """Of every cause, in words: at which samples it competed, and its evidence, nats."""
    through: tuple[EstimatedCourse, ...]
    """What sensors should have read that were off or stood, in the order in which they were named."""

    def document(self) -> dict[str, Any]:
        """The alarms as dictionaries, for JSON."""
        return {
            "session": self.session,
            "plant": self.plant.name,
            "samples": self.samples,
            "unjudged": self.unjudged,
            "alarms": [
                {"fault": one.fault.value} | {name: finite(getattr(one, name)) for name in _WRITTEN}
                for one in self.alarms
            ],
            "through": [one.document() for one in self.through],
        }

    def lines(self) -> Iterator[str]:
        """The alarms in words, or that there is none."""
        if not self.alarms:
            yield f"{self.session}: health: no fault in {self.samples} samples, in none of the channels"
        if self.unjudged >= 0.01 * self.samples:
            share = f"{self.unjudged / self.samples:.0%}"
            yield f"{self.session}: health: at {share} of the samples the twin is too rough to judge by"
        for one in self.alarms:
            last = "to the end" if one.last is None else f"to {one.last * self.period:g} s"
            yield (
                f"{self.session}: health: {one.fault.value} from {one.first * self.period:g} s {last}, "
                f"reported at {one.flagged * self.period:g} s: {one.reason}"
            )
        for course in self.through:
            yield f"{self.session}: health: {course.line(self.period)}"


def channel_health(
    session: Session, plant: type[Plant], *, watch: Watch | None = None
) -> ChannelHealth | None:
    """Judge the channels of a session, sample by sample, as a live monitor would; None for a plant without
    equations of its own.

    The monitor begins with the typical parameters of the plant file, in the structure `followed` there.
    """
    name = plant.followed or next(iter(plant.structures))
    if plant.structures[name].external is not None:
        return None
    monitor = ChannelMonitor(plant.model(name).typical(), session.period)
    course: dict[str, list[tuple[int, float]]] = {}
    unjudged, through = 0, dict[tuple[str, int], EstimatedCourse]()
    for done, sample in enumerate(session.samples):
        monitor.push(sample)
        unjudged += monitor.competition.blind
        for each in monitor.found:
            if each.evidence > 0.0 and monitor.shows(each):
                called = monitor.sentences.called(each.cause)
                course.setdefault(called, []).append((sample.index, each.evidence))
        for one in monitor.estimates:
            declared = plant.outputs[one.signal]
            text = declared.text or one.signal
            own = EstimatedCourse(one.signal, text, declared.unit, one.since, one.wide, one.good)
            own = through.setdefault((one.signal, one.since), own)
            own.values.append(one.value)
            own.bands.append(one.band)
            own.readings.append(one.reading)
        if watch is not None and done % EVERY == 0:
            watch(done, len(session.samples))
    return ChannelHealth(
        session.name, plant, session.period, len(session.samples), unjudged, tuple(monitor.alarms), course,
        tuple(through.values()),
    )  # fmt: skip
