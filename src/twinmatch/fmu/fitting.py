"""Checks of an FMU against its map, and the request that loads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twinmatch.fmu.described import CO_SIMULATION, MODEL_EXCHANGE, Described, described_from
from twinmatch.fmu.errors import FmuError
from twinmatch.fmu.mapping import FmuMap, Link
from twinmatch.fmu.process import START, FmuProcess, ProcessLostError

__all__ = ["described_by", "loading"]


def described_by(file: Path, process: FmuProcess, limit: float = START) -> Described:
    """Read the description of an FMU, without executing its code.

    Raises:
        FmuError: the file is not an FMU, or cannot be used.
    """
    if not file.is_file():
        raise FmuError(f"{file}: does not exist; give the path of an FMU")
    try:
        answer = process.ask(
            {"ask": "describe", "file": str(file.resolve()), "folder": str(process.folder / "description")},
            limit=limit,
        )
        return described_from(dict(answer.header["described"]))
    except ProcessLostError as error:
        raise FmuError(f"{file}: its description cannot be read: {error}") from error
    except (FmuError, KeyError, TypeError, ValueError) as error:
        raise FmuError(f"{file}: {error}") from error


def loading(of: FmuMap, described: Described) -> tuple[dict[str, Any], str]:
    """The request that loads the FMU, without the paths of its files; and its interface type.

    Raises:
        FmuError: the FMU does not match the map.
    """
    kind = of.kind or next(iter(described.kinds), "")
    if kind not in described.kinds:
        ways = " and ".join(described.kinds) or "neither model exchange nor co-simulation"
        raise FmuError(f"it supports {ways}" + (f", not {kind}" if kind else ""))
    plant, links = of.plant, of.links
    inputs = [links[plant.drive.name], *(links[name] for name in plant.disturbances if name in links)]
    states = [links[name] for name in of.known_states]
    parameters = [links[name] for name in of.known_parameters]
    output = [links[plant.output.name]]
    for link in (*output, *inputs, *states, *parameters):
        for name in (link.variable, link.set):
            if described.called(name) is None:
                raise FmuError(f"has no real variable {name!r}; `twinmatch fmu` lists those it has")
    _check_inputs(described, inputs)
    own = [v.name for v in sorted(described.variables, key=lambda v: v.state) if v.state >= 0]
    if kind == MODEL_EXCHANGE:
        _check_states(described, own, [link.variable for link in states])
    fixed = [*parameters, *states] if kind == CO_SIMULATION else parameters
    _check_settable(described, fixed)
    wires = {"fixed": [link.set for link in fixed]}
    wires |= {
        name: [link.variable for link in those]
        for name, those in (("inputs", inputs), ("states", states), ("output", output))
    }
    return {
        "ask": "load",
        "described": described.tree,
        "kind": kind,
        "wires": {name: _references(described, names) for name, names in wires.items()},
        "places": [own.index(link.variable) for link in states] if kind == MODEL_EXCHANGE else [],
    }, kind


def _references(described: Described, names: list[str]) -> list[int]:
    return [found.reference for name in names if (found := described.called(name)) is not None]


def _check_states(described: Described, own: list[str], named: list[str]) -> None:
    """Check that the map names all states of a model-exchange FMU, and no others."""
    left = [name for name in own if name not in named]
    other = [name for name in named if name not in own]
    if left or other or described.states != len(named):
        what = "the map does not name all of them"
        if left:
            what = f"the map does not name {left[0]!r}"
        elif other:
            what = f"the map names {other[0]!r}, which is not one of them"
        raise FmuError(f"its continuous states are {', '.join(own) or 'none'}; {what}")


def _check_inputs(described: Described, links: list[Link]) -> None:
    """Check that the plant's inputs are inputs of the FMU: it may ignore values of others."""
    for link in links:
        variable = described.called(link.set)
        if variable is not None and variable.causality != "input" and variable.variability != "tunable":
            given = f"{variable.causality}, variability {variable.variability or 'not given'}"
            inputs = ", ".join(one.name for one in described.of("input")) or "none"
            raise FmuError(f"its variable {link.set!r} is not an input ({given}); its inputs are {inputs}")


def _check_settable(described: Described, links: list[Link]) -> None:
    for link in links:
        variable = described.called(link.set)
        if variable is not None and not variable.settable:
            msg = f"its variable {link.set!r} cannot be set before a run"
            raise FmuError(f"{msg} ({variable.causality}, initial {variable.initial or 'not given'})")
