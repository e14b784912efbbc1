"""The summary of a judged session: in one sentence, as closing lines and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from twinmatch.comparing import LEVEL_WORDS, TrustLevel, Verdict, ahead_words
from twinmatch.offline.summary import SessionSummary, ShownTwin
from twinmatch.record import documents_of, finite
from twinmatch.showing.quantities import parameter_format, percent, shown_outputs
from twinmatch.signals import time_text
from twinmatch.twin import MatchReport

MAX_FAULTS: Final = 5
"""Most faults in the sentence: the newest."""
_POOR: Final = 0.5
"""A fit over the whole session below this needs an explanation beside forecasts that hold."""


def sentence(summary: SessionSummary) -> str:
    """What the session comes down to: whom to trust, how far ahead and where, and the faults."""
    return " ".join(filter(None, (_judgement(summary), fault_words(summary))))


def _judgement(summary: SessionSummary) -> str:
    if summary.leader is None and summary.nominal is None:
        return f"No twin to trust yet: {_missing(summary)}"
    shown = summary.leader or str(summary.nominal)
    parts = [f"{'Leader' if summary.leader else 'Nominal'}: {_named(summary, shown)}"]
    parts.append(trust_words(summary))
    level = summary.trust.level
    if math.isfinite(summary.fit_y) and level is not TrustLevel.FAULT:
        outputs = (
            shown_outputs(summary.parameters.model.plant)
            if summary.parameters
            else ["output"]
        )
        fit_of_output = summary.fits.outputs if summary.fits else (summary.fit_y,)
        fit = ", ".join(
            f"{y} fit {percent(share)} %"
            for y, share in zip(outputs, fit_of_output, strict=True)
        )
        if summary.fit_y < _POOR and level is TrustLevel.TRUSTED:
            fit = f"left without readings it drifts off ({fit})"
        parts.append(fit)
    return f"{'; '.join(parts)}."


def _missing(summary: SessionSummary) -> str:
    """Why there is no twin, and what to do."""
    trust = summary.trust
    if trust.level is TrustLevel.FAULT:
        return f"{trust.reason}. Look at the plant first."
    verdicts = f"{summary.verdicts} verdicts, but no valid match."
    if summary.refusal:
        return (
            f"{verdicts} {summary.refusal[0].upper()}{summary.refusal[1:].rstrip('.')}."
        )
    if trust.reason and trust.reason != LEVEL_WORDS[TrustLevel.UNKNOWN]:
        return f"{verdicts} {trust.reason[0].upper()}{trust.reason[1:]}."
    if summary.closed:
        return f"{verdicts} The loop needs set-point steps far above the noise, some minutes apart."
    return f"{verdicts} The input has to move far above its noise, for some minutes in total."


def _named(summary: SessionSummary, name: str) -> str:
    """A twin in words; a match by its set-point, or, if the loop is not known, by the output it was near."""
    if (
        summary.parameters is not None
        and not ShownTwin(name, summary.parameters).is_match
    ):
        return name
    return f"match {'at' if summary.closed else 'near'} {name}"


def trust_words(summary: SessionSummary) -> str:
    """How far to trust the leader now: names only horizons and levels at which it passes the test."""
    trust = summary.trust
    proven = (
        f"{ahead_words(trust.horizons)} {summary.range}"
        if trust.horizons and summary.range
        else ""
    )
    if trust.level in {TrustLevel.FAULT, TrustLevel.DOUBTFUL}:
        word = (
            "doubtful now"
            if trust.level is TrustLevel.DOUBTFUL
            else "do not trust it now"
        )
        return f"{word}: {trust.reason}{f' (its forecasts held {proven})' if proven else ''}"
    if trust.level is TrustLevel.UNKNOWN or not proven:
        why = trust.reason if trust.level is TrustLevel.UNKNOWN else ""
        return f"how far to trust it is not known yet{f': {why}' if why else ''}"
    return (
        f"trust it {proven}, but {trust.doubts}"
        if trust.doubts
        else f"trust it {proven}"
    )


def fault_spans(summary: SessionSummary) -> list[str]:
    """Each fault of the session, oldest first, and when it showed."""
    faults = [stretch for stretch in summary.stretches if stretch.fault]
    spans = [
        f"{fault.fault} from {fault.fault_times(summary.period)}" for fault in faults
    ]
    if faults and faults[-1] is summary.stretches[-1]:
        begins = time_text(faults[-1].begins, summary.period)
        spans[-1] = f"{faults[-1].fault} since {begins} s"
    return spans


def fault_words(summary: SessionSummary) -> str:
    """The newest faults of the session, and when they showed; empty without any."""
    spans = fault_spans(summary)
    older = [f"{len(spans) - MAX_FAULTS} before"] if len(spans) > MAX_FAULTS else []
    return f"Faults: {'; '.join([*older, *spans[-MAX_FAULTS:]])}." if spans else ""


def closing_lines(summary: SessionSummary, verdict: Verdict | None) -> list[str]:
    """The last lines of a run: notes, the plant's structure, the summary, and below it the family.

    `verdict` is the last one.
    """
    lines = [f"Note: {note}" for note in summary.notes]
    if verdict is not None and verdict.structure:
        lines.append(
            f"Structure: the samples justify {verdict.structure}{_plant(verdict)}."
        )
    lines.append(sentence(summary))
    if summary.nominal is not None:
        order = f" (orders {summary.order})" if summary.order else ""
        name = _named(summary, summary.nominal) if summary.order else summary.nominal
        lines.append(f"Nominal, the centre of the family: {name}{order}.")
    if verdict is not None and verdict.certainty:
        lines.append(f"Certainty: {verdict.certainty}.")
    return lines


def _plant(verdict: Verdict) -> str:
    """The structure's parameters in brackets with their units; one that is 0 and not fitted is left out."""
    parameters = verdict.structure_parameters
    if parameters is None:
        return ""
    plant = parameters.model.plant
    fitted = parameters.model.structure.free
    formats_and_values = [
        (parameter_format(plant, name), parameters[name])
        for name in parameters
        if parameters[name] or name in fitted
    ]
    shown = [
        f"{q.symbol} {q.text(value)} {q.unit}".removesuffix(" 1")
        for q, value in formats_and_values
    ]
    return f" ({', '.join(shown)})"


def document(
    session: str,
    verdicts: Sequence[Verdict],
    summary: SessionSummary,
    matches: Sequence[MatchReport] = (),
) -> dict[str, Any]:
    """A whole judged session; every value is a string, finite number, boolean, None, list or dict.

    Matches and verdicts have the fields of their messages.
    """
    return {
        "session": session,
        "matches": documents_of(matches),
        "verdicts": documents_of(verdicts),
        "summary": {
            "leader": summary.leader,
            "leader_confidence": finite(summary.leader_confidence),
            "nominal": summary.nominal,
            "level": summary.trust.level.value,
            "parameters": dict(summary.parameters) if summary.parameters else None,
            "fit": finite(summary.fits.shown if summary.fits else dict.fromkeys("yu")),
            "order": summary.order,
            "range": [list(span) for span in summary.range.spans]
            if summary.range
            else [],
            "sentence": sentence(summary),
            "notes": list(summary.notes),
        },
    }
