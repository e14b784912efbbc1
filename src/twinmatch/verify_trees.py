"""Verdicts and matches as trees of plain values, from a recorded message and from the core.

A tree has the fields of the message; its header is the one value `stamp` (ns), parameters and starts have one
value under each name, and the numbers beside `level_name` and `status_name` are left out. Fields that
recordings of an older form have under another name get today's. This is what the nodes' messages say,
written down a second time for machines without ROS 2; a test compares it with them.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any

from twinmatch.discrimination import Criteria, Verdict
from twinmatch.dynamics import Parameters
from twinmatch.plants.named import named
from twinmatch.twin import MatchReport

__all__ = ["Tree", "differences", "match_tree", "message_tree", "verdict_tree"]

Tree = dict[str, Any]

_NUMBER = re.compile(r"\[\d+\]")

NANOSECONDS = 1_000_000_000
NAMED = ("level", "status")
RIG = "peltier"
"""The plant of all sessions from before there were others."""
RENAMED = {"residual_y": "driven_rms_y", "residual_u": "closed_rms_u"}
"""Fields that were called otherwise before."""
CRITERIA = ("trivial_length", "model_length", "gain", "explanation", "naic", "bic", "mdl", "two_part_length")


def message_tree(message: Any) -> Tree:
    """A decoded message as a tree."""
    tree: Tree = {}
    for name in message.__slots__:
        value = getattr(message, name)
        if name == "header":
            tree["stamp"] = value.stamp.sec * NANOSECONDS + value.stamp.nanosec
        elif name not in NAMED:
            tree[RENAMED.get(name, name)] = _plain(value)
    return _by_name(tree)


def _by_name(tree: Tree) -> Tree:
    """Lists of names and values as one value under each name."""
    if {"plant", "names", "values"} <= tree.keys():
        held = dict(zip(tree["names"], tree["values"], strict=True))
        return {"plant": tree["plant"], "structure": tree["structure"], **held}
    if "seebeck" in tree:  # the rig's own message, before there were other plants
        return {"plant": "", "structure": ""} if math.isnan(tree["seebeck"]) else {"plant": RIG, **tree}
    if "start_values" in tree:
        tree["starts"] = dict(zip(tree["starts"], tree.pop("start_values"), strict=True))
    if "sink_start" in tree:
        sink = tree.pop("sink_start")
        tree["starts"] = {} if math.isnan(sink) else {"sink": sink}
    return tree


def verdict_tree(verdict: Verdict, stamp: int) -> Tree:
    """The tree of `ModelScore` that a verdict on a sample of this stamp (ns) makes."""
    return {
        "stamp": stamp,
        "sample": verdict.sample,
        "first": verdict.first,
        "last": verdict.last,
        "level_name": verdict.level.value,
        "stands": verdict.stands,
        "nominal": verdict.nominal or "",
        "reason": verdict.reason,
        "match": verdict.match,
        "dismissed": list(verdict.dismissed),
        "decided": verdict.decided,
        "certainty": verdict.certainty,
        "fault": verdict.fault,
        "fault_since": -1 if verdict.fault_since is None else verdict.fault_since,
        "structure": verdict.structure,
        "structure_parameters": _parameters_tree(verdict.structure_parameters),
        "decimals": verdict.decimals,
        "candidates": [_candidate_tree(verdict, row) for row in range(len(verdict.candidates))],
        "order": verdict.order or "",
        "nu_gap": [value for row in verdict.nu_gap for value in row],
        "driven_rms_y": verdict.driven_rms_y,
        "closed_rms_u": verdict.closed_rms_u,
    }


def match_tree(report: MatchReport, stamp: int) -> Tree:
    """The tree of `Match` that a match set off by a sample of this stamp (ns) makes."""
    match = report.match
    return {
        "stamp": stamp,
        "sample": report.sample,
        "first": match.samples[0],
        "last": match.samples[1],
        "operating_point": report.operating_point,
        "status_name": match.status.value,
        "reason": match.reason,
        "parameters": _parameters_tree(match.parameters),
        "starts": dict(match.starts),
        "free": list(match.free),
        "covariance": match.covariance.ravel().tolist(),
        "standard_errors": match.standard_errors.tolist(),
        "fisher": match.fisher.ravel().tolist(),
        "eigenvalues": match.eigenvalues.tolist(),
        "condition": match.condition,
        "bounds_hit": list(match.bounds_hit),
        "directions": match.directions.ravel().tolist(),
        "intervals": match.intervals.ravel().tolist(),
        "believed": list(match.believed),
        "determined": match.determined,
        "suggestion": match.suggestion,
        "fit_y": match.fit.y,
        "fit_u": match.fit.u,
        "held_back_fit_y": match.held_back.y,
        "held_back_fit_u": match.held_back.u,
        "chi2": match.chi2,
    }


def differences(
    recorded: Any, computed: Any, place: str = "", apart: set[str] | None = None
) -> Iterator[tuple[str, Any, Any]]:
    """Where two trees differ in a single bit: path of the field, value in the one, value in the other.

    A field that only one of them has is a difference too, unless there is a set `apart` to note it in.
    """
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for name in (*recorded, *(name for name in computed if name not in recorded)):
            inside = f"{place}.{name}" if place else name
            if apart is not None and (name in recorded) != (name in computed):
                apart.add(_NUMBER.sub("", inside))
                continue
            yield from differences(recorded.get(name), computed.get(name), inside, apart)
    elif isinstance(recorded, list) and isinstance(computed, list) and len(recorded) == len(computed):
        for number, (one, other) in enumerate(zip(recorded, computed, strict=True)):
            yield from differences(one, other, f"{place}[{number}]", apart)
    elif not _same(recorded, computed):
        yield place, recorded, computed


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float | int):
        both_nan = math.isnan(one) and math.isnan(other)
        return both_nan or struct.pack("<d", one) == struct.pack("<d", other)
    return bool(one == other)


def _candidate_tree(verdict: Verdict, row: int) -> Tree:
    candidate = verdict.candidates[row]
    return {
        "name": candidate.name,
        "operating_point": candidate.operating_point,
        "parameters": _parameters_tree(candidate.parameters),
        "first": candidate.first,
        "last": candidate.last,
        "orders": [
            {
                "order": score.order,
                "y": _criteria_tree(score.y),
                "u": _criteria_tree(score.u),
                "total": _criteria_tree(score.total),
                "aic_difference": score.aic_difference,
                "weight": score.weight,
            }
            for score in candidate.orders
        ],
        "chosen_order": candidate.chosen_order,
        "nu_gap": list(verdict.nu_gap[row]) if verdict.nu_gap else [],
        "nu_gap_sum": candidate.nu_gap_sum,
        "nu_gap_low": list(candidate.nu_gap_low),
        "nu_gap_high": list(candidate.nu_gap_high),
        "nu_gap_sum_low": candidate.nu_gap_sum_low,
        "nu_gap_sum_high": candidate.nu_gap_sum_high,
        "nominal_probability": candidate.nominal_probability,
        "margin": _or_nan(candidate.margin),
        "plant_gap_to_nominal": _or_nan(candidate.plant_gap_to_nominal),
        "newest": _criteria_tree(candidate.newest),
        "nu_gap_to_plant": _or_nan(candidate.nu_gap_to_plant),
    }


def _parameters_tree(parameters: Parameters | None) -> Tree:
    held = named(parameters)
    return {
        "plant": held.plant,
        "structure": held.structure,
        **dict(zip(held.names, held.values, strict=True)),
    }


def _criteria_tree(criteria: Criteria | None) -> Tree:
    return {n: math.nan if criteria is None else float(getattr(criteria, n)) for n in CRITERIA}


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _plain(value: Any) -> Any:
    if hasattr(value, "__slots__"):
        return message_tree(value)
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        return [_plain(item) for item in value]
    return value
