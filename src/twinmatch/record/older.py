"""Convert recorded trees of this and earlier versions to one form, so that they can be compared."""

from __future__ import annotations

import math
from typing import Any

from twinmatch.record.tree import Tree

__all__ = ["comparable"]

RENAMED = {
    "residual_y": "driven_rms_y",
    "residual_u": "closed_rms_u",
    "held_back_fit_y": "held_back_y",
    "held_back_fit_u": "held_back_u",
}
"""Earlier names of fields, and their current names."""

BY_RESIDUALS = ("level", "nominal", "decided", "certainty", "order", "candidates", "nu_gap")
"""Fields that followed other rules before verdicts had a leader: structures were not candidates then, and the
level was computed from the residuals of the nominal twin."""


def comparable(tree: Tree) -> Tree:
    """The tree with current field names, and every named value under its own name."""
    if {"level", "candidates"} <= tree.keys() and "leader" not in tree:
        tree = {name: value for name, value in tree.items() if name not in BY_RESIDUALS}
    tree = {RENAMED.get(name, name): _inside(value) for name, value in tree.items()}
    if {"plant", "names", "values"} <= tree.keys():
        held = dict(zip(tree["names"], tree["values"], strict=True))
        # Before structures had names, the values implied the structure.
        structure = {"structure": tree["structure"]} if tree["structure"] or not held else {}
        return {"plant": tree["plant"], **structure, **held}
    if "seebeck" in tree:  # the rig-specific message, before other plants were supported
        absent = math.isnan(tree["seebeck"])
        return {"plant": "", "structure": ""} if absent else {"plant": "peltier", **tree}
    if "start_values" in tree:
        tree["starts"] = dict(zip(tree["starts"], tree.pop("start_values"), strict=True))
    if "sink_start" in tree:
        sink = tree.pop("sink_start")
        tree["starts"] = {} if math.isnan(sink) else {"sink": sink}
    return tree


def _inside(value: Any) -> Any:
    if isinstance(value, dict):
        return comparable(value)
    return [_inside(item) for item in value] if isinstance(value, list) else value
