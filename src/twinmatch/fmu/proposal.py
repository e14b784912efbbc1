"""An overview of an FMU, and a draft of its map, in which similar names are matched."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import yaml

from twinmatch.dynamics import Plant
from twinmatch.fmu.archive import CO_SIMULATION, MODEL_EXCHANGE, Described, Variable

__all__ = ["draft", "overview"]

_KELVIN: Final = 273.15
_CELSIUS: Final = ("°C", "degC")
_MOST: Final = 60
"""Most variables listed per kind."""


def overview(described: Described) -> list[str]:
    """The description and the variables, as lines of text."""
    kinds = " and ".join(described.kinds) or "no supported interface type"
    platforms = ", ".join(described.platforms) or "no platform"
    lines = [
        f"{described.name}: FMI {described.version}, {kinds}; by {described.tool or 'an unknown tool'}",
        f"binaries for {platforms}; directional derivatives: {'yes' if described.directional else 'no'}",
    ]
    for title, found in (
        ("inputs", described.of("input")),
        ("outputs", described.of("output")),
        ("continuous states", [v for v in described.variables if v.state >= 0]),
        ("parameters", described.of("parameter")),
        ("others that can be set before a run", _others(described)),
    ):
        lines.append(f"{title}: {'none' if not found else ''}".rstrip())
        lines += [f"  {_line(variable)}" for variable in found[:_MOST]]
        if len(found) > _MOST:
            lines.append(f"  and {len(found) - _MOST} more")
    return [*lines, _verdict(described)]


def draft(file: Path, described: Described, plant: type[Plant]) -> str:
    """A draft of its map for a plant, as YAML, with question marks for missing entries."""
    output, drive = described.of("output"), described.of("input")
    links = {plant.output.name: _alike(plant.output, output), plant.drive.name: _alike(plant.drive, drive)}
    if len(output) == 1:
        links[plant.output.name] = output[0]
    if len(drive) == 1 + len(plant.disturbances) == 1:
        links[plant.drive.name] = drive[0]
    own = [v for v in described.variables if v.state >= 0] or _others(described)
    links |= {name: _alike(of, drive) for name, of in plant.disturbances.items()}
    states = {name: _alike(of, own) for name, of in plant.states.items()}
    parameters = {name: _alike(of, described.of("parameter")) for name, of in plant.parameters.items()}
    taken = {name for name, found in (states | parameters).items() if found is not None}
    entry: dict[str, Any] = {
        "fmu": file.name,
        "variables": {
            name: _written(found, plant.declarations[name].unit)
            for name, found in (links | states | parameters).items()
            if found is not None or name in {plant.output.name, plant.drive.name}
        },
        "starts": {name: _start(plant, name) for name in states if name in taken},
        "free": [n for n in next(iter(plant.structures.values())).free if n in taken],
    }
    tree = {"plant": plant.name, "structures": {described.name or file.stem: entry}}
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    named = {found.name for found in (links | states | parameters).values() if found is not None}
    left = [v for v in (*described.of("parameter"), *own) if v.name not in named]
    return text + "".join(_more(v) for v in left)


def _verdict(described: Described) -> str:
    if not described.kinds:
        return "It cannot be used: it supports neither co-simulation nor model exchange."
    if MODEL_EXCHANGE in described.kinds:
        return "It can be matched and used for forecasts if the map names all continuous states."
    return (
        "It can be matched and used for forecasts if the map names all internal states, and all of them can "
        "be set before a run."
    )


def _others(described: Described) -> list[Variable]:
    if MODEL_EXCHANGE in described.kinds and CO_SIMULATION not in described.kinds:
        return []
    kinds = ("local", "output")
    return [v for v in described.variables if v.causality in kinds and v.settable and v.state < 0]


def _line(variable: Variable) -> str:
    start = "" if variable.start is None else f" = {variable.start:g}"
    unit = f" {variable.unit}" if variable.unit else ""
    text = f"  ({variable.text})" if variable.text else ""
    return " ".join(f"{variable.name}{start}{unit}{text}".split())


def _alike(of: Any, variables: Iterable[Variable]) -> Variable | None:
    """The variable with the name of a quantity, or with it as last part, ignoring case and punctuation."""
    wanted = {_plain(of.name), _plain(of.symbol)} - {""}
    for variable in variables:
        if {_plain(variable.name), _plain(variable.name.rsplit(".", 1)[-1])} & wanted:
            return variable
    return None


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name).casefold()


def _written(found: Variable | None, unit: str) -> Any:
    if found is None:
        return "?"
    celsius = unit in _CELSIUS
    if celsius != (found.unit in _CELSIUS) and {unit, found.unit} & {"K"}:
        return {"variable": found.name, "offset": -_KELVIN if celsius else _KELVIN}
    return found.name


def _start(plant: type[Plant], state: str) -> str:
    name = plant.output.name
    return f"{name} + {_KELVIN}" if plant.output.unit == "°C" and plant.states[state].unit == "K" else name


def _more(variable: Variable) -> str:
    """A comment line for a variable that the plant does not have."""
    value = 1.0 if variable.start is None else variable.start
    kind = "parameters" if variable.causality == "parameter" else "states"
    what = (
        f"default: {value:g}, bounds: [?, ?], unit: {variable.unit!r}"
        if kind == "parameters"
        else f"span: [?, ?], unit: {variable.unit!r}"
    )
    return f"# not in the plant; can be declared under {kind}: {variable.name}: {{{what}}}\n"
