"""A judged session as a plain dictionary, for JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from twinmatch.comparing import Verdict
from twinmatch.record import document_of, parameters_document
from twinmatch.showing.summary import Summary, sentence
from twinmatch.twin import MatchReport

__all__ = ["document"]


def document(
    session: str, verdicts: Sequence[Verdict], summary: Summary, matches: Sequence[MatchReport] = ()
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
