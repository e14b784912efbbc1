"""The file of an FMU: unpacked safely, and its description, as exchanged between processes and in words.

A first draft of a map matches similar names.
"""

from __future__ import annotations

import hashlib
import re
import stat
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Final
from xml.etree import ElementTree

import yaml

from twinmatch.dynamics import Plant, PlantError
from twinmatch.settings import Rule
from twinmatch.signals import KELVIN

MAX_BYTES: Final = 512 * 1024 * 1024
"""Largest file, and largest total size of its content, bytes."""


class _Limits(Rule):
    """What an archive may hold, and what is listed of it."""

    files: int = 20_000
    """Most files."""
    variables: int = 100_000
    """Most variables."""
    listed: int = 60
    """Most variables listed per kind."""


_LIMITS: Final = _Limits()


_BLOCK: Final = 1 << 20
CO_SIMULATION: Final = "co-simulation"
MODEL_EXCHANGE: Final = "model exchange"

_REAL: Final = ("Real", "Float64")
_WORDS: Final = ("String", "Binary")
_CELSIUS: Final = ("°C", "degC")


class FmuError(PlantError):
    """An FMU cannot be used, or its map does not fit."""


def digest_of(file: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while block := opened.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def unpack(file: Path, folder: Path, only: str = "") -> list[str]:
    """Unpack an FMU into a folder, or `only` one of its files; returns the names of all files in it.

    Raises:
        FmuError: it is not a ZIP file, or has suspicious content.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
            infos = archive.infolist()
            _check(infos)
            if only and only not in names:
                raise FmuError(f"is not an FMU: it has no {only}")
            for info in infos:
                if not only or info.filename == only:
                    # no more bytes than its stated size are unpacked
                    Path(archive.extract(info, folder)).chmod(0o700)
            return names
    except (
        zipfile.BadZipFile,
        zipfile.LargeZipFile,
        zlib.error,
        NotImplementedError,
        RuntimeError,
        EOFError,
    ) as error:
        raise FmuError(f"is not an FMU, or is damaged: {error}") from error


def _check(infos: list[zipfile.ZipInfo]) -> None:
    if len(infos) > _LIMITS.files:
        raise FmuError(f"has {len(infos)} files; the limit is {_LIMITS.files}")
    for info in infos:
        name = PurePosixPath(info.filename)
        if (
            name.is_absolute()
            or ".." in name.parts
            or "\\" in info.filename
            or ":" in info.filename
        ):
            raise FmuError(
                f"has {info.filename!r}, a path outside its folder; it is not unpacked"
            )
        if stat.S_ISLNK(info.external_attr >> 16):
            raise FmuError(f"has the link {info.filename!r}; it is not unpacked")
    total = sum(info.file_size for info in infos)
    if total > MAX_BYTES:
        size = total / 2**20
        most = MAX_BYTES // 2**20
        raise FmuError(f"has {size:.0f} MiB; the limit is {most} MiB")


@dataclass(frozen=True)
class Variable:
    """A real variable of an FMU."""

    name: str
    reference: int
    causality: str
    variability: str
    initial: str
    unit: str
    start: float | None
    text: str
    state: int
    """Index among the continuous states; -1 if it is not a state."""

    @property
    def settable(self) -> bool:
        """Whether it can be set before a run."""
        return self.variability != "constant" and (
            self.causality in {"input", "parameter"}
            or self.initial in {"exact", "approx"}
        )


@dataclass(frozen=True)
class Described:
    """The description of an FMU."""

    version: str
    """Version of FMI."""
    name: str
    tool: str
    guid: str
    kinds: tuple[str, ...]
    """Supported interface types: model exchange, co-simulation."""
    identifiers: tuple[str, ...]
    """Name of its library, for each of the kinds."""
    directional: bool
    """Whether a model-exchange FMU provides directional derivatives."""
    after_steps: bool
    """Whether it must be notified of every completed integrator step."""
    indicators: int
    """Event indicators of FMI 2."""
    states: int
    step: float | None
    """Suggested step size, s."""
    platforms: tuple[str, ...]
    discrete: tuple[str, ...]
    """Names of the variables that change at events only, other than inputs and parameters."""
    foreign: tuple[str, ...]
    """What is not a real scalar, in words: arrays, integers, strings."""
    variables: tuple[Variable, ...]

    def called(self, name: str) -> Variable | None:
        """The real variable of this name; None without one."""
        return self._by_name.get(name)

    @cached_property
    def _by_name(self) -> Mapping[str, Variable]:
        """Each real variable; of several with one name, the first."""
        return {variable.name: variable for variable in reversed(self.variables)}

    def of(self, *causalities: str) -> list[Variable]:
        """The variables of these causalities."""
        return [
            variable for variable in self.variables if variable.causality in causalities
        ]

    @property
    def tree(self) -> dict[str, Any]:
        """The description as a dictionary for JSON."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {**values, "variables": [vars(variable) for variable in self.variables]}


def described_from(tree: dict[str, Any]) -> Described:
    """The description from such a dictionary.

    Raises:
        ValueError, TypeError, KeyError: it is not such a dictionary.
    """
    variables = tuple(Variable(**variable) for variable in tree.pop("variables"))
    pairs: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in tree.items()
    }
    return Described(**pairs, variables=variables)


def read_description(folder: Path, names: Iterable[str]) -> Described:
    """Read `modelDescription.xml` in a folder; `names` are those of all files of the FMU.

    Raises:
        ValueError: the file does not follow FMI 2 or 3.
    """
    description = _parsed(folder)
    identifiers = _identifiers(description)
    derived = [
        unknown.variable.derivative.name
        for unknown in description.derivatives
        if unknown.variable.derivative
    ]
    order = {name: place for place, name in reversed(list(enumerate(derived)))}
    exchange = description.modelExchange
    usual = description.defaultExperiment
    return Described(
        version=description.fmiVersion,
        name=description.modelName or "",
        tool=description.generationTool or "",
        guid=description.guid or "",
        kinds=tuple(identifiers),
        identifiers=tuple(identifiers.values()),
        directional=bool(
            exchange is not None and exchange.providesDirectionalDerivative
        ),
        after_steps=exchange is not None
        and _needs_completed_steps(description.fmiVersion, exchange),
        indicators=int(description.numberOfEventIndicators),
        states=len(description.derivatives),
        step=float(usual.stepSize) if usual is not None and usual.stepSize else None,
        platforms=_platforms(names),
        discrete=tuple(
            v.name for v in description.modelVariables if _changes_at_events(v)
        ),
        foreign=tuple(
            _foreign(v) for v in description.modelVariables if not _real_scalar(v)
        ),
        variables=tuple(
            _variable(v, order) for v in description.modelVariables if _real_scalar(v)
        ),
    )


def _parsed(folder: Path) -> Any:
    """The description as FMPy reads it.

    Raises:
        ValueError: it does not follow FMI 2 or 3, or has too many variables.
    """
    from fmpy import read_model_description  # noqa: PLC0415

    version = _version(folder / "modelDescription.xml")
    if not version.startswith(("2.", "3.")):
        raise ValueError(
            f"it is of FMI {version or 'without version'}; FMI 2 and 3 are supported"
        )
    try:
        description = read_model_description(str(folder), validate=False)
    except Exception as error:  # FMPy raises many kinds
        raise ValueError(
            f"its modelDescription.xml does not follow FMI {version}: {error}"
        ) from error
    if len(description.modelVariables) > _LIMITS.variables:
        raise ValueError(
            f"it has {len(description.modelVariables)} variables; the limit is {_LIMITS.variables}"
        )
    return description


def _identifiers(description: Any) -> dict[str, str]:
    """The model identifier of each interface type that is supported.

    Raises:
        ValueError: one is not a name of C, as FMI demands; files are named after it.
    """
    interfaces = {
        MODEL_EXCHANGE: description.modelExchange,
        CO_SIMULATION: description.coSimulation,
    }
    identifiers = {}
    for kind, interface in interfaces.items():
        if interface is None:
            continue
        identifier = str(interface.modelIdentifier)
        if not re.fullmatch(r"[A-Za-z_]\w*", identifier, re.ASCII):
            raise ValueError(
                f"its modelIdentifier is {interface.modelIdentifier!r}; FMI demands a name of C"
            )
        identifiers[kind] = identifier
    return identifiers


def _version(file: Path) -> str:
    """The version of FMI that a description states; empty without one."""
    try:  # only the first element; expat limits how far entities expand
        _, root = next(ElementTree.iterparse(file, events=("start",)))  # noqa: S314
    except (ElementTree.ParseError, ValueError, LookupError, StopIteration) as error:
        raise ValueError(
            f"its modelDescription.xml is not valid XML: {error}"
        ) from error
    return str(root.get("fmiVersion", ""))


def _real_scalar(declared: Any) -> bool:
    return declared.type in _REAL and not declared.dimensions


def _variability(declared: Any) -> str:
    """As declared; what is not real is never continuous, which FMPy takes for the default."""
    stated = str(declared.variability or "")
    return (
        "discrete" if stated == "continuous" and declared.type not in _REAL else stated
    )


def _changes_at_events(declared: Any) -> bool:
    """Whether it may be a memory of events: of what is not real, words apart."""
    has_own_value = (
        declared.causality in {"local", "output"} and declared.type not in _WORDS
    )
    return has_own_value and _variability(declared) == "discrete"


def _foreign(declared: Any) -> str:
    """Name, type with dimensions, causality and variability."""
    sizes = (
        dimension.start or getattr(dimension.variable, "name", "?")
        for dimension in declared.dimensions or ()
    )
    kind = declared.type + "".join(f"[{size}]" for size in sizes)
    about = ", ".join(filter(None, (declared.causality, _variability(declared))))
    return " ".join(f"{declared.name}: {kind}, {about}".split())


def _variable(declared: Any, order: Mapping[str, int]) -> Variable:
    unit = declared.unit or (
        declared.declaredType.unit if declared.declaredType is not None else ""
    )
    return Variable(
        name=declared.name,
        reference=int(declared.valueReference),
        causality=declared.causality or "local",
        variability=declared.variability or "",
        initial=declared.initial or "",
        unit=unit or "",
        start=_number(declared.start),
        text=declared.description or "",
        state=order.get(declared.name, -1),
    )


def _needs_completed_steps(version: str, exchange: Any) -> bool:
    if version.startswith("2."):
        return not exchange.completedIntegratorStepNotNeeded
    return bool(exchange.needsCompletedIntegratorStep)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _platforms(names: Iterable[str]) -> tuple[str, ...]:
    folders = {
        name.split("/")[1]
        for name in names
        if name.startswith("binaries/") and name.count("/") > 1
    }
    return tuple(sorted(folders))


def overview(described: Described) -> list[str]:
    """The description and the variables, as lines of text."""
    kinds = " and ".join(described.kinds) or "no supported interface type"
    platforms = ", ".join(described.platforms) or "no platform"
    lines = [
        f"{described.name}: FMI {described.version}, {kinds}; by {described.tool or 'an unknown tool'}",
        f"binaries for {platforms}; directional derivatives: {'yes' if described.directional else 'no'}",
    ]
    for title, variables in (
        ("inputs", described.of("input")),
        ("outputs", described.of("output")),
        ("continuous states", [v for v in described.variables if v.state >= 0]),
        ("parameters", described.of("parameter")),
        ("others that can be set before a run", _others(described)),
    ):
        lines += _listed(title, [_line(variable) for variable in variables])
    if described.foreign:
        lines += _listed("not real and scalar, so not for a map", described.foreign)
    return [*lines, _verdict(described)]


def _listed(title: str, rows: Sequence[str]) -> list[str]:
    note = (
        [f"  and {len(rows) - _LIMITS.listed} more"]
        if len(rows) > _LIMITS.listed
        else []
    )
    return [
        f"{title}: {'' if rows else 'none'}".rstrip(),
        *(f"  {row}" for row in rows[: _LIMITS.listed]),
        *note,
    ]


def draft(file: Path, described: Described, plant: type[Plant]) -> str:
    """A draft of its map for a plant, as YAML, with question marks for missing entries."""
    states_of_fmu = [v for v in described.variables if v.state >= 0] or _others(
        described
    )
    signals = _linked_signals(described, plant)
    states = _like_named(plant.states, VariableNames(states_of_fmu))
    parameters = _like_named(plant.parameters, VariableNames(described.of("parameter")))
    links = signals | states | parameters
    linked = {
        name for name, variable in (states | parameters).items() if variable is not None
    }
    entry: dict[str, Any] = {
        "fmu": file.name,
        "variables": {
            name: _link_of(variable, plant.declarations[name].unit)
            for name, variable in links.items()
            if variable is not None or name in {plant.output.name, plant.drive.name}
        },
        "starts": {name: _start(plant, name) for name in states if name in linked},
        "free": [n for n in next(iter(plant.structures.values())).free if n in linked],
    }
    tree = {"plant": plant.name, "structures": {described.name or file.stem: entry}}
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    named = {variable.name for variable in links.values() if variable is not None}
    unlinked = [
        v for v in (*described.of("parameter"), *states_of_fmu) if v.name not in named
    ]
    return text + "".join(_more(v) for v in unlinked)


def _linked_signals(
    described: Described, plant: type[Plant]
) -> dict[str, Variable | None]:
    """The FMU's variables for output, drive and disturbances: those with their names, or the only ones."""
    outputs = described.of("output")
    inputs = described.of("input")
    names_of_inputs = VariableNames(inputs)
    links = {
        plant.output.name: VariableNames(outputs).like(plant.output),
        plant.drive.name: names_of_inputs.like(plant.drive),
    }
    if len(outputs) == 1:
        links[plant.output.name] = outputs[0]
    if len(inputs) == 1 and not plant.disturbances:
        links[plant.drive.name] = inputs[0]
    return links | _like_named(plant.disturbances, names_of_inputs)


def _like_named(
    quantities: Mapping[str, Any], names: VariableNames
) -> dict[str, Variable | None]:
    """For each quantity of the plant the variable with its name or symbol."""
    return {name: names.like(quantity) for name, quantity in quantities.items()}


def _verdict(described: Described) -> str:
    if not described.kinds:
        return (
            "It cannot be used: it supports neither co-simulation nor model exchange."
        )
    if described.discrete:
        return f"It cannot be used: {remembering(described)}."
    if MODEL_EXCHANGE in described.kinds:
        return "It can be matched and used for forecasts if the map names all continuous states."
    return (
        "It can be matched and used for forecasts if the map names all internal states, and all of them can "
        "be set before a run."
    )


def remembering(described: Described) -> str:
    """What it remembers from event to event, which no state shows, in words."""
    names = ", ".join(described.discrete[:3])
    ending = " and others" if len(described.discrete) > 3 else ""
    return (
        f"its discrete variables ({names}{ending}) may remember earlier events, and cannot be set to what an "
        "observer estimates; export it without them"
    )


def _others(described: Described) -> list[Variable]:
    if MODEL_EXCHANGE in described.kinds and CO_SIMULATION not in described.kinds:
        return []
    kinds = ("local", "output")
    return [
        v
        for v in described.variables
        if v.causality in kinds and v.settable and v.state < 0
    ]


def _line(variable: Variable) -> str:
    start = "" if variable.start is None else f" = {variable.start:g}"
    unit = f" {variable.unit}" if variable.unit else ""
    text = f"  ({variable.text})" if variable.text else ""
    return " ".join(f"{variable.name}{start}{unit}{text}".split())


class VariableNames:
    """Variables by their names and the last parts of these, ignoring case and punctuation."""

    def __init__(self, variables: Sequence[Variable]) -> None:
        """Of several with one name, the first counts."""
        self._variables = variables
        self._places: dict[str, int] = {}
        for place, variable in enumerate(variables):
            self._places.setdefault(_plain(variable.name), place)
            self._places.setdefault(_plain(variable.name.rsplit(".", 1)[-1]), place)

    def like(self, quantity: Any) -> Variable | None:
        """The first variable with the name or the symbol of a quantity."""
        wanted = {_plain(quantity.name), _plain(quantity.symbol)} - {""}
        places = [self._places[name] for name in wanted if name in self._places]
        return self._variables[min(places)] if places else None


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name).casefold()


def _link_of(variable: Variable | None, unit: str) -> Any:
    if variable is None:
        return "?"
    celsius = unit in _CELSIUS
    if celsius != (variable.unit in _CELSIUS) and {unit, variable.unit} & {"K"}:
        return {"variable": variable.name, "offset": -KELVIN if celsius else KELVIN}
    return variable.name


def _start(plant: type[Plant], state: str) -> str:
    name = plant.output.name
    return (
        f"{name} + {KELVIN}"
        if plant.output.unit == "°C" and plant.states[state].unit == "K"
        else name
    )


def _more(variable: Variable) -> str:
    """A comment line for a variable that the plant does not have."""
    value = 1.0 if variable.start is None else variable.start
    kind = "parameters" if variable.causality == "parameter" else "states"
    declaration = (
        f"default: {value:g}, bounds: [?, ?], unit: {variable.unit!r}"
        if kind == "parameters"
        else f"span: [?, ?], unit: {variable.unit!r}"
    )
    return f"# not in the plant; can be declared under {kind}: {variable.name}: {{{declaration}}}\n"
