"""What all messages have in common, by the types and names of their fields.

Stamps are not negative, indices are exact as float64, texts and lists are of bounded length, and parameters
have one finite value for each name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, Final

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.plants.records import is_marked
from twinmatch.settings import Rule

Expected = type[Plant] | None
"""The plant whose parameters alone are expected; None: any."""


class MessageError(TwinmatchError):
    """A message is not what its description says."""


class FieldSizes(Rule):
    """The most that a field may hold; messages of twins and plants have far less."""

    characters: int = 20_000
    """Of a text."""
    values: int = 200_000
    """Of a list."""
    structures: int = 32
    """Of other processes, whose names this process keeps."""


_MOST: Final = FieldSizes()
GREATEST_INDEX: Final = 2**53
"""Indices below are exact as float64."""
_INDICES: Final = frozenset(
    {"sample", "first", "last", "index", "sequence", "fault_since", "miss_since"}
)


def check_fields(message: Any, plant: Expected) -> None:
    """Check the fields of a message, and of those nested in it, by their types and names.

    Raises:
        MessageError: one is not what is expected.
    """
    kind: Any = type(message)
    for name, test in _fields_to_check(kind):
        test(getattr(message, name), name, plant)


Test = Callable[[Any, str, Expected], None]
"""Takes a field's value, its name and the expected plant."""


@cache
def _fields_to_check(kind: Any) -> tuple[tuple[str, Test], ...]:
    """The fields of a type that have a check by their type or name, and that check."""
    tests: list[tuple[str, Test]] = []
    for name, text in kind.get_fields_and_field_types().items():
        several = text.startswith("sequence<")
        base = text.removeprefix("sequence<").rstrip(">").split(",")[0]
        if "/" in base and several:
            tests.append((name, _check_parts))
        elif "/" in base:
            tests.append((name, _PARTS.get(base, _check_part)))
        elif several:
            tests.append((name, _check_texts if base == "string" else _check_list))
        elif base == "string":
            tests.append((name, _check_text))
        elif name in _INDICES and base in ("uint64", "int64"):
            tests.append((name, _check_index))
    return tuple(tests)


def _check_stamp(stamp: Any, name: str, plant: Expected = None) -> None:  # noqa: ARG001
    if stamp.sec < 0 or stamp.nanosec >= 1_000_000_000:
        raise MessageError(
            f"{name} is {stamp.sec} s and {stamp.nanosec} ns; a time is not negative"
        )


def _check_header(header: Any, name: str, plant: Expected) -> None:  # noqa: ARG001
    _check_stamp(header.stamp, "its stamp")
    _check_text(header.frame_id, "frame_id", plant)


def _check_index(index: Any, name: str, plant: Expected) -> None:  # noqa: ARG001
    if not -1 <= index < GREATEST_INDEX:
        raise MessageError(f"{name} is {index}; expected −1 to 2⁵³")


def _check_text(text: Any, name: str, plant: Expected) -> None:  # noqa: ARG001
    if len(text) > _MOST.characters:
        raise MessageError(
            f"{name} has {len(text)} characters; {_MOST.characters} is the most"
        )


def _check_list(values: Any, name: str, plant: Expected) -> None:  # noqa: ARG001
    if len(values) > _MOST.values:
        raise MessageError(
            f"{name} has {len(values)} values; {_MOST.values} is the most"
        )


def _check_texts(texts: Any, name: str, plant: Expected) -> None:
    _check_list(texts, name, plant)
    for text in texts:
        _check_text(text, name, plant)


def _check_parts(parts: Any, name: str, plant: Expected) -> None:
    _check_list(parts, name, plant)
    for part in parts:
        check_fields(part, plant)


def _check_part(part: Any, name: str, plant: Expected) -> None:  # noqa: ARG001
    check_fields(part, plant)


_structures: set[tuple[str, str]] = set()


def _check_parameters(parameters: Any, name: str, plant: Expected) -> None:
    _check_texts(
        (parameters.plant, parameters.structure, *parameters.names), name, plant
    )
    names = parameters.names
    values = parameters.values
    if len(names) != len(values) or len(parameters.units) not in (0, len(names)):
        msg = f"{name}: {len(names)} names with {len(values)} values; give one value for each name"
        raise MessageError(msg)
    if len(set(names)) != len(names):
        raise MessageError(f"{name}: a name is given twice")
    if not all(map(math.isfinite, values)):
        wrong = next(
            n for n, v in zip(names, values, strict=True) if not math.isfinite(v)
        )
        raise MessageError(f"{name}: {wrong} is not a finite number")
    if plant is not None and parameters.plant not in ("", plant.name):
        raise MessageError(
            f"{name}: are those of plant {parameters.plant!r}; this run is of {plant.name}"
        )
    if plant is not None and parameters.structure not in ("", *plant.structures):
        raise MessageError(
            f"{name}: {plant.name} has no structure {parameters.structure!r}"
        )
    if is_marked(parameters.structure):
        _structures.add((parameters.plant, parameters.structure))
        if len(_structures) > _MOST.structures:
            _structures.discard((parameters.plant, parameters.structure))
            raise MessageError(
                f"{name}: more than {_MOST.structures} structures are FMUs"
            )


_PARTS: Final[dict[str, Test]] = {
    "std_msgs/Header": _check_header,
    "builtin_interfaces/Time": _check_stamp,
    "twinmatch_msgs/Parameters": _check_parameters,
}
"""Checks of nested messages that are alike wherever they occur."""
