"""The health of a recorded plant with several signals, channel by channel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from twinmatch.dynamics import Plant
from twinmatch.health import EstimatedReading
from twinmatch.health.channels import ChannelAlarm, ChannelMonitor
from twinmatch.offline.estimates import EstimatedCourse, courses_of
from twinmatch.offline.judging import EVERY, Watch
from twinmatch.record import finite
from twinmatch.sessions import Session

_WRITTEN: Final = ("signal", "size", "first", "flagged", "last", "reason", "rivals")
"""Fields of an alarm in a document."""


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
    """By cause, in words: the samples at which it competed, each with its evidence, nats."""
    through: tuple[EstimatedCourse, ...]
    """Of sensors that were off or stood, what they should have read, in the order of their beginnings."""

    def document(self) -> dict[str, Any]:
        """The alarms as dictionaries, for JSON."""
        return {
            "session": self.session,
            "plant": self.plant.name,
            "samples": self.samples,
            "unjudged": self.unjudged,
            "alarms": [
                {"fault": alarm.fault.value} | {name: finite(getattr(alarm, name)) for name in _WRITTEN}
                for alarm in self.alarms
            ],
            "through": [alarm.document() for alarm in self.through],
        }

    def lines(self) -> Iterator[str]:
        """The alarms in words, or that there is none."""
        if not self.alarms:
            yield f"{self.session}: health: no fault in {self.samples} samples, in none of the channels"
        if self.unjudged >= 0.01 * self.samples:
            share = f"{self.unjudged / self.samples:.0%}"
            yield f"{self.session}: health: at {share} of the samples the twin is too rough to judge by"
        for alarm in self.alarms:
            last = "to the end" if alarm.last is None else f"to {alarm.last * self.period:g} s"
            yield (
                f"{self.session}: health: {alarm.fault.value} from {alarm.first * self.period:g} s {last}, "
                f"reported at {alarm.flagged * self.period:g} s: {alarm.reason}"
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
    unjudged = 0
    estimates = list[EstimatedReading]()
    for count, sample in enumerate(session.samples):
        monitor.push(sample)
        unjudged += monitor.competition.blind
        for finding in monitor.suspects:
            if finding.evidence > 0.0 and monitor.shows(finding):
                called = monitor.sentences.called(finding.cause)
                course.setdefault(called, []).append((sample.index, finding.evidence))
        estimates += monitor.estimates
        if watch is not None and count % EVERY == 0:
            watch(count, len(session.samples))
    return ChannelHealth(
        session.name,
        plant,
        session.period,
        len(session.samples),
        unjudged,
        tuple(monitor.alarms),
        course,
        courses_of(estimates, plant),
    )
