"""What verdicts say: rows, words, events and trust over time, computed once for every display."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, NamedTuple

from twinmatch.comparing import (
    ADMITTED,
    LEVEL_WORDS,
    NOWHERE,
    REFUSED,
    CandidateScore,
    OrderScore,
    TrustLevel,
    Verdict,
    number_list,
    statements_of,
)
from twinmatch.description import Quantity
from twinmatch.fitting import Status
from twinmatch.health import EstimatedReading
from twinmatch.health.faults import HOUR
from twinmatch.offline.summary import nominal_score
from twinmatch.showing.family import GAIN, GAP_NOW, GAP_SUM, chosen_score
from twinmatch.showing.quantities import number, percent, shown_signals
from twinmatch.signals import Sample, time_text
from twinmatch.twin import MatchReport

STATUS_WORDS: Final = {
    Status.NOT_EXPLAINED: "the twin cannot explain it",
    Status.NO_EXCITATION: "too little moved in its window",
    Status.DID_NOT_CONVERGE: "the fit did not converge",
    Status.BOUNDS_HIT: "a parameter reached its bound",
    Status.NOT_IDENTIFIABLE: "the window does not determine the parameters",
    Status.NOT_BETTER: "no better than the candidate it would replace",
}
"""Why the gate refused a match, in words."""


def last_verdict(verdicts: Sequence[Verdict]) -> Verdict | None:
    """The last verdict; None without one, or if it has no candidate."""
    return verdicts[-1] if verdicts and verdicts[-1].candidates else None


def _of_nominal(verdict: Verdict, write: Callable[[CandidateScore], str]) -> str:
    nominal = nominal_score(verdict)
    return write(nominal) if nominal else number(None)


def _of_order(verdict: Verdict, write: Callable[[OrderScore], str]) -> str:
    score = (nominal := nominal_score(verdict)) and chosen_score(nominal)
    return write(score) if score else number(None)


def _decided(verdict: Verdict) -> str:
    """Whether the data show which twin forecasts best; a dash without a leader."""
    if verdict.leader is None:
        return number(None)
    return "yes" if verdict.decided else "no"


def _why(verdict: Verdict) -> str:
    """Why forecasts are doubtful; of a verdict with a fault, whose name precedes it, its own reason."""
    is_of_forecasts = verdict.level is TrustLevel.DOUBTFUL and not verdict.fault
    return statements_of(verdict).trust.reason if is_of_forecasts else verdict.reason


class VerdictColumn(NamedTuple):
    """A column of verdicts on the terminal and in lines."""

    text: Callable[[Verdict, float], str]
    """The cell of a verdict, for a sampling period in s."""
    width: int = 0
    """Its width in a plain line, which has 120 characters with the longest name of two parts; 0: nothing
    follows it there."""


COLUMNS: Final[dict[str, VerdictColumn]] = {
    "t / s": VerdictColumn(lambda v, period: time_text(v.sample, period), 6),
    "level": VerdictColumn(lambda v, _: v.level.value, 8),
    "decided": VerdictColumn(lambda v, _: _decided(v), 7),
    "order": VerdictColumn(lambda v, _: _of_order(v, lambda score: score.order), 5),
    GAIN.label: VerdictColumn(
        lambda v, _: _of_order(v, lambda score: GAIN.text(score.total)), 5
    ),
    GAP_SUM.label: VerdictColumn(lambda v, _: _of_nominal(v, GAP_SUM.text), 7),
    GAP_NOW.label: VerdictColumn(lambda v, _: _of_nominal(v, GAP_NOW.text), 9),
    "miss y / half band": VerdictColumn(lambda v, _: number(v.miss_y), 6),
    "miss u / half band": VerdictColumn(lambda v, _: number(v.miss_u), 6),
    "nominal": VerdictColumn(lambda v, _: v.nominal or number(None), 8),
    "leader": VerdictColumn(lambda v, _: v.leader or number(None)),
    "why": VerdictColumn(lambda verdict, _: _why(verdict)),
}
"""The columns of verdicts by their headings.

The misses are those of the leader, in half widths of its bands, of several outputs or inputs the largest;
order, gain and ν-gaps those of the nominal candidate.
"""


def row(verdict: Verdict, period: float = 1.0) -> dict[str, str]:
    """The cells of one verdict by their headings; `period` is the sample time, s."""
    return {name: column.text(verdict, period) for name, column in COLUMNS.items()}


def missed(verdict: Verdict) -> str:
    """How far the newest samples are from the forecast, in half widths of the band."""
    if math.isnan(verdict.miss_y):
        return LEVEL_WORDS[TrustLevel.UNKNOWN]
    names = ["output", "control"]
    if verdict.forecasts and verdict.plant is not None:
        names = [signal.name for signal in shown_signals(verdict.plant)]
    misses = zip(names, verdict.misses, strict=False)  # given inputs have none
    parts = [
        f"{name} {number(miss, 1)}" for name, miss in misses if not math.isnan(miss)
    ]
    return f"{number_list(parts)} half band widths from the forecast"


def estimate_words(
    estimate: EstimatedReading, quantity: Quantity, period: float
) -> str:
    """What a sensor that is not believed should read, and for how long yet that is known well enough.

    `period` is the sample time, s.
    """
    time_left = estimate.good - (estimate.sample - estimate.since) * period
    good = (
        "no longer good" if time_left <= 0.0 else f"good for {time_left / 60.0:.2g} min"
    )
    good = "good for at least an hour" if time_left >= HOUR else good
    value, band, wide, reading = (
        number(figure, 1)
        for figure in (estimate.value, estimate.band, estimate.wide, estimate.reading)
    )
    estimated = f"the twin reads through {quantity.text or quantity.name}: {value} ± {band} {quantity.unit}".rstrip()
    return f"{estimated} instead of {reading}, to ± {wide} {good}"


def trust_by_signal(verdict: Verdict | None) -> list[dict[str, str]]:
    """How far to trust the leader's forecasts of each signal of a plant with several loops: texts by their
    headings. Empty for a single loop, whose figures are those of the verdict."""
    plant = None if verdict is None else verdict.plant
    if verdict is None or plant is None or plant.single:
        return []
    ahead = f"at {number_list(verdict.horizons)} s"

    def shares(of_horizons: Sequence[float]) -> str:
        return ", ".join(percent(share, 0) for share in of_horizons)

    return [
        {
            "signal": plant.called(score.signal),
            "trusted / s ahead": number_list(score.trusted)
            if score.trusted
            else NOWHERE,
            f"held {ahead} / %": shares(score.coverage),
            f"better than no change {ahead} / %": shares(score.persistence_skill),
            f"better than ARX {ahead} / %": shares(score.arx_skill),
            "miss / half band": number(score.miss),
            "newest within band / %": percent(score.inside, 0),
        }
        for score in verdict.signals
    ]


def leader_words(verdict: Verdict) -> str:
    """The leader, its confidence, and the characters its forecasts have saved."""
    if verdict.leader is None:
        return "none yet"
    gain = verdict.leading.gain if verdict.leading else math.nan
    saved = (
        ""
        if math.isnan(gain)
        else f", its forecasts save {number(gain, 1)} characters each"
    )
    return f"{verdict.leader} (confidence {number(verdict.leader_confidence)}){saved}"


def admitted(verdicts: Iterable[Verdict]) -> frozenset[int]:
    """Samples whose match was admitted to the family, including candidates dropped since."""
    return frozenset(v.sample for v in verdicts if v.match == ADMITTED)


def match_word(report: MatchReport, verdicts: Sequence[Verdict]) -> str:
    """The result of a match, in words; empty before its verdict."""
    verdict = next((v for v in verdicts if v.sample == report.sample and v.match), None)
    if verdict is None:
        return ""
    why = STATUS_WORDS.get(report.match.status) if verdict.match == REFUSED else None
    return f"{verdict.match}: {why}" if why else verdict.match


def refusal(verdict: Verdict) -> str:
    """Why a match was refused, or admitted."""
    return verdict.reason.removeprefix("match refused: ")


class News:
    """Distinguishes verdicts that say something new from those that repeat the last one."""

    def __init__(self) -> None:
        """Start before the first verdict."""
        self._last: tuple[TrustLevel, str, str | None, str | None, bool] | None = None

    def is_new(self, verdict: Verdict) -> bool:
        """True if models were identified, a match was refused, or level, fault, leader, nominal or `decided`
        changed."""
        content = (
            verdict.level,
            verdict.fault,
            verdict.leader,
            verdict.nominal,
            verdict.decided,
        )
        changed = content != self._last
        self._last = content
        return changed or not verdict.stands or bool(verdict.match)


class EventKind(Enum):
    """Kind of an event."""

    ADMITTED = "match admitted"
    REFUSED = "match refused"
    DISMISSED = "candidate dismissed"
    LEADER = "leader"
    NOMINAL = "nominal"
    LEVEL = "trust"
    FAULT = "fault"
    NODE = "node"


class Mark(Enum):
    """How good or bad an event is."""

    GOOD = "good"
    NOTE = "note"
    WARNING = "warning"
    BAD = "bad"


_LEVEL_MARKS: Final = {
    TrustLevel.UNKNOWN: Mark.NOTE,
    TrustLevel.TRUSTED: Mark.GOOD,
    TrustLevel.DOUBTFUL: Mark.WARNING,
    TrustLevel.FAULT: Mark.BAD,
}
_MATCH_EVENTS: Final = {
    ADMITTED: (EventKind.ADMITTED, Mark.GOOD),
    REFUSED: (EventKind.REFUSED, Mark.WARNING),
}


@dataclass(frozen=True)
class Event:
    """Something that happened at one sample."""

    sample: int | None
    """None: before the first sample of a live graph."""
    kind: EventKind
    title: str
    """A few words."""
    why: str
    """One sentence; may be empty."""
    mark: Mark
    session: int = 1
    """Which of a live page's sessions it belongs to."""
    after: float = 0.0
    """Seconds from the sample to the event; negative: it was before the sample."""

    stamp: int | None = None
    """When it happened, ns by the clock of the samples' stamps; None: not known."""

    def dated(self, near: Sample) -> Event:
        """The event with its time, if it has a stamp, counted from a sample near it."""
        if self.stamp is None:
            return self
        return replace(self, sample=near.index, after=(self.stamp - near.stamp) / 1e9)

    def time(self, period: float) -> float | None:
        """When it happened, s from sample 0 for a sampling period in s; None before the first sample."""
        return None if self.sample is None else self.sample * period + self.after


def events(verdicts: Iterable[Verdict]) -> list[Event]:
    """All events of the verdicts, in order of time."""
    listed: list[Event] = []
    before: Verdict | None = None
    for verdict in verdicts:
        listed += events_since(before, verdict)
        before = verdict
    return listed


def events_since(before: Verdict | None, verdict: Verdict) -> list[Event]:
    """The events of one verdict, given the one before it."""
    listed: list[Event] = []

    def add(kind: EventKind, mark: Mark, title: str, why: str) -> None:
        listed.append(Event(verdict.sample, kind, title, why, mark))

    if verdict.match:
        kind, mark = _MATCH_EVENTS[verdict.match]
        add(kind, mark, kind.value, refusal(verdict))
    for name in verdict.dismissed:
        why = "the fault was present in its window"
        add(EventKind.DISMISSED, Mark.WARNING, f"{name} dismissed", why)
    leader, nominal = (before.leader, before.nominal) if before else (None, None)
    if verdict.leader not in {leader, None}:
        why = (
            f"its forecasts are better than those of {leader}"
            if leader
            else "the first with forecasts"
        )
        add(EventKind.LEADER, Mark.NOTE, f"{verdict.leader} leads", why)
    if verdict.nominal not in {nominal, None}:
        why = f"previously {nominal}" if nominal else "the first candidate"
        add(EventKind.NOMINAL, Mark.NOTE, f"{verdict.nominal} is nominal", why)
    level = (before.level, before.fault) if before else (TrustLevel.UNKNOWN, "")
    if (verdict.level, verdict.fault) != level:
        faulty = verdict.fault or verdict.level is TrustLevel.FAULT
        kind = EventKind.FAULT if faulty else EventKind.LEVEL
        add(kind, _LEVEL_MARKS[verdict.level], *_level_event(verdict))
    return listed


def _level_event(verdict: Verdict) -> tuple[str, str]:
    """Title and reason of a change of level or fault."""
    trust, fault, _ = statements_of(verdict)
    if fault is not None:
        since = "" if fault.since is None else f" (since sample {fault.since})"
        return f"fault: {fault.called}", f"{fault.reason}{since}"
    distance = "" if trust.missed_since is None else f": {missed(verdict)}"
    return trust.level.value, f"{trust.reason}{distance}"
