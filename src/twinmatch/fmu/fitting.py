"""Whether an FMU and its map fit, and what its process has to know to load it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twinmatch.fmu.described import CO_SIMULATION, MODEL_EXCHANGE, Described, described_from
from twinmatch.fmu.errors import FmuError
from twinmatch.fmu.mapping import FmuMap, Link
from twinmatch.fmu.process import START, FmuProcess, ProcessLostError

__all__ = ["described_by", "loading"]


def described_by(file: Path, process: FmuProcess, limit: float = START) -> Described:
    """What an FMU says of itself; none of its program runs.

    Raises:
        FmuError: it is no FMU that can be used.
    """
    if not file.is_file():
        raise FmuError(f"{file}: there is no such file; give the path of an FMU")
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
    """The question that loads the FMU, but for where its files are, and how it will be run.

    Raises:
        FmuError: the FMU is not what the map says.
    """
    kind = of.kind or next(iter(described.kinds), "")
    if kind not in described.kinds:
        ways = " and ".join(described.kinds) or "no way that is known"
        raise FmuError(f"it can be run by {ways}, not by {kind or 'any of them'}")
    plant, links = of.plant, of.links
    inputs = [links[plant.drive.name], *(links[name] for name in plant.disturbances if name in links)]
    states = [links[name] for name in of.known_states]
    parameters = [links[name] for name in of.known_parameters]
    output = [links[plant.output.name]]
    for link in (*output, *inputs, *states, *parameters):
        for name in (link.variable, link.set):
            if described.called(name) is None:
                raise FmuError(f"has no real variable {name!r}; `twinmatch fmu` lists those it has")
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
    """A model-exchange FMU is put where all its states are known."""
    left = [name for name in own if name not in named]
    other = [name for name in named if name not in own]
    if left or other or described.states != len(named):
        what = f"{left[0]!r} is not named" if left else f"{other[0]!r} is none" if other else "not all are"
        raise FmuError(f"its continuous states are {', '.join(own) or 'none'}; {what} in the map")


def _check_settable(described: Described, links: list[Link]) -> None:
    for link in links:
        variable = described.called(link.set)
        if variable is not None and not variable.settable:
            msg = f"its variable {link.set!r} cannot be set before a run"
            raise FmuError(f"{msg} ({variable.causality}, initial {variable.initial or 'not given'})")
