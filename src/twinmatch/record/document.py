"""Recorded objects as JSON documents."""

from __future__ import annotations

import math
from typing import Any

from twinmatch.record.fields import Field, Form, fields_of
from twinmatch.record.named import parameters_document

__all__ = ["document_of"]


def document_of(record: Any) -> dict[str, Any]:
    """An object as a dictionary of texts, finite numbers, booleans, None, lists and dictionaries.

    Absent values, NaN and infinities are None.
    """
    document: dict[str, Any] = {}
    for field in fields_of(type(record)):
        document.update(_written(field, getattr(record, field.name)))
    return document


def _written(field: Field, value: Any) -> dict[str, Any]:
    if value is not None and field.form is Form.SPAN:
        return {"first": value[0], "last": value[1]}
    if value is not None and field.form is Form.INLINE:
        return {f"{field.prefix}{key}": item for key, item in document_of(value).items()}
    if value is None:
        shown = None
    elif field.form is Form.WORD:
        shown = value.value
    elif field.form is Form.ARRAY:
        shown = _finite(value.tolist())
    elif field.form is Form.PARAMETERS:
        plant, structure = value.model.key
        named = {} if field.name != "parameters" else {"plant": plant, "structure": structure}
        return {**named, field.name: parameters_document(value)}
    elif field.form is Form.NAMED:
        shown = {key: _finite(item) for key, item in value.items()}
    elif field.form is Form.PART:
        shown = document_of(value)
    elif field.form is Form.PARTS:
        shown = [document_of(item) for item in value]
    else:
        shown = _finite(value)
    return {field.name: shown}


def _finite(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
