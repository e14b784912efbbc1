"""The summary of a judged session: in figures, in one sentence, as closing lines and as JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from twinmatch.comparing import REFUSED, TrustLevel, Verdict
from twinmatch.dynamics import Output, Parameters, PidGains
from twinmatch.record import document_of, parameters_document
from twinmatch.showing.quantities import parameter_format, percent, signal_names
from twinmatch.showing.verdicts import ShownTwin, nominal_score, shown_twin
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import MatchReport, window_fit

__all__ = [
    "UNEXPLAINED",
    "SessionSummary",
    "Tally",
    "TrustRange",
    "closing_lines",
    "conclude",
    "document",
    "sentence",
    "summarise",
    "trust_range",
]

UNEXPLAINED = "unexplained"
"""Name in sessions of earlier versions for a fault seen only in the residuals."""


class TrustRange(NamedTuple):
    """Lowest and highest output."""

    low: float
    high: float
    unit: str
    decimals: int = 0
    """Decimal places to which the ends are rounded."""

    def __str__(self) -> str:
        """Both ends, rounded inwards."""
        steps = 10.0**self.decimals
        low, high = math.ceil(self.low * steps) / steps, math.floor(self.high * steps) / steps
        if low > high:  # the range is narrower than the rounding
            low, high = self.low, self.high
        return f"{low:.{self.decimals}f} and {high:.{self.decimals}f} {self.unit}".rstrip()


def trust_range(verdict: Verdict, output: Output) -> TrustRange | None:
    """The range in which forecasts have held, one decimal place coarser than the output; None if none has."""
    if math.isnan(verdict.held_low):
        return None
    return TrustRange(verdict.held_low, verdict.held_high, output.unit, max(0, output.decimals - 1))


@dataclass(frozen=True)
class SessionSummary:
    """State at the end of a session: leader, its fit to the whole session, and nominal candidate."""

    nominal: str | None
    level: TrustLevel
    """Of the last verdict."""
    parameters: Parameters | None
    """Of the leader; of the nominal candidate in old recordings without leaders."""
    fit_y: float
    """NRMSE fit of that twin's output over the whole session, 1 at best; NaN without candidates."""
    fit_u: float
    verdicts: int
    identified: int
    """Verdicts whose window excited the loop."""
    matches: dict[str, int]
    """How many matches were admitted, and how many refused."""
    notes: tuple[str, ...] = ()
    order: str | None = None
    """Box–Jenkins order chosen for the nominal candidate."""
    range: TrustRange | None = None
    """Range of the output in which forecasts have held."""
    fault: str = ""
    """Name of the fault present at the end; empty for none."""
    leader: str | None = None
    """The twin to ask what comes next."""
    leader_confidence: float = math.nan
    """How often its error was within 3 % of the best candidate's, 0 to 1."""
    refusal: str = ""
    """Why no match came of the last excited window that gave none; empty without one."""
    closed: bool = True
    """Whether the loop is known; otherwise the fit is that of the driven twin."""


class Tally:
    """Counts over the verdicts for a summary, updated one verdict at a time."""

    def __init__(self, verdicts: Iterable[Verdict] = ()) -> None:
        """Start with these verdicts."""
        self.last: Verdict | None = None
        self.verdicts = self.identified = 0
        self.refusal = ""
        self._matches: Counter[str] = Counter()
        for verdict in verdicts:
            self.push(verdict)

    def push(self, verdict: Verdict) -> None:
        """Take a verdict."""
        self.last = verdict
        self.verdicts += 1
        self.identified += not verdict.stands
        if verdict.match:
            self._matches[verdict.match] += 1
        if verdict.match == REFUSED:
            self.refusal = verdict.reason

    @property
    def matches(self) -> dict[str, int]:
        """How many matches were admitted, and how many refused."""
        return dict(self._matches)


def summarise(
    samples: Sequence[Sample],
    verdicts: Sequence[Verdict],
    gains: PidGains | None,
    notes: Sequence[str] = (),
    period: float = 1.0,
) -> SessionSummary:
    """Summarise a judged session; `period`, s, is used where the loop is not known."""

    def longest(period: float) -> tuple[Window, int]:
        stretches = unbroken(samples)
        return Window.from_samples(max(stretches, key=len), period), len(stretches)

    return conclude(Tally(verdicts), longest, gains, notes, period)


def conclude(
    tally: Tally,
    longest: Callable[[float], tuple[Window, int]],
    gains: PidGains | None,
    notes: Sequence[str] = (),
    period: float = 1.0,
) -> SessionSummary:
    """Summarise a session; `longest` returns its longest unbroken stretch for a sampling period (s) and the
    number of stretches, and is called only if there is a twin to compare it with."""
    last = tally.last
    nominal, shown = nominal_score(last), shown_twin(last)
    fit = (math.nan, math.nan)
    remarks = list(notes)
    if shown is not None:
        window, stretches = longest(gains.period if gains is not None else period)
        if stretches > 1:
            remarks.append(
                f"the fit is over samples {window.first} to {window.last}, "
                f"the longest of {stretches} unbroken stretches"
            )
        fit = window_fit(shown.parameters, window, gains)
    return SessionSummary(
        nominal=last.nominal if last else None,
        level=last.level if last else TrustLevel.UNKNOWN,
        parameters=shown.parameters if shown else None,
        fit_y=fit[0],
        fit_u=fit[1],
        verdicts=tally.verdicts,
        identified=tally.identified,
        matches=tally.matches,
        notes=tuple(remarks),
        order=nominal.chosen_order if nominal else None,
        range=trust_range(last, shown.parameters.model.plant.output) if last and shown else None,
        fault=last.fault if last else "",
        leader=last.leader if last else None,
        leader_confidence=last.leader_confidence if last else math.nan,
        refusal=tally.refusal,
        closed=gains is not None,
    )


def sentence(summary: SessionSummary) -> str:
    """The summary in one line: leader, fit, trust, and nominal candidate."""
    if summary.leader is None and summary.nominal is None:
        if summary.level is TrustLevel.FAULT:
            return f"No nominal twin: {_trouble(summary)}. Look at the plant first."
        if summary.refusal:
            last = f"{summary.refusal[0].upper()}{summary.refusal[1:].rstrip('.')}."
            return f"No nominal twin: {summary.verdicts} verdicts, but no valid match. {last}"
        needed = (
            "The loop needs set-point steps far above the noise, some minutes apart."
            if summary.closed
            else "The input has to move far above its noise, for some minutes in total."
        )
        return f"No nominal twin: {summary.verdicts} verdicts, but no valid match. {needed}"
    parts = [_who(summary)]
    if math.isfinite(summary.fit_y):
        output = signal_names(summary.parameters.model.plant).output if summary.parameters else "output"
        parts.append(f"{output} fit {percent(summary.fit_y)} %")
    return f"{'; '.join([*parts, _trust(summary)])}.{_center(summary)}"


def _who(summary: SessionSummary) -> str:
    """The leader, or the nominal candidate without one."""
    if summary.leader is None:
        return f"Nominal: {_match(summary, str(summary.nominal))}{_order(summary, '; ')}"
    shown = ShownTwin(summary.leader, summary.parameters) if summary.parameters else None
    known = shown is None or shown.is_structure
    name = summary.leader if known else _match(summary, summary.leader)
    if summary.leader == summary.nominal:
        return f"Leader and nominal: {name}{_order(summary, '; ')}"
    return f"Leader: {name}"


def _center(summary: SessionSummary) -> str:
    """The nominal candidate, where it is not the leader."""
    if summary.leader is None or summary.leader == summary.nominal:
        return ""
    if summary.nominal is None:
        return " Nominal: none, no valid match."
    name = _match(summary, summary.nominal) if summary.order else summary.nominal
    return f" Nominal: {name}{_order(summary, ', ')}."


def _match(summary: SessionSummary, name: str) -> str:
    """A match in words: by its set-point, or, if the loop is not known, by the output it was near."""
    return f"{name} set" if summary.closed else f"match near {name}"


def _order(summary: SessionSummary, before: str) -> str:
    """Orders of the nominal candidate; empty for a structure, which has no Box–Jenkins models."""
    return f"{before}orders {summary.order}" if summary.order else ""


def _trust(summary: SessionSummary) -> str:
    held = f"between {summary.range}" if summary.range else ""
    if summary.level is TrustLevel.FAULT:
        before = f" (it held {held})" if held else ""
        return f"do not trust it now: {_trouble(summary)}{before}"
    if summary.level is TrustLevel.DOUBTFUL:
        before = f" (it held {held})" if held else ""
        return f"doubtful now: measurements lie outside the bands{before}"
    return f"trust it {held}" if held else "how far to trust it is not known yet"


def _trouble(summary: SessionSummary) -> str:
    named = summary.fault and summary.fault != UNEXPLAINED
    return f"the plant shows {summary.fault}" if named else "no twin explains the plant's behaviour"


def closing_lines(summary: SessionSummary, verdict: Verdict | None) -> list[str]:
    """The last lines of a run: notes, the meaning of leader and nominal, the plant's structure, the summary.

    `verdict` is the last one.
    """
    lines = [f"Note: {note}" for note in summary.notes]
    if verdict is not None and verdict.leader is not None:
        lines.append(
            "The leader is the twin to ask what comes next, the nominal one the centre of the family."
        )
    if verdict is not None and verdict.certainty:
        lines.append(f"Certainty: {verdict.certainty}.")
    if verdict is not None and verdict.structure:
        lines.append(f"Structure: the samples justify {verdict.structure}{_plant(verdict)}.")
    return [*lines, sentence(summary)]


def _plant(verdict: Verdict) -> str:
    """The structure's parameters in brackets with their units; one that is 0 and not fitted is left out."""
    held = verdict.structure_parameters
    if held is None:
        return ""
    plant, fitted = held.model.plant, held.model.structure.free
    known = [(parameter_format(plant, name), held[name]) for name in held if held[name] or name in fitted]
    shown = [f"{q.symbol} {q.text(value)} {q.unit}".removesuffix(" 1") for q, value in known]
    return f" ({', '.join(shown)})"


def document(
    session: str, verdicts: Sequence[Verdict], summary: SessionSummary, matches: Sequence[MatchReport] = ()
) -> dict[str, Any]:
    """A whole judged session; every value is a string, finite number, boolean, None, list or dict.

    Matches and verdicts have the fields of their messages.
    """
    return {
        "session": session,
        "matches": [document_of(m) for m in matches],
        "verdicts": [document_of(v) for v in verdicts],
        "summary": {
            "leader": summary.leader,
            "leader_confidence": _finite(summary.leader_confidence),
            "nominal": summary.nominal,
            "level": summary.level.value,
            "parameters": parameters_document(summary.parameters) if summary.parameters else None,
            "fit": {"y": _finite(summary.fit_y), "u": _finite(summary.fit_u)},
            "order": summary.order,
            "range": [summary.range.low, summary.range.high] if summary.range else None,
            "sentence": sentence(summary),
            "notes": list(summary.notes),
        },
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
