"""Messages between this process and that of an FMU: a header in JSON, then numbers.

Nothing that is read here can become code, since the other process runs an untrusted program.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["Message", "WireError", "packed", "unpacked"]

MOST_HEADER: Final = 1 << 24
MOST_NUMBERS: Final = 1 << 27
"""Largest header, and largest block of numbers after it, bytes."""

_LENGTHS: Final = struct.Struct("<II")


class WireError(Exception):
    """The received bytes are not a valid message."""


class Message(NamedTuple):
    """A header, and arrays by name."""

    header: Mapping[str, Any]
    arrays: Mapping[str, FloatArray]


def packed(header: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> bytes:
    """Encode a message."""
    held = {name: np.ascontiguousarray(array, dtype="<f8") for name, array in arrays.items()}
    shapes = [[name, list(array.shape)] for name, array in held.items()]
    head = json.dumps({**header, "arrays": shapes}).encode()
    body = b"".join(array.tobytes() for array in held.values())
    return _LENGTHS.pack(len(head), len(body)) + head + body


def unpacked(read: Callable[[int], bytes]) -> Message:
    """Decode a message; `read` returns the requested number of bytes.

    Raises:
        WireError: the bytes are not a valid message.
    """
    lengths = read(_LENGTHS.size)
    size, numbers = _LENGTHS.unpack(lengths)
    if size > MOST_HEADER or numbers > MOST_NUMBERS:
        raise WireError(f"a message of {size} and {numbers} bytes")
    try:
        header = json.loads(read(size))
        shapes = [(str(name), tuple(int(n) for n in shape)) for name, shape in header.pop("arrays")]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise WireError(f"a header that cannot be read: {error}") from error
    body, arrays, place = read(numbers), {}, 0
    for name, shape in shapes:
        count = math.prod(shape)
        if min(shape, default=0) < 0 or place + 8 * count > len(body):
            raise WireError(f"an array {name} of shape {shape} in {len(body)} bytes")
        arrays[name] = np.frombuffer(body, "<f8", count, place).reshape(shape).astype(np.float64)
        place += 8 * count
    return Message(header, arrays)
