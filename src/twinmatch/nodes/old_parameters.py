"""Parameters of the twin's nodes in earlier versions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from twinmatch.dynamics import Model
from twinmatch.nodes.parameters import ParameterError
from twinmatch.plants import Peltier
from twinmatch.plants.written import structure_of

__all__ = ["refuse_renamed", "translated", "without_absent"]

RENAMED: Final[Mapping[str, tuple[str, ...]]] = {
    "noise.temperature": ("noise.output",),
    "noise.pwm": ("noise.input",),
    "camera.noise": ("sensor.noise",),
    "camera.resolution": ("sensor.resolution",),
    "pid.limit": ("pid.low", "pid.high"),
}
_MONITOR: Final = "only the health monitor reports faults"
_BANDS: Final = "limits.doubtful sets how far beyond its bands a twin is doubtful"
GONE: Final = {
    "limits.fault_y": _MONITOR,
    "limits.fault_u": _MONITOR,
    "limits.doubtful_y": _BANDS,
    "limits.doubtful_u": _BANDS,
    "health.drift": "health.change sets the evidence needed to report a change",
}
"""Removed parameters, and their replacements."""
_START: Final = "start."


def refuse_renamed(place: str, given: Mapping[str, Any]) -> None:
    """Refuse names that are no longer used.

    Raises:
        ParameterError: a given name is no longer used.
    """
    for name, now in RENAMED.items():
        if name in given:
            msg = f"{place}: {name} is now called {' and '.join(now)}; rename it"
            raise ParameterError(msg)
    for name, instead in GONE.items():
        if name in given:
            msg = f"{place}: {name} is no longer used: {instead}; remove it"
            raise ParameterError(msg)


def without_absent(place: str, given: Mapping[str, Any], model: Model) -> dict[str, Any]:
    """The given values without zeros for what the structure lacks: earlier versions left parts out so.

    Raises:
        ParameterError: a parameter that this structure lacks has a value other than zero.
    """
    kept = dict(given)
    for name, value in given.items():
        of = name.removeprefix(_START)
        if of == name or of in model.declared or of not in model.plant.parameters:
            continue
        if value:
            plant = model.plant
            having = [s for s in plant.structures if of in plant.model(s).declared]
            msg = (
                f"{place}: parameter {name} is {value}, but structure {model.structure_name!r} has no {of}; "
                f"choose a structure that has: {', '.join(having) or 'none'}"
            )
            raise ParameterError(msg)
        del kept[name]
    return kept


def translated(given: Mapping[str, Any]) -> dict[str, Any]:
    """Recorded values under their current names."""
    kept = {name: value for name, value in given.items() if name not in {*RENAMED, *GONE}}
    for old, names in RENAMED.items():
        if old in given:
            kept |= dict.fromkeys(names, given[old])
    if "pid.limit" in given:
        kept["pid.low"] = -given["pid.limit"]
    if "structure" not in kept and kept.get("plant", Peltier.name) == Peltier.name:
        starts = {n.removeprefix(_START): v for n, v in kept.items() if n.startswith(_START)}
        kept["structure"] = structure_of(Peltier, starts)
    return kept
