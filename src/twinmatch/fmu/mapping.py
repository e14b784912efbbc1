"""The map file: which FMUs are structures of a plant, and which of their variables are which quantity.

Initial states are formulas in terms of the plant's quantities, such as `temperature + 273.15`. `loading`
compares a map with the FMU's description, and says how its process loads it.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from twinmatch.decoding import NOT_GIVEN, FiniteNumber, decoded, given_keys
from twinmatch.dynamics import Parameter, Plant, PlantError, State
from twinmatch.fmu.archive import (
    CO_SIMULATION,
    MODEL_EXCHANGE,
    Described,
    FmuError,
    remembering,
)
from twinmatch.plants import find_plant
from twinmatch.sessions.documents import DocumentError, read_yaml

_BINARY: Final[dict[type, Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
LONGEST: Final = 500
PATIENCE: Final = 10.0
"""Default time limit of one request to an FMU, s."""

_TINY = 5e-324


class Formula:
    """Sums, differences, products and quotients of numbers and names.

    Raises:
        FmuError: the text is not such a formula.
    """

    def __init__(self, place: str, text: str) -> None:
        """Parse a formula; `place` starts the error message."""
        self.text = text
        self._place = place
        try:
            if len(text) > LONGEST:
                raise SyntaxError("too long")
            self._tree = ast.parse(text.strip(), mode="eval").body
            self.names = tuple(
                sorted({n.id for n in ast.walk(self._tree) if isinstance(n, ast.Name)})
            )
            self._of(self._tree, dict.fromkeys(self.names, 1.0))
        except ZeroDivisionError:
            pass
        except (SyntaxError, ValueError, RecursionError):
            msg = f"{place}: {text[:80]!r} is not a formula; use names, numbers, +, −, *, / and parentheses"
            raise FmuError(msg) from None

    def __call__(self, values: Mapping[str, float]) -> float:
        """Its value; NaN if it is undefined."""
        try:
            return self._of(self._tree, values)
        except ZeroDivisionError:
            return math.nan

    def _of(self, node: Any, values: Mapping[str, float]) -> float:
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            return float(node.value)
        if isinstance(node, ast.Name):
            return values[node.id]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -self._of(node.operand, values)
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            return _BINARY[type(node.op)](
                self._of(node.left, values), self._of(node.right, values)
            )
        raise SyntaxError("not arithmetic")


class Link(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A variable of the FMU: plant value = `factor` · FMU value + `offset`."""

    variable: str
    set: str = ""
    """The variable that sets a state; `variable` itself if not given."""
    factor: FiniteNumber = 1.0
    offset: FiniteNumber = 0.0


class _Quantity(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    unit: str | msgspec.UnsetType = NOT_GIVEN
    text: str | msgspec.UnsetType = NOT_GIVEN
    symbol: str | msgspec.UnsetType = NOT_GIVEN
    scale: float | msgspec.UnsetType = NOT_GIVEN


class _WrittenParameter(_Quantity, kw_only=True):
    default: float
    bounds: tuple[float, float]
    least: float | msgspec.UnsetType = NOT_GIVEN
    positive: bool | msgspec.UnsetType = NOT_GIVEN
    most: float | msgspec.UnsetType = NOT_GIVEN
    relative: bool | msgspec.UnsetType = NOT_GIVEN


class _WrittenState(_Quantity, kw_only=True):
    span: tuple[float, float]
    start_bounds: tuple[float, float] | None = None


class Entry(msgspec.Struct, forbid_unknown_fields=True):
    """An entry under `structures`, as it is written."""

    fmu: str
    variables: dict[str, Any]
    kind: str = ""
    """Interface type; empty: model exchange if supported."""
    starts: dict[str, str | float] = {}
    free: tuple[str, ...] = ()
    fixed: dict[str, FiniteNumber] = {}
    free_starts: tuple[str, ...] = ()
    parameters: dict[str, Any] | None = None
    states: dict[str, Any] | None = None
    searches: tuple[dict[str, FiniteNumber], ...] | None = None
    patience: FiniteNumber = PATIENCE
    watched: bool = True


class _FmuFile(msgspec.Struct, forbid_unknown_fields=True):
    plant: str
    structures: dict[str, Any]


@dataclass(frozen=True, eq=False)
class FmuMap:
    """One FMU as a structure of a plant."""

    place: str
    """File and structure, for messages."""
    plant: type[Plant]
    name: str
    """Name of the structure, as given by the user."""
    file: Path
    own: Entry
    links: Mapping[str, Link]
    """By the plant's name: output, drive, disturbances, states, parameters."""
    starts: Mapping[str, Formula]
    """Initial value of every state, in terms of the output, parameters and disturbances."""
    searches: tuple[Mapping[str, float], ...]
    """Further starting points of a fit; by default those of the plant's first structure."""
    parameters: Mapping[str, Parameter]
    """Parameters that the plant file does not declare."""
    states: Mapping[str, State]

    @property
    def known_states(self) -> tuple[str, ...]:
        """The FMU's states, those of the plant first."""
        return tuple(
            name for name in {**self.plant.states, **self.states} if name in self.links
        )

    @property
    def known_parameters(self) -> tuple[str, ...]:
        """The FMU's parameters, those of the plant first."""
        return tuple(
            name
            for name in {**self.plant.parameters, **self.parameters}
            if name in self.links
        )


def read_maps(file: Path) -> tuple[FmuMap, ...]:
    """Read the maps in a file.

    Raises:
        FmuError: the file cannot be used.
    """
    try:
        tree = read_yaml(file)
    except DocumentError as error:
        raise FmuError(str(error)) from error
    content = decoded(tree, _FmuFile, str(file), FmuError)
    if not content.structures:
        raise FmuError(f"{file}: needs, under `structures`, at least one FMU by name")
    try:
        plant = find_plant(content.plant)
    except PlantError as error:
        raise FmuError(f"{file}: {error}") from error
    return tuple(
        _map(file, plant, name, entry) for name, entry in content.structures.items()
    )


def _map(file: Path, plant: type[Plant], name: str, tree: Any) -> FmuMap:
    place = f"{file}, structure {name!r}"
    entry = decoded(tree, Entry, place, FmuError)
    parameters = _declared(place, Parameter, _WrittenParameter, entry.parameters, plant)
    states = _declared(place, State, _WrittenState, entry.states, plant)
    links = {
        key: _link(f"{place}, variable {key}", value)
        for key, value in entry.variables.items()
    }
    linkable = (
        plant.output.name,
        plant.drive.name,
        *plant.disturbances,
        *plant.states,
        *plant.parameters,
        *parameters,
        *states,
    )
    _subset(place, "variables", links, linkable)
    for needed in (plant.output.name, plant.drive.name, *parameters, *states):
        if needed not in links:
            raise FmuError(
                f"{place}: variables has no entry for {needed}; give the FMU's variable for it"
            )
    if entry.kind not in {"", CO_SIMULATION, MODEL_EXCHANGE}:
        raise FmuError(
            f"{place}: kind is {entry.kind!r}; give {MODEL_EXCHANGE!r} or {CO_SIMULATION!r}"
        )
    searches = entry.searches
    if searches is None:
        usual = next(iter(plant.structures.values())).starts
        searches = tuple(dict(start) for start in usual if set(start) <= set(links))
    fmu = FmuMap(
        place=place,
        plant=plant,
        name=name,
        file=file.parent / entry.fmu,
        own=entry,
        links=links,
        starts={
            key: Formula(f"{place}, start of {key}", str(value))
            for key, value in entry.starts.items()
        },
        searches=searches,
        parameters=parameters,
        states=states,
    )
    _check(fmu)
    return fmu


def _check(fmu: FmuMap) -> None:
    states = fmu.known_states
    parameters = fmu.known_parameters
    _subset(fmu.place, "free", fmu.own.free, parameters)
    _subset(fmu.place, "fixed", fmu.own.fixed, parameters)
    for search in fmu.searches:
        _subset(fmu.place, "searches", search, parameters)
    _subset(fmu.place, "free_starts", fmu.own.free_starts, states)
    _subset(fmu.place, "starts", fmu.starts, states)
    if not fmu.own.patience > 0:
        raise FmuError(
            f"{fmu.place}: patience is {fmu.own.patience:g} s; give a positive number"
        )
    missing = [name for name in states if name not in fmu.starts]
    if missing:
        msg = f"{fmu.place}: starts has no entry for {missing[0]}; give its initial value at a known output"
        raise FmuError(msg)
    for name, formula in fmu.starts.items():
        allowed = (
            fmu.plant.output.name,
            fmu.plant.drive.name,
            *fmu.plant.disturbances,
            *parameters,
        )
        _subset(
            f"{fmu.place}, start of {name}", repr(formula.text), formula.names, allowed
        )


def _subset(place: str, section: str, names: Any, allowed: Any) -> None:
    unknown = [name for name in names if name not in allowed]
    if unknown:
        raise FmuError(
            f"{place}: {section} names {unknown[0]!r}; there are {', '.join(allowed) or 'none'}"
        )


def _link(place: str, tree: Any) -> Link:
    if isinstance(tree, str):
        return Link(tree, tree)
    link = decoded(tree, Link, place, FmuError)
    if link.factor == 0.0:
        raise FmuError(
            f"{place}: factor is 0; plant value = factor · FMU value + offset, so give another"
        )
    return link if link.set else msgspec.structs.replace(link, set=link.variable)


def _declared(
    place: str,
    kind: Any,
    written: type[_Quantity],
    tree: Mapping[str, Any] | None,
    plant: type[Plant],
) -> dict[str, Any]:
    declarations = {}
    for name, value in (tree or {}).items():
        place_of_entry = f"{place}, {kind.__name__.lower()} {name}"
        if name in plant.declarations:
            raise FmuError(
                f"{place}: {name} is declared by the plant; list it only under variables"
            )
        try:
            declared = kind(
                **given_keys(decoded(value, written, place_of_entry, FmuError))
            )
            declared.__set_name__(plant, name)
        except FmuError:
            raise
        except (PlantError, TypeError, ValueError) as error:
            raise FmuError(f"{place_of_entry}: {error}") from error
        declarations[name] = declared
    return declarations


def sample_time(plant: type[Plant]) -> float:
    """Sample time of the plant's loop, s; 1 s if it is not known."""
    return 1.0 if plant.loop is None else float(plant.loop.period)


def loading(fmu: FmuMap, described: Described) -> tuple[dict[str, Any], str]:
    """The request that loads the FMU, without the paths of its files; and its interface type.

    Raises:
        FmuError: the FMU does not match the map.
    """
    kind = _interface_type(fmu, described)
    if described.discrete:
        raise FmuError(remembering(described))
    plant = fmu.plant
    links = fmu.links
    inputs = [
        links[plant.drive.name],
        *(links[name] for name in plant.disturbances if name in links),
    ]
    states = [links[name] for name in fmu.known_states]
    parameters = [links[name] for name in fmu.known_parameters]
    output = links[plant.output.name]
    _require_variables(described, [output, *inputs, *states, *parameters])
    _check_inputs(described, inputs)
    return {
        "ask": "load",
        "described": described.tree,
        "kind": kind,
        "references": {
            "fixed": _references(
                described, [link.set for link in (*parameters, *states)]
            ),
            "inputs": _references(described, [link.variable for link in inputs]),
            "states": _references(described, [link.variable for link in states]),
            "output": _references(described, [output.variable]),
        },
        "places": _places_of_states(described, kind, states, parameters),
        "given": [k for k, name in enumerate(plant.disturbances) if name in links],
        "signals": [plant.output.name, plant.drive.name, *plant.disturbances],
        "parameters": fmu.known_parameters,
        "starts": [fmu.starts[name].text for name in fmu.known_states],
        "rest": plant.drive.rest,
        "sample": sample_time(plant),
        "numbers": _numbers(fmu, [*parameters, *states, *inputs, output]),
    }, kind


def _interface_type(fmu: FmuMap, described: Described) -> str:
    """Model exchange or co-simulation: what the map says or, without a word, the first that the FMU supports."""
    kind = fmu.own.kind or next(iter(described.kinds), "")
    if kind not in described.kinds:
        ways = (
            " and ".join(described.kinds) or "neither model exchange nor co-simulation"
        )
        raise FmuError(f"it supports {ways}" + (f", not {kind}" if kind else ""))
    return kind


def _require_variables(described: Described, links: Sequence[Link]) -> None:
    for link in links:
        for name in (link.variable, link.set):
            if described.called(name) is None:
                raise FmuError(
                    f"has no real variable {name!r}; `twinmatch fmu` lists those it has"
                )


def _places_of_states(
    described: Described, kind: str, states: Sequence[Link], parameters: Sequence[Link]
) -> list[int]:
    """The place of each state among those of the machine that runs the FMU; also checks that all can be set.

    In model exchange states are the FMU's own; in co-simulation only their starts are set, as parameters are.
    """
    if kind != MODEL_EXCHANGE:
        _check_settable(described, [*parameters, *states])
        return list(range(len(states)))
    with_states = [v for v in described.variables if v.state >= 0]
    names = [v.name for v in sorted(with_states, key=lambda v: v.state)]
    _check_states(described, names, [link.variable for link in states])
    _check_settable(described, parameters)
    return [names.index(link.variable) for link in states]


def _numbers(fmu: FmuMap, links: Sequence[Link]) -> list[list[float]]:
    """As a machine keeps them: factors, offsets, values, sizes, and least and greatest values."""
    plant = fmu.plant
    declared_parameters = {**plant.parameters, **fmu.parameters}
    declared_states = {**plant.states, **fmu.states}
    parameters = [declared_parameters[name] for name in fmu.known_parameters]
    spans = [
        *(declared_states[name].span for name in fmu.known_states),
        plant.drive.limits,
    ]
    unlimited = [math.inf for _ in spans]
    return [
        [link.factor for link in links],
        [link.offset for link in links],
        [math.nan for _ in links],
        [*(p.scale for p in parameters), *(high - low for low, high in spans)],
        [
            *(max(p.least, _TINY if p.positive else p.least) for p in parameters),
            *(-x for x in unlimited),
        ],
        [*(p.most for p in parameters), *unlimited],
    ]


def _references(described: Described, names: list[str]) -> list[int]:
    return [
        variable.reference
        for name in names
        if (variable := described.called(name)) is not None
    ]


def _check_states(described: Described, states: list[str], named: list[str]) -> None:
    """Check that the map names all states of a model-exchange FMU, and no others."""
    unnamed = [name for name in states if name not in named]
    unknown = [name for name in named if name not in states]
    if unnamed or unknown or described.states != len(named):
        problem = "the map does not name all of them"
        if unnamed:
            problem = f"the map does not name {unnamed[0]!r}"
        elif unknown:
            problem = f"the map names {unknown[0]!r}, which is not one of them"
        raise FmuError(
            f"its continuous states are {', '.join(states) or 'none'}; {problem}"
        )


def _check_inputs(described: Described, links: list[Link]) -> None:
    """Check that the plant's inputs are inputs of the FMU: it may ignore values of others."""
    for link in links:
        variable = described.called(link.set)
        if (
            variable is not None
            and variable.causality != "input"
            and variable.variability != "tunable"
        ):
            kind = f"{variable.causality}, variability {variable.variability or 'not given'}"
            inputs = ", ".join(entry.name for entry in described.of("input")) or "none"
            raise FmuError(
                f"its variable {link.set!r} is not an input ({kind}); its inputs are {inputs}"
            )


def _check_settable(described: Described, links: Sequence[Link]) -> None:
    for link in links:
        variable = described.called(link.set)
        if variable is not None and not variable.settable:
            msg = f"its variable {link.set!r} cannot be set before a run"
            raise FmuError(
                f"{msg} ({variable.causality}, initial {variable.initial or 'not given'})"
            )
