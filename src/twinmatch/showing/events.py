"""The events of a session as a time line: matches, changes of leader, nominal and trust level, faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from twinmatch.comparing import ADMITTED, REFUSED, TrustLevel, Verdict
from twinmatch.fitting import Status
from twinmatch.showing.style import LEVEL_WORDS
from twinmatch.showing.words import missed
from twinmatch.twin import MatchReport

__all__ = [
    "STATUS_WORDS",
    "Event",
    "EventKind",
    "Stretch",
    "admitted",
    "events",
    "level_stretches",
    "match_word",
]

STATUS_WORDS = {
    Status.NOT_EXPLAINED: "the twin cannot explain it",
    Status.NO_EXCITATION: "too little moved in its window",
    Status.DID_NOT_CONVERGE: "the fit did not converge",
    Status.BOUNDS_HIT: "a parameter reached its bound",
    Status.NOT_IDENTIFIABLE: "the window does not determine the parameters",
    Status.NOT_BETTER: "no better than the candidate it would replace",
}
"""Why the gate refused a match, in words."""


class EventKind(Enum):
    """Kind of an event."""

    ADMITTED = "match admitted"
    REFUSED = "match refused"
    DISMISSED = "candidate dismissed"
    LEADER = "leader"
    NOMINAL = "nominal"
    LEVEL = "trust"
    FAULT = "fault"


@dataclass(frozen=True)
class Event:
    """Something that happened at one sample."""

    sample: int
    kind: EventKind
    title: str
    """A few words."""
    why: str
    """One sentence; may be empty."""


@dataclass(frozen=True)
class Stretch:
    """Samples with the same trust level, both ends included."""

    first: int
    last: int
    level: TrustLevel


def events(verdicts: Sequence[Verdict]) -> list[Event]:
    """All events of the verdicts, in order of time."""
    found: list[Event] = []
    nominal: str | None = None
    leader: str | None = None
    level, fault = TrustLevel.UNKNOWN, ""
    for verdict in verdicts:
        found += _match_events(verdict)
        if verdict.leader != leader and verdict.leader is not None:
            found.append(_leader_event(verdict, leader))
        if verdict.nominal != nominal and verdict.nominal is not None:
            found.append(_nominal_event(verdict, nominal))
        if (verdict.level, verdict.fault) != (level, fault):
            found.append(_level_event(verdict))
        leader, nominal = verdict.leader, verdict.nominal
        level, fault = verdict.level, verdict.fault
    return found


def admitted(verdicts: Sequence[Verdict]) -> frozenset[int]:
    """Samples whose match was admitted to the family, including candidates dropped since."""
    return frozenset(v.sample for v in verdicts if v.match == ADMITTED)


def match_word(report: MatchReport, verdicts: Sequence[Verdict]) -> str:
    """The result of a match, in words; empty before its verdict."""
    verdict = next((v for v in verdicts if v.sample == report.sample and v.match), None)
    if verdict is None:
        return ""
    why = STATUS_WORDS.get(report.match.status) if verdict.match == REFUSED else None
    return f"{verdict.match}: {why}" if why else verdict.match


def level_stretches(verdicts: Sequence[Verdict], first: int = 0) -> list[Stretch]:
    """The trust level over time: a verdict's level covers the samples since the last verdict.

    A fault begins at `fault_since`, even if there was a verdict since, and lasts until the first verdict
    without it.

    Args:
        verdicts: in order.
        first: index of the session's first sample.
    """
    stretches: list[Stretch] = []
    fault = ""
    for verdict in verdicts:
        sample, shows = max(verdict.sample, first), verdict.fault_since
        if stretches and stretches[-1].level is verdict.level:
            stretches[-1] = replace(stretches[-1], last=sample)
        else:
            if stretches and fault and not verdict.fault:
                stretches[-1] = replace(stretches[-1], last=max(sample - 1, stretches[-1].last))
            begin = stretches[-1].last + 1 if stretches else first
            if stretches and verdict.fault != fault and shows is not None and shows <= verdict.sample:
                begin = max(shows, stretches[-1].first + 1)
                stretches[-1] = replace(stretches[-1], last=begin - 1)
            stretches.append(Stretch(begin, max(sample, begin), verdict.level))
        fault = verdict.fault
    return stretches


def _match_events(verdict: Verdict) -> list[Event]:
    kind = {ADMITTED: EventKind.ADMITTED, REFUSED: EventKind.REFUSED}.get(verdict.match)
    found = [] if kind is None else [Event(verdict.sample, kind, f"match {verdict.match}", _why(verdict))]
    for name in verdict.dismissed:
        title = f"{name} dismissed"
        found.append(Event(verdict.sample, EventKind.DISMISSED, title, "the fault was present in its window"))
    return found


def _why(verdict: Verdict) -> str:
    return verdict.reason.removeprefix("match refused: ")


def _leader_event(verdict: Verdict, before: str | None) -> Event:
    why = f"its forecasts are better than those of {before}" if before else "the first with forecasts"
    return Event(verdict.sample, EventKind.LEADER, f"{verdict.leader} leads", why)


def _nominal_event(verdict: Verdict, before: str | None) -> Event:
    title = f"{verdict.nominal} is nominal"
    why = f"previously {before}" if before else "the first candidate"
    return Event(verdict.sample, EventKind.NOMINAL, title, why)


def _level_event(verdict: Verdict) -> Event:
    kind = EventKind.FAULT if verdict.fault or verdict.level is TrustLevel.FAULT else EventKind.LEVEL
    if verdict.fault:
        since = "" if verdict.fault_since is None else f" (since sample {verdict.fault_since})"
        return Event(verdict.sample, kind, f"fault: {verdict.fault}", f"{verdict.reason}{since}")
    why = LEVEL_WORDS[verdict.level]
    if verdict.level in {TrustLevel.DOUBTFUL, TrustLevel.FAULT}:
        why += f": {missed(verdict)}"
    return Event(verdict.sample, kind, verdict.level.value, why)
