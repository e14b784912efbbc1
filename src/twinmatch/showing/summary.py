"""The summary of a judged session: in figures, in one sentence, as closing lines and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.offline.summary import SessionSummary, ShownTwin
from twinmatch.record import document_of, finite
from twinmatch.showing.quantities import parameter_format, percent, signal_names
from twinmatch.twin import MatchReport

MAX_FAULTS: Final = 5
"""Most faults in the closing lines: the newest."""
_POOR: Final = 0.5
"""A fit over the whole session below this needs an explanation beside forecasts that hold."""


def sentence(summary: SessionSummary) -> str:
    """The summary in one line: leader, fit, trust, and nominal candidate."""
    if summary.leader is None and summary.nominal is None:
        if summary.level is TrustLevel.FAULT:
            return f"No nominal twin: {summary.why}. Look at the plant first."
        if summary.refusal:
            last = f"{summary.refusal[0].upper()}{summary.refusal[1:].rstrip('.')}."
            return f"No nominal twin: {summary.verdicts} verdicts, but no valid match. {last}"
        needed = "The loop needs set-point steps far above the noise, some minutes apart."
        if not summary.closed:
            needed = "The input has to move far above its noise, for some minutes in total."
        return f"No nominal twin: {summary.verdicts} verdicts, but no valid match. {needed}"
    parts = [_who(summary)]
    if math.isfinite(summary.fit_y):
        output = signal_names(summary.parameters.model.plant).output.name if summary.parameters else "output"
        fit = f"{output} fit {percent(summary.fit_y)} %"
        if summary.fit_y < _POOR and summary.level is TrustLevel.TRUSTED and summary.range:
            fit = f"left without readings it drifts off ({fit}), from the newest readings it forecasts well"
        parts.append(fit)
    return f"{'; '.join([*parts, _trust(summary)])}.{_center(summary)}"


def _who(summary: SessionSummary) -> str:
    """The leader, or the nominal candidate without one."""
    if summary.leader is None:
        return f"Nominal: {_match(summary, str(summary.nominal))}{_order(summary, '; ')}"
    matched = summary.parameters and not ShownTwin(summary.leader, summary.parameters).is_structure
    name = _match(summary, summary.leader) if matched else summary.leader
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
    before = f" (it held {held})" if held else ""
    if summary.level is TrustLevel.FAULT:
        return f"do not trust it now: {summary.why}{before}"
    if summary.level is TrustLevel.DOUBTFUL:
        return f"doubtful now: {summary.why}{before}"
    if not held:
        return "how far to trust it is not known yet"
    return f"trust it {held}, but {summary.beaten}" if summary.beaten else f"trust it {held}"


def closing_lines(summary: SessionSummary, verdict: Verdict | None) -> list[str]:
    """The last lines of a run: notes, the meaning of leader and nominal, the plant's structure, the summary.

    `verdict` is the last one.
    """
    lines = [f"Note: {note}" for note in summary.notes]
    if verdict is not None:
        if verdict.leader is not None:
            text = "The leader is the twin to ask what comes next, the nominal one the centre of the family."
            lines.append(text)
        if verdict.certainty:
            lines.append(f"Certainty: {verdict.certainty}.")
        if verdict.structure:
            lines.append(f"Structure: the samples justify {verdict.structure}{_plant(verdict)}.")
    if summary.faults:
        older = len(summary.faults) - MAX_FAULTS
        before = [f"{older} before"] if older > 0 else []
        lines.append(f"Faults: {'; '.join([*before, *map(str, summary.faults[-MAX_FAULTS:])])}.")
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
            "leader_confidence": finite(summary.leader_confidence),
            "nominal": summary.nominal,
            "level": summary.level.value,
            "parameters": dict(summary.parameters) if summary.parameters else None,
            "fit": {"y": finite(summary.fit_y), "u": finite(summary.fit_u)},
            "order": summary.order,
            "range": [summary.range.low, summary.range.high] if summary.range else None,
            "sentence": sentence(summary),
            "notes": list(summary.notes),
        },
    }
