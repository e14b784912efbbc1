"""The fields of a recorded dataclass or named tuple, from its type hints."""

from __future__ import annotations

import dataclasses
import types
from enum import Enum, auto
from functools import cache
from typing import Annotated, Any, Final, Union, get_args, get_origin, get_type_hints

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.requirements import OfPlant, Requirement, RowsOf, SentAs
from twinmatch.signals import OperatingPoint, Window


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
    BANDS = auto()
    """Records of one type whose fields are arrays of the same length: each of these fields is a table, row by
    row, with a column for each record. The first has the name of the whole, that of the others begins so."""
    WINDOW = auto()
    """A window, whose fields are written among those of its owner."""
    INLINE = auto()
    """A recorded object whose fields are written among those of its owner."""


_AS_HERE: Final = SentAs()


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
    """What is required of its values in a message."""
    sent: SentAs = _AS_HERE
    """How it is written in a message."""
    rows: str = ""
    """Of bands: the field with a value for each of their rows."""
    plant: str = ""
    """Of a window: the field with parameters of its plant."""

    @property
    def key(self) -> str:
        """Its name in a message."""
        return self.sent.name or self.name

    @property
    def columns_of_bands(self) -> dict[str, str]:
        """Of bands: the name of each table in a message, by the field of the records."""
        first, *others = (field.name for field in dataclasses.fields(self.kind))
        return {first: self.key} | {name: f"{self.key}_{name}" for name in others}

    def key_inside(self, key: str) -> str:
        """The name in a message of a field of an inline object."""
        if self.sent.is_first_bare and key == fields_of(self.kind)[0].key:
            return self.key
        return f"{self.prefix}{key}"


SAMPLED: Final = {
    "reference": "references",
    "output": "outputs",
    "input": "inputs",
    "disturbances": "disturbances",
}
"""Fields of samples, windows and descriptions by their names in messages."""


def fields_of(owner: type) -> tuple[RecordField, ...]:
    """The fields of a class in order, followed by the properties named in its `DERIVED`."""
    return _fields_of(owner)


@cache
def _fields_of(owner: Any) -> tuple[RecordField, ...]:
    hints = get_type_hints(owner, include_extras=True)
    columns: dict[str, int] = dict.fromkeys(getattr(owner, "_fields", ()), 0)
    if dataclasses.is_dataclass(owner):
        columns = {
            f.name: f.metadata.get("columns", 0) for f in dataclasses.fields(owner)
        }
    fields = [_field(owner, name, hints[name], wide) for name, wide in columns.items()]
    for name in getattr(owner, "DERIVED", ()):
        returned = get_type_hints(getattr(owner, name).fget, include_extras=True)[
            "return"
        ]
        fields.append(
            dataclasses.replace(_field(owner, name, returned, 0), is_derived=True)
        )
    return tuple(fields)


def values_name(name: str) -> str:
    """Name of the values of a `NAMED` field."""
    return f"{name.removesuffix('s')}_values"


def _field(owner: type, name: str, declared: Any, columns: int) -> RecordField:
    hint, *remarks = (
        get_args(declared) if get_origin(declared) is Annotated else (declared,)
    )
    requirements = tuple(remark for remark in remarks if hasattr(remark, "problem"))
    sent = next((remark for remark in remarks if isinstance(remark, SentAs)), _AS_HERE)
    rows = next(
        (
            requirement.field
            for requirement in requirements
            if isinstance(requirement, RowsOf)
        ),
        "",
    )
    plant = next(
        (remark.parameters for remark in remarks if isinstance(remark, OfPlant)), ""
    )
    unless_none, optional = _unless_none(hint)
    form, kind = _form_of(owner, hint, unless_none, sent)
    if form is None:
        raise RecordError(
            f"record: {owner.__name__}.{name} is of type {hint}, which is not recorded"
        )
    has_prefix = form is Form.INLINE and (_is_named_tuple(kind) or sent.is_first_bare)
    return RecordField(
        name,
        form,
        kind,
        optional,
        columns,
        prefix=f"{sent.name or name}_" if has_prefix else "",
        requirements=requirements,
        sent=sent,
        rows=rows,
        plant=plant,
    )


def _form_of(
    owner: type, hint: Any, kind: Any, sent: SentAs
) -> tuple[Form | None, Any]:
    """The form of a field with this type, and the type of its value or elements; None: it is not recorded.

    `kind` is the type without None.
    """
    if hint == OperatingPoint or sent.is_listed:
        return Form.POINT, kind
    if get_origin(kind) is not None:
        return _form_of_container(kind)
    if kind in _FORMS:
        return _FORMS[kind], kind
    if isinstance(kind, type) and issubclass(kind, Enum):
        return Form.WORD, kind
    return _form_of_record(owner, kind, sent), kind


_FORMS: Final[dict[Any, Form]] = {
    **dict.fromkeys((bool, int, float, str), Form.PLAIN),
    Parameters: Form.PARAMETERS,
    Window: Form.WINDOW,
}


def _form_of_record(owner: type, kind: Any, sent: SentAs) -> Form | None:
    """The form of a field that holds a recorded object; None: it holds something else."""
    if _is_named_tuple(kind):
        return Form.INLINE
    if not dataclasses.is_dataclass(kind):
        return None
    return Form.INLINE if _is_named_tuple(owner) or sent.is_first_bare else Form.PART


def _form_of_container(kind: Any) -> tuple[Form | None, Any]:
    inside = get_args(kind)
    if get_origin(kind) is np.ndarray:
        return Form.ARRAY, float
    if get_origin(kind) is tuple and inside == (int, int):
        return Form.SPAN, int
    if get_origin(kind) is tuple and inside[1:] == (...,):
        return _several(inside[0])
    return (Form.NAMED if inside == (str, float) else None), kind


def _several(inside: Any) -> tuple[Form, Any]:
    if inside in (int, float, str):
        return Form.LIST, inside
    if get_origin(inside) is tuple:
        return Form.ROWS, float
    return (Form.BANDS if _has_only_arrays(inside) else Form.PARTS), inside


def _has_only_arrays(kind: Any) -> bool:
    hints = get_type_hints(kind).values()
    return bool(hints) and all(get_origin(hint) is np.ndarray for hint in hints)


def _unless_none(hint: Any) -> tuple[Any, bool]:
    """A type without None, and whether None was allowed."""
    if get_origin(hint) in (Union, types.UnionType):
        inside = [kind for kind in get_args(hint) if kind is not type(None)]
        return inside[0], len(inside) < len(get_args(hint))
    return hint, False


def _is_named_tuple(hint: Any) -> bool:
    return (
        isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields")
    )
