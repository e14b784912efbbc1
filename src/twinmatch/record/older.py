"""Recorded trees of this version and of those before, brought to one form so that they can be compared."""

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
"""Fields that were called otherwise before."""

BY_RESIDUALS = ("level", "nominal", "decided", "certainty", "order", "candidates", "nu_gap")
"""What a verdict said by other rules before it had a leader: structures were no candidates, and residuals of
the nominal twin made the level."""


def comparable(tree: Tree) -> Tree:
    """The tree under today's names, with every named value under its own name."""
    if {"level", "candidates"} <= tree.keys() and "leader" not in tree:
        tree = {name: value for name, value in tree.items() if name not in BY_RESIDUALS}
    tree = {RENAMED.get(name, name): _inside(value) for name, value in tree.items()}
    if {"plant", "names", "values"} <= tree.keys():
        held = dict(zip(tree["names"], tree["values"], strict=True))
        # Before structures had names, the values said which parts there were.
        structure = {"structure": tree["structure"]} if tree["structure"] or not held else {}
        return {"plant": tree["plant"], **structure, **held}
    if "seebeck" in tree:  # the rig's own message, before there were other plants
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
