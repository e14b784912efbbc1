"""Convert recorded objects to and from trees of plain values with the field names of their messages."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np

from twinmatch.record.fields import Field, Form, RecordError, fields_of, values_name
from twinmatch.record.named import parameters_of, parameters_tree

__all__ = ["Tree", "object_of", "tree_of"]

Tree = dict[str, Any]

Recorded = TypeVar("Recorded")

_ABSENT: dict[Any, Any] = {float: math.nan, int: -1, str: "", bool: False}


def tree_of(record: object) -> Tree:
    """The tree of an object."""
    tree: Tree = {}
    for field in fields_of(type(record)):
        tree.update(_written(field, getattr(record, field.name)))
    return tree


def object_of(kind: type[Recorded], tree: Tree) -> Recorded:
    """The object of a tree.

    Raises:
        RecordError: a field is missing, or a word is unknown.
        TwinmatchError: the parameters cannot be used.
    """
    try:
        values = {f.name: _read(f, tree) for f in fields_of(kind) if not f.made}
    except KeyError as error:
        msg = f"record: a {kind.__name__} lacks {error.args[0]}; it was recorded by another version"
        raise RecordError(msg) from error
    return kind(**values)


def _written(field: Field, value: Any) -> Tree:
    name, form = field.name, field.form
    if form is Form.SPAN:
        tree = {"first": value[0], "last": value[1]}
    elif form is Form.INLINE:
        tree = {f"{field.prefix}{key}": item for key, item in tree_of(value).items()}
    elif form is Form.WORD:
        tree = {f"{name}_name": value.value}
    elif form is Form.LIST:
        tree = {name: list(value)}
    elif form is Form.NAMED:
        tree = {name: list(value), values_name(name): list(value.values())}
    elif form is Form.ROWS:
        tree = {name: [item for row in value for item in row]}
    elif form is Form.ARRAY:
        tree = {name: value.ravel().tolist()}
    elif form is Form.PARAMETERS:
        tree = {name: parameters_tree(value)}
    elif form is Form.PARTS:
        tree = {name: [tree_of(item) for item in value]}
    elif form is Form.PART:
        tree = {name: _nothing(field.kind) if value is None else tree_of(value)}
    else:
        tree = {name: _ABSENT[field.kind] if value is None else value}
    return tree


def _nothing(kind: type) -> Tree:
    """An absent part: all NaN, including counts, which are float64 in a message."""
    return {field.name: math.nan for field in fields_of(kind)}


def _read(field: Field, tree: Tree) -> Any:
    if field.form is Form.SPAN:
        return (int(tree["first"]), int(tree["last"]))
    if field.form is Form.INLINE:
        begin = field.prefix
        inside = {k.removeprefix(begin): v for k, v in tree.items() if k.startswith(begin)}
        return object_of(field.kind, inside)
    if field.form is Form.NAMED:
        return dict(zip(tree[field.name], tree[values_name(field.name)], strict=True))
    if field.form is Form.WORD:
        return _word(field.kind, tree[f"{field.name}_name"])
    return _value(field, tree[field.name])


def _value(field: Field, held: Any) -> Any:
    form, kind = field.form, field.kind
    value: Any = None
    if form is Form.LIST:
        value = tuple(kind(item) for item in held)
    elif form is Form.ARRAY:
        value = _array(held, field.columns)
    elif form is Form.ROWS:
        value = tuple(tuple(row) for row in _array(held, -1).tolist())
    elif form is Form.PARAMETERS:
        value = _parameters(held, field)
    elif form is Form.PARTS:
        value = tuple(object_of(kind, item) for item in held)
    elif form is Form.PART:
        value = None if field.optional and _empty(held) else object_of(kind, held)
    elif not (field.optional and _absent(held, kind)):
        value = kind(held)
    return value


def _parameters(held: Tree, field: Field) -> Any:
    found = parameters_of(held)
    if found is None and not field.optional:
        msg = f"record: {field.name} are missing"
        raise RecordError(msg)
    return found


def _array(values: Any, columns: int) -> Any:
    flat = np.array(values, dtype=np.float64)
    if columns == 0:
        return flat
    return flat.reshape((-1, columns) if columns > 0 else (math.isqrt(flat.size),) * 2)


def _absent(value: Any, kind: Any) -> bool:
    return bool(math.isnan(value)) if kind is float else bool(value == _ABSENT[kind])


def _empty(tree: Tree) -> bool:
    """Whether a part is absent: its first value is NaN."""
    return math.isnan(next(iter(tree.values())))


def _word(kind: Any, word: str) -> Any:
    try:
        return kind(word)
    except ValueError as error:
        msg = f"record: {word!r} is unknown; expected one of {', '.join(one.value for one in kind)}"
        raise RecordError(msg) from error
