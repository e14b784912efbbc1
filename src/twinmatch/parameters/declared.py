"""Parameters declared from one table per node, and checked where they are read.

ROS 2 silently ignores an undeclared parameter, and with it a misspelt one in a file. Here it is an error that
suggests the probable name, and so is a value out of range: one line and exit code 2. All parameters are read
once, at the start; except for those that a node marks as changeable, they stay fixed while it runs. Nothing
here needs ROS, so that an offline replay reads the same files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.documents import read_yaml, shown

Value = bool | int | float | str | list[float] | list[str]
Values = dict[str, Any]
Record = TypeVar("Record", bound=Any)
"""An object of a dataclass."""

KINDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    list: "a list",
}
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides./clock.")
"""Parameters that every ROS 2 node has; rclpy itself declares the QoS overrides of /clock."""
QOS = "qos_overrides."


class ParameterError(TwinmatchError):
    """A parameter that does not exist, has another type, or is out of its range."""


@dataclass(frozen=True)
class Setting:
    """One parameter of a node."""

    name: str
    default: Value
    description: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    """The allowed texts; empty: any."""
    changeable: bool = False
    """Whether it may be set while the node runs; the node's callback then handles it."""

    @property
    def limits(self) -> str:
        """Unit and range as a user reads them, such as `°C, 0 to 100`; empty when there is neither."""
        if self.choices:
            return "one of: " + (
                "; " if any("," in c for c in self.choices) else ", "
            ).join(self.choices)
        low = f"{self.low:g}"
        high = f"{self.high:g}"
        span = f"{low} to {high}"
        if math.isinf(self.high):
            span = "" if math.isinf(self.low) else f"at least {low}"
        elif math.isinf(self.low):
            span = f"at most {high}"
        return ", ".join(part for part in (self.unit, span) if part)

    def accept(self, value: Any, node: str) -> Value:
        """The value, converted to this parameter's type.

        Raises:
            ParameterError: the value has another type or is out of range.
        """
        kind = type(self.default)
        if kind is float and type(value) is int:
            value = float(value)
        if (
            kind is list
            and value is not None
            and not isinstance(value, str | bytes | bool | int | float)
        ):
            value = self._accept_list(list(value), node)
        if type(value) is not kind:
            raise ParameterError(
                f"{node}: parameter {self.name} is {shown(value)}; it must be {KINDS[kind]}"
            )
        items = value if isinstance(value, list) else [value]
        if not all(self._allowed(item) for item in items):
            raise ParameterError(
                f"{node}: parameter {self.name} is {shown(value)}; allowed: {self.limits}"
            )
        return value

    def _accept_list(self, items: list[Any], node: str) -> list[Any]:
        default = self.default if isinstance(self.default, list) else []
        kind: type = type(default[0]) if default else str
        items = [float(i) if kind is float and type(i) is int else i for i in items]
        if not all(type(item) is kind for item in items):
            msg = f"{node}: parameter {self.name} is {shown(items)}; every item must be {KINDS[kind]}"
            raise ParameterError(msg)
        return items

    def _allowed(self, item: Any) -> bool:
        if isinstance(item, str):
            return not self.choices or item in self.choices
        return bool(self.low <= item <= self.high)


def parameters_of(record: Any, prefix: str = "", **names: str) -> tuple[Setting, ...]:
    """The parameters for the settings that a dataclass declares, with an object's values as defaults.

    Args:
        record: an object of the dataclass.
        prefix: precedes their names.
        names: fill in what texts and units leave open, such as the plant's `y`.
    """
    names = {"y": "", "u": "", "note": "", **names}
    settings = []
    for setting in fields(record):
        if "text" not in setting.metadata:
            continue
        default = getattr(record, setting.name)
        settings.append(
            Setting(
                prefix + setting.name,
                list(default) if isinstance(default, tuple) else default,
                setting.metadata["text"].format_map(names),
                setting.metadata["unit"].format_map(names),
                setting.metadata["low"],
                setting.metadata["high"],
            )
        )
    return tuple(settings)


def given_to(record: Record, values: Mapping[str, Any], prefix: str = "") -> Record:
    """An object of a dataclass with checked values for the settings that it declares."""
    names = [setting.name for setting in fields(record) if "text" in setting.metadata]
    return replace(record, **{name: values[prefix + name] for name in names})


def group(values: Mapping[str, Any], prefix: str) -> Values:
    """The values whose names start with a prefix, without it."""
    return {
        name.removeprefix(prefix): value
        for name, value in values.items()
        if name.startswith(prefix)
    }


def check(
    node: str, table: Sequence[Setting], given_values: Mapping[str, Any]
) -> Values:
    """All parameters of a node: those given, checked, and the defaults of the others.

    Raises:
        ParameterError: a name that is not in the table, a value of another type or out of its range.
    """
    setting_of = {parameter.name: parameter for parameter in table}
    for name in given_values:
        if name.startswith(QOS) and not name.startswith(BUILT_IN):
            raise ParameterError(
                f"{node}: {name[:80]} cannot be set: reliability and depth of a topic are guaranteed "
                "(docs/subscribing.md); leave it out"
            )
        if name not in setting_of and not name.startswith(BUILT_IN):
            import difflib  # noqa: PLC0415

            near = difflib.get_close_matches(name, setting_of, n=1)
            hint = (
                f"did you mean {near[0]}?"
                if near
                else f"choose from: {', '.join(sorted(setting_of)) or 'none'}"
            )
            raise ParameterError(f"{node}: there is no parameter {name[:80]}; {hint}")
    return {
        name: parameter.accept(given_values[name], node)
        if name in given_values
        else parameter.default
        for name, parameter in setting_of.items()
    }


def sections_of(path: Path, *nodes: str) -> Values:
    """What a ROS parameter file has for these nodes, by full names; sections of other nodes are ignored.

    Raises:
        DocumentError: it cannot be read, or is not YAML.
        ParameterError: it has no section of these nodes, or one that has no parameters.
    """
    content = read_yaml(path)
    tree = content if isinstance(content, dict) else {}
    parameters_of_nodes: Values = {}
    for node in (present := [node for node in nodes if tree.get(node) is not None]):
        parameters = (
            tree[node].get("ros__parameters") if isinstance(tree[node], dict) else None
        )
        if not isinstance(parameters, dict):
            raise ParameterError(
                f"{path}: section {node} has no ros__parameters; see the files in config/"
            )
        parameters_of_nodes |= flattened(parameters)
    if not present:
        raise ParameterError(
            f"{path}: has no section {' or '.join(nodes)}; see the files in config/"
        )
    return parameters_of_nodes


def flattened(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Parameters of a file by their full names: `pid: {low: 0}` is `pid.low`."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(flattened(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def render(
    node: str, table: Sequence[Setting], values: Mapping[str, Any] | None = None
) -> str:
    """A section of a ROS parameter file: every parameter with its description, unit and range."""
    lines = [f"{node}:", "  ros__parameters:"]
    for parameter in table:
        value = (values or {}).get(parameter.name, parameter.default)
        lines.append(f"    # {parameter.description}")
        if parameter.limits:
            lines.append(f"    # {parameter.limits}")
        lines.append(f"    {parameter.name}: {_yaml(value)}")
    return "\n".join(lines) + "\n"


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, float) and math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    return repr(value)


READERS = Setting(
    "readers",
    "",
    "Nodes that must receive every plant/sample and are waited for; names with spaces between.",
)
