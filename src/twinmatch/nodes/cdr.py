"""Messages as the bytes they are.

rclpy serialises into a buffer that it measures first, too generously: behind an empty list it counts what
aligns a value that does not follow. Strict readers refuse the surplus bytes at the end.
"""

from __future__ import annotations

from typing import Any, Final

from rclpy.serialization import serialize_message
from rosidl_parser.definition import AbstractSequence, AbstractString, Array, BasicType

_HEAD: Final = 4
"""Bytes before the first field, from which positions do not count."""
_COUNT: Final = BasicType("uint32")
_SIZES: Final = {
    "boolean": 1, "octet": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2,
    "int32": 4, "uint32": 4, "float": 4, "int64": 8, "uint64": 8, "double": 8,
}  # fmt: skip


def serialized(message: Any) -> bytes:
    """A message of a type without wide strings as bytes that end with its last field."""
    data: bytes = serialize_message(message)
    return data[: _HEAD + _end(message, None, 0)]


def _end(value: Any, kind: Any, position: int) -> int:
    """The position at which a value ends if it begins at `position`; a `kind` of None is that of a
    message."""
    if isinstance(kind, BasicType):
        return _end_of_numbers(1, kind, position)
    if isinstance(kind, AbstractString):
        return _end_of_numbers(1, _COUNT, position) + len(value.encode()) + 1
    if isinstance(kind, AbstractSequence | Array):
        position = (
            _end_of_numbers(1, _COUNT, position)
            if isinstance(kind, AbstractSequence)
            else position
        )
        if isinstance(kind.value_type, BasicType):
            return _end_of_numbers(len(value), kind.value_type, position)
        for element in value:
            position = _end(element, kind.value_type, position)
        return position
    for name, part in zip(
        value.get_fields_and_field_types(), value.SLOT_TYPES, strict=True
    ):
        position = _end(getattr(value, name), part, position)
    return position


def _end_of_numbers(count: int, kind: BasicType, position: int) -> int:
    """The position at which so many numbers end, the first of them aligned to its size."""
    size = _SIZES[kind.typename]
    return position + (-position % size + count * size if count else 0)
