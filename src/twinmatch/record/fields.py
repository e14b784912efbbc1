"""The fields of a recorded dataclass or named tuple, from its type hints."""

from __future__ import annotations

import dataclasses
import types
from enum import Enum, auto
from functools import cache
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.requirements import Requirement
from twinmatch.signals import OperatingPoint


class RecordError(TwinmatchError):
    """A record has missing or invalid content."""


class Form(Enum):
    """How a field is written."""

    PLAIN = auto()
    """A number, a boolean or a text."""
    WORD = auto()
    """A member of an `Enum`: its word under the name with `_name`, its number under the name."""
    LIST = auto()
    """Numbers or texts."""
    ROWS = auto()
    """A square matrix as rows of numbers; row by row in a message."""
    ARRAY = auto()
    """A numpy array; row by row in a message."""
    POINT = auto()
    """An operating point: in a message always a list."""
    SPAN = auto()
    """First and last sample, under the names `first` and `last`."""
    NAMED = auto()
    """Numbers by name: the names, and the values under the field's name in the singular with `_values`."""
    PARAMETERS = auto()
    """Parameters of a plant."""
    PART = auto()
    """A nested recorded object."""
    PARTS = auto()
    """A list of recorded objects of one type."""
    INLINE = auto()
    """A recorded object whose fields are written among those of its owner."""


@dataclasses.dataclass(frozen=True)
class RecordField:
    """One field."""

    name: str
    """Name in the core, and in message and JSON unless its form says otherwise."""
    form: Form
    kind: Any
    """Type of the value, or of the elements of a list."""
    optional: bool = False
    """Whether it may be None."""
    columns: int = 0
    """Columns of an array; 0: one dimension, −1: as many as rows."""
    prefix: str = ""
    """Prefix of the names of an inline object's fields."""
    is_derived: bool = False
    """Whether it is derived from the others, so that it is written but never read."""
    requirements: tuple[Requirement, ...] = ()
    """What is expected of its values in a message."""


def fields_of(owner: type) -> tuple[RecordField, ...]:
    """The fields of a class in order, followed by the properties named in its `DERIVED`."""
    return _fields_of(owner)


@cache
def _fields_of(owner: Any) -> tuple[RecordField, ...]:
    hints = get_type_hints(owner, include_extras=True)
    columns: dict[str, int] = dict.fromkeys(getattr(owner, "_fields", ()), 0)
    if dataclasses.is_dataclass(owner):
        columns = {f.name: f.metadata.get("columns", 0) for f in dataclasses.fields(owner)}
    fields = [_field(owner, name, hints[name], wide) for name, wide in columns.items()]
    for name in getattr(owner, "DERIVED", ()):
        returned = get_type_hints(getattr(owner, name).fget, include_extras=True)["return"]
        fields.append(dataclasses.replace(_field(owner, name, returned, 0), is_derived=True))
    return tuple(fields)


def values_name(name: str) -> str:
    """Name of the values of a `NAMED` field."""
    return f"{name.removesuffix('s')}_values"


def _field(owner: type, name: str, declared: Any, columns: int) -> RecordField:
    hint, *requirements = get_args(declared) if get_origin(declared) is Annotated else (declared,)
    kind, optional = _unless_none(hint)
    origin = get_origin(kind)
    inside = get_args(kind)
    form = None
    prefix = ""
    if hint == OperatingPoint:
        form = Form.POINT
    elif kind in (bool, int, float, str):
        form = Form.PLAIN
    elif kind is Parameters:
        form = Form.PARAMETERS
    elif origin is np.ndarray:
        form = Form.ARRAY
        kind = float
    elif origin is tuple and inside == (int, int):
        form = Form.SPAN
        kind = int
    elif origin is tuple and inside[1:] == (...,):
        form, kind = _several(inside[0])
    elif inside == (str, float):
        form = Form.NAMED
    elif isinstance(kind, type) and issubclass(kind, Enum):
        form = Form.WORD
    elif _is_named_tuple(kind):
        form = Form.INLINE
        prefix = f"{name}_"
    elif dataclasses.is_dataclass(kind):
        form = Form.INLINE if _is_named_tuple(owner) else Form.PART
    if form is None:
        raise RecordError(f"record: {owner.__name__}.{name} is of type {hint}, which is not recorded")
    return RecordField(name, form, kind, optional, columns, prefix, requirements=tuple(requirements))


def _several(inside: Any) -> tuple[Form, Any]:
    if inside in (int, float, str):
        return Form.LIST, inside
    return (Form.ROWS, float) if get_origin(inside) is tuple else (Form.PARTS, inside)


def _unless_none(hint: Any) -> tuple[Any, bool]:
    """A type without None, and whether None was allowed."""
    if get_origin(hint) in (Union, types.UnionType):
        inside = [kind for kind in get_args(hint) if kind is not type(None)]
        return inside[0], len(inside) < len(get_args(hint))
    return hint, False


def _is_named_tuple(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields")
