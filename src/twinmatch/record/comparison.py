"""Compare recorded trees bit for bit, those of earlier versions included."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any

from twinmatch.record.trees import Tree

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
        values = dict(zip(tree["names"], tree["values"], strict=True))
        # Before structures had names, the values implied the structure.
        structure = {"structure": tree["structure"]} if tree["structure"] or not values else {}
        return {"plant": tree["plant"], **structure, **values}
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


_NUMBER = re.compile(r"\[\d+\]")


def differences(
    recorded: Any, computed: Any, place: str = "", apart: set[str] | None = None
) -> Iterator[tuple[str, Any, Any]]:
    """Fields in which two trees differ, if only by a bit: path, recorded value, computed value.

    A field that only one of them has is a difference too, unless a set `apart` is given to collect it.
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
