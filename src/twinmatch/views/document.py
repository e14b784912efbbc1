"""Verdicts as plain dictionaries, for JSON: the shape other programs read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from twinmatch.discrimination import CandidateScore, Criteria, OrderScore, Verdict
from twinmatch.dynamics import Parameters
from twinmatch.matching import Match
from twinmatch.twin import MatchReport
from twinmatch.views.intervals import interval, value_of
from twinmatch.views.summary import Summary, sentence

__all__ = ["document", "match_entry", "parameters_entry", "verdict_entry"]


def document(
    session: str, verdicts: Sequence[Verdict], summary: Summary, matches: Sequence[MatchReport] = ()
) -> dict[str, Any]:
    """A whole judged session; every value is a string, finite number, boolean, None, list or dict."""
    return {
        "session": session,
        "matches": [match_entry(m) for m in matches],
        "verdicts": [verdict_entry(v) for v in verdicts],
        "summary": {
            "nominal": summary.nominal,
            "level": summary.level.value,
            "parameters": parameters_entry(summary.parameters) if summary.parameters else None,
            "fit": {"y": _finite(summary.fit_y), "u": _finite(summary.fit_u)},
            "order": summary.order,
            "range": [summary.range.low, summary.range.high] if summary.range else None,
            "sentence": sentence(summary),
            "notes": list(summary.notes),
        },
    }


def verdict_entry(verdict: Verdict) -> dict[str, Any]:
    """One verdict."""
    return {
        "sample": verdict.sample,
        "window": [verdict.first, verdict.last],
        "level": verdict.level.value,
        "stands": verdict.stands,
        "nominal": verdict.nominal,
        "reason": verdict.reason,
        "match": verdict.match,
        "dismissed": list(verdict.dismissed),
        "decided": verdict.decided,
        "certainty": verdict.certainty,
        "fault": verdict.fault,
        "fault_since": verdict.fault_since,
        "structure": verdict.structure,
        "structure_parameters": (
            parameters_entry(verdict.structure_parameters) if verdict.structure_parameters else None
        ),
        "decimals": verdict.decimals,
        "driven_rms_y": _finite(verdict.driven_rms_y),
        "closed_rms_u": _finite(verdict.closed_rms_u),
        "candidates": [_candidate_entry(c) for c in verdict.candidates],
        "order": verdict.order,
        "nu_gap": [list(row) for row in verdict.nu_gap],
    }


def match_entry(report: MatchReport) -> dict[str, Any]:
    """One match, accepted or refused, with how well its window knows each fitted parameter."""
    match = report.match
    return {
        "sample": report.sample,
        "operating_point": report.operating_point,
        "window": list(match.samples),
        "status": match.status.value,
        "reason": match.reason,
        **_model_entry(match.parameters),
        "fit": {"y": _finite(match.fit.y), "u": _finite(match.fit.u)},
        "fitted": [_fitted_entry(match, name) for name in match.free],
        "determined": match.determined,
        "suggestion": match.suggestion,
    }


def _fitted_entry(match: Match, name: str) -> dict[str, Any]:
    """A fitted parameter in its own unit; an end of the interval that is open or not known is None."""
    known = interval(match, name)
    return {
        "name": name,
        "value": _finite(value_of(match, name)),
        "standard_error": _finite(known.error),
        "interval": [_finite(known.low), _finite(known.high)],
        "profile": known.profile,
        "believed": name in match.believed,
    }


def parameters_entry(parameters: Parameters) -> dict[str, float]:
    """The values by name, in the parameters' own units."""
    return dict(parameters)


def _model_entry(parameters: Parameters) -> dict[str, Any]:
    model = parameters.model
    return {
        "plant": model.plant.name,
        "structure": model.structure_name,
        "parameters": parameters_entry(parameters),
    }


def _candidate_entry(candidate: CandidateScore) -> dict[str, Any]:
    return {
        "name": candidate.name,
        "operating_point": candidate.operating_point,
        "window": [candidate.first, candidate.last],
        **_model_entry(candidate.parameters),
        "orders": [_order_entry(o) for o in candidate.orders],
        "chosen_order": candidate.chosen_order,
        "nu_gap_sum": candidate.nu_gap_sum,
        "nu_gap_to_plant": candidate.nu_gap_to_plant,
        "nu_gap_sum_interval": [_finite(candidate.nu_gap_sum_low), _finite(candidate.nu_gap_sum_high)],
        "nu_gap_low": list(candidate.nu_gap_low),
        "nu_gap_high": list(candidate.nu_gap_high),
        "nominal_probability": _finite(candidate.nominal_probability),
        "margin": candidate.margin,
        "plant_gap_to_nominal": candidate.plant_gap_to_nominal,
        "newest_gain": candidate.newest.gain if candidate.newest else None,
    }


def _order_entry(order: OrderScore) -> dict[str, Any]:
    outputs: dict[str, Criteria] = {"y": order.y, "u": order.u, "total": order.total}
    names = {
        "trivial_length": "trivial_length",
        "model_length": "model_length",
        "information_gain": "gain",
        "explanation": "explanation",
        "naic": "naic",
        "bic": "bic",
        "mdl": "mdl",
        "two_part_length": "two_part_length",
    }
    entry: dict[str, Any] = {
        "order": order.order,
        "aic_difference": _finite(order.aic_difference),
        "weight": _finite(order.weight),
    }
    for key, attribute in names.items():
        entry[key] = {output: _finite(getattr(criteria, attribute)) for output, criteria in outputs.items()}
    return entry


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
