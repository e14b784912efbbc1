"""Recorded objects as trees of plain values, messages and JSON documents, and trees compared bit for bit.

A tree has the field names of the message. Any object with these fields is a message: one of ROS 2, or one
decoded from a recording.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, TypeVar

import numpy as np

from twinmatch.description import Description
from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.plants import records
from twinmatch.record.fields import (
    SAMPLED,
    Form,
    RecordError,
    RecordField,
    fields_of,
    values_name,
)
from twinmatch.signals import NANOSECONDS, SignalError, Window, point_of, point_values

Tree = dict[str, Any]

Recorded = TypeVar("Recorded")

_Parts = dict[int, tuple[Any, dict[str, Any]]]
"""Parts of records that are described already, with their dictionaries, by identity; kept here, so that no
other object gets it."""
_ABSENT: Final[dict[Any, Any]] = {float: math.nan, int: -1, str: "", bool: False}


def tree_of(record: object) -> Tree:
    """The tree of an object."""
    tree: Tree = {}
    for field in fields_of(type(record)):
        tree.update(_WRITERS[field.form](field, getattr(record, field.name)))
    return tree


def object_of(kind: type[Recorded], tree: Tree) -> Recorded:
    """The object of a tree.

    Raises:
        RecordError: a field is missing, a word is unknown, or numbers do not have the field's shape or type.
        TwinmatchError: the parameters cannot be used.
    """
    try:
        values = {
            f.name: _READERS[f.form](f, tree)
            for f in fields_of(kind)
            if not f.is_derived
        }
    except KeyError as error:
        msg = f"record: a {kind.__name__} lacks {error.args[0]}; it was recorded by another version"
        raise RecordError(msg) from error
    except TwinmatchError:
        raise
    except (ValueError, OverflowError) as error:
        raise RecordError(
            f"record: a {kind.__name__} cannot be read: {error}"
        ) from error
    return kind(**values)


def documents_of(records: Iterable[Any]) -> list[dict[str, Any]]:
    """Objects as dictionaries of texts, finite numbers, booleans, None, lists and dictionaries.

    Absent values, NaN and infinities are None. A part that several of the objects hold, such as the scores of
    a candidate in successive verdicts, is one dictionary in all of them, so do not change it.
    """
    parts: _Parts = {}
    return [_described(record, parts) for record in records]


def _described(record: Any, parts: _Parts) -> dict[str, Any]:
    known = parts.get(id(record))
    if known is not None:
        return known[1]
    document: dict[str, Any] = {}
    for field in fields_of(type(record)):
        value = getattr(record, field.name)
        if field.form is Form.PLAIN:  # most are
            document[field.name] = (
                None if isinstance(value, float) and not math.isfinite(value) else value
            )
        elif value is None:
            document[field.name] = None
        else:
            document.update(_entries(field, value, parts))
    parts[id(record)] = record, document
    return document


def fill(message: Any, tree: Tree, part: Callable[[str], Any]) -> Any:
    """Write a tree into a message of ROS 2 and return it.

    A word is written together with its number, the message's constant of that name.

    Args:
        message: a new message.
        tree: its fields.
        part: creates an empty message of a type given by its short name, for lists of parts.
    """
    kinds = message.get_fields_and_field_types()
    for name, value in tree.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value, part)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = (
                kinds[name]
                .removeprefix("sequence<")
                .removesuffix(">")
                .rpartition("/")[2]
            )
            setattr(message, name, [fill(part(kind), item, part) for item in value])
        else:
            setattr(message, name, float(value) if kinds[name] == "double" else value)
            number = name.removesuffix("_name")
            if number != name and number in kinds:
                setattr(message, number, getattr(type(message), value.upper()))
    return message


def tree_of_message(message: Any) -> Tree:
    """A message as a tree, with only `stamp` (ns) of the header and only the word of a level or status."""
    names = [
        name.removeprefix("_") for name in message.__slots__ if name != "_check_fields"
    ]
    tree: Tree = {}
    for name in names:
        value = getattr(message, name)
        if name == "header":
            tree["stamp"] = value.stamp.sec * NANOSECONDS + value.stamp.nanosec
        elif f"{name}_name" not in names:
            tree[name] = _plain(value)
    return tree


def description_tree(description: Description, period: float) -> Tree:
    """A plant as in `PlantDescription`; `period` (s) is the sampling period it is run with."""
    return tree_of(description) | {"period": period}


def parameters_tree(parameters: Parameters | None) -> dict[str, Any]:
    """The parameters as in a message; for None without names."""
    fields = records.named(parameters)._asdict()
    return {
        key: value if isinstance(value, str) else list(value)
        for key, value in fields.items()
    }


def parameters_of(tree: Mapping[str, Any]) -> Parameters | None:
    """The parameters of such a tree; None if it has none."""
    return records.parameters_of(
        tree["plant"], tree["structure"], tree["names"], tree["values"]
    )


def _absent_part(kind: type) -> Tree:
    """An absent part: all NaN, including counts, which are float64 in a message."""
    return {field.name: math.nan for field in fields_of(kind)}


def _bands_tree(field: RecordField, bands: Sequence[Any]) -> Tree:
    """A table for each field of the bands, row by row."""
    tree: Tree = {}
    for name, key in field.columns_of_bands.items():
        tree[key] = (
            np.stack([getattr(band, name) for band in bands], axis=1).ravel().tolist()
        )
    return tree


def _window_tree(window: Window) -> Tree:
    signals = {
        name: getattr(window, field).ravel().tolist() for name, field in SAMPLED.items()
    }
    return {
        **signals,
        "first": window.first,
        "period": window.period,
        "lost": list(window.lost),
    }


_WRITERS: Final[dict[Form, Callable[[RecordField, Any], Tree]]] = {
    Form.PLAIN: lambda f, v: {f.key: _ABSENT[f.kind] if v is None else v},
    Form.WORD: lambda f, v: {f"{f.key}_name": v.value},
    Form.LIST: lambda f, v: {f.key: list(v)},
    Form.ROWS: lambda f, v: {f.key: [item for row in v for item in row]},
    Form.ARRAY: lambda f, v: {f.key: v.ravel().tolist()},
    Form.POINT: lambda f, v: {f.key: list(point_values(v))},
    Form.SPAN: lambda _, v: {"first": v[0], "last": v[1]},
    Form.NAMED: lambda f, v: {f.key: list(v), values_name(f.key): list(v.values())},
    Form.PARAMETERS: lambda f, v: {f.key: parameters_tree(v)},
    Form.PART: lambda f, v: {f.key: _absent_part(f.kind) if v is None else tree_of(v)},
    Form.PARTS: lambda f, v: {f.key: [tree_of(item) for item in v]},
    Form.BANDS: _bands_tree,
    Form.WINDOW: lambda _, v: _window_tree(v),
    Form.INLINE: lambda f, v: {
        f.key_inside(key): item for key, item in tree_of(v).items()
    },
}
"""How a field of each form is written into a tree."""


def _read_plain(field: RecordField, tree: Tree) -> Any:
    value = tree[field.key]
    kind = field.kind
    absent = math.isnan(value) if kind is float else value == _ABSENT[kind]
    return None if field.optional and absent else kind(value)


def _read_word(field: RecordField, tree: Tree) -> Any:
    word = tree[f"{field.key}_name"]
    try:
        return field.kind(word)
    except ValueError as error:
        expected = ", ".join(member.value for member in field.kind)
        raise RecordError(
            f"record: {word!r} is unknown; expected one of {expected}"
        ) from error


def _read_array(field: RecordField, tree: Tree, columns: int) -> Any:
    flat = np.array(tree[field.key], dtype=np.float64)
    if columns == 0:
        return flat
    return flat.reshape((-1, columns) if columns > 0 else (math.isqrt(flat.size),) * 2)


def _read_parameters(field: RecordField, tree: Tree) -> Parameters | None:
    parameters = parameters_of(tree[field.key])
    if parameters is None and not field.optional:
        raise RecordError(f"record: {field.key} are missing")
    return parameters


def _read_part(field: RecordField, tree: Tree) -> Any:
    part = tree[field.key]
    absent = field.optional and math.isnan(next(iter(part.values())))
    return None if absent else object_of(field.kind, part)


def _read_inline(field: RecordField, tree: Tree) -> Any:
    prefix = field.prefix
    inside = {
        k.removeprefix(prefix): v for k, v in tree.items() if k.startswith(prefix)
    }
    if field.sent.is_first_bare:
        inside[fields_of(field.kind)[0].key] = tree[field.key]
    return object_of(field.kind, inside)


def _read_bands(field: RecordField, tree: Tree) -> Any:
    rows = len(tree[field.rows])
    tables = [
        np.array(tree[key]).reshape(rows, -1).T
        for key in field.columns_of_bands.values()
    ]
    return tuple(field.kind(*columns) for columns in zip(*tables, strict=True))


def _read_window(field: RecordField, tree: Tree) -> Window:
    """A window; `SignalError`: its values do not make samples, or samples outside it are called lost."""
    parameters = parameters_of(tree[field.plant])
    if parameters is None:
        raise RecordError(f"record: {field.plant} are missing")
    count = len(tree["output"]) // len(parameters.model.plant.outputs)
    signals = {}
    for name, signal in SAMPLED.items():
        values = np.array(tree[name])
        if not count or values.size % count:
            msg = f"match request: {values.size} values of {name} do not divide evenly among {count} samples"
            raise SignalError(msg)
        signals[signal] = values.reshape(count, -1)
    lost = np.array(tree["lost"], dtype=np.int64) - tree["first"]
    if lost.size and not (lost.min() >= 0 and lost.max() < count):
        msg = f"match request: lost samples {tree['lost']} lie outside its window of {count} samples"
        raise SignalError(msg)
    is_seen = np.ones(count, dtype=np.bool_)
    is_seen[lost] = False
    return Window(**signals, first=tree["first"], period=tree["period"], seen=is_seen)


_READERS: Final[dict[Form, Callable[[RecordField, Tree], Any]]] = {
    Form.PLAIN: _read_plain,
    Form.WORD: _read_word,
    Form.LIST: lambda f, tree: tuple(f.kind(item) for item in tree[f.key]),
    Form.ROWS: lambda f, tree: tuple(
        tuple(row) for row in _read_array(f, tree, -1).tolist()
    ),
    Form.ARRAY: lambda f, tree: _read_array(f, tree, f.columns),
    Form.POINT: lambda f, tree: point_of(tree[f.key]),
    Form.SPAN: lambda _, tree: (int(tree["first"]), int(tree["last"])),
    Form.NAMED: lambda f, tree: dict(
        zip(tree[f.key], tree[values_name(f.key)], strict=True)
    ),
    Form.PARAMETERS: _read_parameters,
    Form.PART: _read_part,
    Form.PARTS: lambda f, tree: tuple(object_of(f.kind, item) for item in tree[f.key]),
    Form.BANDS: _read_bands,
    Form.WINDOW: _read_window,
    Form.INLINE: _read_inline,
}
"""How a field of each form is read from a tree."""

_SHOWN: Final[dict[Form, Callable[[Any], Any]]] = {
    Form.WORD: lambda v: v.value,
    Form.ARRAY: lambda v: finite(v.tolist()),
}
"""How a value is shown in a document, if not as it is when `finite`."""


def _entries(field: RecordField, value: Any, parts: _Parts) -> dict[str, Any]:
    """The entries of a document that a field with a value makes."""
    name = field.name
    form = field.form
    if form is Form.PARTS:
        return {name: [_described(item, parts) for item in value]}
    if form is Form.SPAN:
        return {"first": value[0], "last": value[1]}
    if form in {Form.PART, Form.INLINE}:
        part = _described(value, parts)
        if form is Form.PART:
            return {name: part}
        return {f"{field.prefix}{key}": item for key, item in part.items()}
    if form is Form.PARAMETERS:
        plant, structure = value.model.key
        shown = {} if name != "parameters" else {"plant": plant, "structure": structure}
        return {**shown, name: dict(value)}
    return {name: _SHOWN.get(form, finite)(value)}


def finite(value: Any) -> Any:
    """A value for JSON: None for NaN and infinities, also in lists and dictionaries."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, str | int | None):
        # looking whether it is a mapping takes longer
        return value
    return (
        {key: finite(item) for key, item in value.items()}
        if isinstance(value, Mapping)
        else value
    )


def _plain(value: Any) -> Any:
    if hasattr(value, "__slots__"):
        return tree_of_message(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    return (
        [_plain(item) for item in value] if isinstance(value, list | tuple) else value
    )


RENAMED = {
    "residual_y": "driven_rms_y",
    "residual_u": "closed_rms_u",
    "held_back_fit_y": "held_back_y",
    "held_back_fit_u": "held_back_u",
}
"""Earlier names of fields, and their current names."""

BY_RESIDUALS = (
    "level",
    "nominal",
    "decided",
    "certainty",
    "order",
    "candidates",
    "nu_gap",
)
"""Fields that followed other rules before verdicts had a leader: structures were not candidates then, and the
level was computed from the residuals of the nominal twin."""


def comparable(tree: Tree) -> Tree:
    """The tree with current field names, and every named value under its own name."""
    if {"level", "candidates"} <= tree.keys() and "leader" not in tree:
        tree = {name: value for name, value in tree.items() if name not in BY_RESIDUALS}
    tree = {RENAMED.get(name, name): _inside(value) for name, value in tree.items()}
    if {"plant", "names", "values"} <= tree.keys():
        return _parameters_by_name(tree)
    if isinstance(tree.get("operating_point"), float):
        # before plants could have several outputs
        tree["operating_point"] = [tree["operating_point"]]
    if "seebeck" in tree:
        # the rig-specific message, before other plants were supported
        if math.isnan(tree["seebeck"]):
            return {"plant": "", "structure": ""}
        return {"plant": "peltier", **tree}
    if "start_values" in tree:
        tree["starts"] = dict(
            zip(tree["starts"], tree.pop("start_values"), strict=True)
        )
    if "sink_start" in tree:
        sink = tree.pop("sink_start")
        tree["starts"] = {} if math.isnan(sink) else {"sink": sink}
    return tree


def _parameters_by_name(tree: Tree) -> Tree:
    """Parameters whose names and values are lists, as one value under each name."""
    values = dict(zip(tree["names"], tree["values"], strict=True))
    parameters = {"plant": tree["plant"]}
    if tree["structure"] or not values:
        # before structures had names, the values implied the structure
        parameters["structure"] = tree["structure"]
    return parameters | values


def _inside(value: Any) -> Any:
    if isinstance(value, dict):
        return comparable(value)
    return [_inside(item) for item in value] if isinstance(value, list) else value


_NUMBER = re.compile(r"\[\d+\]")


def differences(
    recorded: Any, computed: Any, place: str = "", apart: set[str] | None = None
) -> Iterator[tuple[str, Any, Any]]:
    """Fields in which two trees differ, if only by a bit: path, recorded value, computed value.

    A field that only one of them has is a difference too, unless a set `apart` is given to collect it.
    """
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for name in (*recorded, *(name for name in computed if name not in recorded)):
            inside = f"{place}.{name}" if place else name
            if apart is not None and (name in recorded) != (name in computed):
                apart.add(_NUMBER.sub("", inside))
                continue
            yield from differences(
                recorded.get(name), computed.get(name), inside, apart
            )
    elif (
        isinstance(recorded, list)
        and isinstance(computed, list)
        and len(recorded) == len(computed)
    ):
        for number, (recorded_item, computed_item) in enumerate(
            zip(recorded, computed, strict=True)
        ):
            yield from differences(
                recorded_item, computed_item, f"{place}[{number}]", apart
            )
    elif not _same(recorded, computed):
        yield place, recorded, computed


def _same(recorded: Any, computed: Any) -> bool:
    if isinstance(recorded, float) and isinstance(computed, float | int):
        both_nan = math.isnan(recorded) and math.isnan(computed)
        return both_nan or struct.pack("<d", recorded) == struct.pack("<d", computed)
    return bool(recorded == computed)
