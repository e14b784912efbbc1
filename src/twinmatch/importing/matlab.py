"""Matrices of a MATLAB file of version 5 (`save -v6` and `-v7`), checked before they are unpacked.

A few kilobytes may unpack to gigabytes, and the sizes a file states may be wrong. The search over the
variables therefore unpacks only the beginning of each, which has name, class and dimensions; only those
wanted are unpacked, at most to the size given by their dimensions, and then decoded in memory by `scipy`.

Source: MathWorks, *MAT-File Format*, section "Level 5 MAT-File Format".
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np

from twinmatch.sessions.files import RecordingError, open_regular
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_ORDERS: Final = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
"""Byte order by the version and mark at the end of the header."""
_HEADER: Final = 128
"""Bytes before the first variable."""
_HEAD: Final = 1024
"""Bytes of a variable that are searched for its flags, dimensions and name."""
_BESIDE_VALUES: Final = 64 * 1024
"""Bytes that a variable may have besides its values: tags, name, padding."""


class MatlabLimits(Rule):
    """How much of a file is read."""

    variables: int = 10_000
    shown: int = 20
    """Most names of variables in one message."""
    values: int = 40_000_000
    """Most numbers, 320 MB: ten million samples of four signals, a day at 100 Hz."""


_MOST: Final = MatlabLimits()


_NUMERIC: Final = range(6, 16)
"""Classes of arrays of numbers, `double` to `uint64`."""
_COMPLEX: Final = 0x08


class _Element(IntEnum):
    """Kinds of parts of a file that hold a variable."""

    MATRIX = 14
    COMPRESSED = 15


class _DamagedError(Exception):
    """The bytes do not follow the format."""


class _Variable(NamedTuple):
    name: str
    shape: tuple[int, ...]
    is_real: bool
    """Whether it is a full array of real numbers."""
    at: int
    """Where its tag begins in the file."""
    kind: int
    """Matrix or compressed matrix."""
    size: int
    """Bytes after the tag."""


def read_matrices(path: Path, name: str = "", width: int = 0) -> dict[str, FloatArray]:
    """Read the longest vectors and matrices of real numbers, by name, each of two dimensions.

    With a `name`, that matrix is the only one wanted, and `width` the number of its columns.

    Raises:
        RecordingError: the file is not of version 5, or has no such matrix of this shape and size.
        OSError: the file cannot be read.
    """
    with open_regular(path) as file:
        header = file.read(_HEADER)
        order = _ORDERS.get(header[124:])
        if header.startswith(b"MATLAB 7.3"):
            raise RecordingError(
                f"{path}: is a MATLAB 7.3 file; save it again with the option -v7"
            )
        if order is None:
            raise RecordingError(
                f"{path}: is not a MATLAB file of version 5; save it with the option -v7"
            )
        try:
            present = list(_variables(file, order))
            wanted = (
                [_named(path, present, name, width)]
                if name
                else _longest(path, present)
            )
            values = sum(math.prod(variable.shape) for variable in wanted)
            if values > _MOST.values:
                many = f"{', '.join(v.name for v in wanted[: _MOST.shown])} with {values} values"
                raise RecordingError(
                    f"{path}: has {many}; split it into parts of at most {_MOST.values}"
                )
            return {
                v.name: _decode(header + _unpack(file, v, order), v) for v in wanted
            }
        except _DamagedError as error:
            raise RecordingError(
                f"{path}: is truncated or damaged; copy it again ({error})"
            ) from error


def _named(path: Path, present: list[_Variable], name: str, width: int) -> _Variable:
    """The matrix of this name, with so many columns.

    Raises:
        RecordingError: there is no such matrix.
    """
    wanted = next((variable for variable in present if variable.name == name), None)
    if wanted is None:
        ellipsis = ", …" if len(present) > _MOST.shown else ""
        names = (
            ", ".join(variable.name[:40] for variable in present[: _MOST.shown])
            or "nothing"
        )
        raise RecordingError(f"{path}: has no matrix {name}; it has {names}{ellipsis}")
    if not wanted.is_real:
        raise RecordingError(
            f"{path}: {name} is not a matrix of real numbers; log it as an array"
        )
    if len(wanted.shape) != 2 or wanted.shape[0] < 0 or wanted.shape[1] != width:
        raise RecordingError(
            f"{path}: {name} has the shape {wanted.shape}; it needs {width} columns"
        )
    return wanted


def _longest(path: Path, present: list[_Variable]) -> list[_Variable]:
    """The vectors and matrices with the most rows; scalars are not signals."""
    tables = [
        v
        for v in present
        if v.is_real and len(v.shape) == 2 and min(v.shape) > 0 and max(v.shape) > 1
    ]
    if not tables:
        raise RecordingError(
            f"{path}: has no vector or matrix of real numbers; save the signals as arrays"
        )
    rows = {v: max(v.shape) if 1 in v.shape else v.shape[0] for v in tables}
    return [v for v in tables if rows[v] == max(rows.values())]


def _variables(file: BinaryIO, order: str) -> Iterator[_Variable]:
    """All variables of a file with this byte order, from their beginnings."""
    position = _HEADER
    for _ in range(_MOST.variables):
        file.seek(position)
        tag = file.read(8)
        if not tag:
            return
        if len(tag) < 8:
            raise _DamagedError("a variable begins where the file ends")
        kind, size = struct.unpack(f"{order}II", tag)
        if kind not in (_Element.MATRIX, _Element.COMPRESSED):
            raise _DamagedError(f"no variable begins at byte {position}")
        head = file.read(min(size, _HEAD))
        try:
            if kind == _Element.COMPRESSED:
                head = zlib.decompressobj().decompress(head, _HEAD)[8:]
            yield _Variable(*_described(head, order), position, kind, size)
        except (struct.error, zlib.error, IndexError) as error:
            raise _DamagedError(
                f"the variable at byte {position} has no readable beginning: {error}"
            ) from error
        position += 8 + size
    raise _DamagedError(f"there are more than {_MOST.variables} variables")


def _described(head: bytes, order: str) -> tuple[str, tuple[int, ...], bool]:
    """Name, shape, and whether it is a real array, from the beginning of a variable."""
    (flags,) = struct.unpack_from(f"{order}I", head, 8)
    is_real = flags & 0xFF in _NUMERIC and not (flags >> 8) & _COMPLEX
    dimensions, position = _part(head, 16, order)
    name, _ = _part(head, position, order)
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    return name.decode("latin-1"), shape, is_real


def _part(head: bytes, position: int, order: str) -> tuple[bytes, int]:
    """The bytes of the part at a position, and the position of the next part."""
    kind, size = struct.unpack_from(f"{order}II", head, position)
    if kind >> 16:  # up to four bytes are in the tag itself
        return head[position + 4 : position + 4 + min(kind >> 16, 4)], position + 8
    if size > len(head) - position - 8:
        raise IndexError("a part is longer than the whole")
    padded_size = -(-size // 8) * 8  # parts begin at multiples of eight bytes
    return head[position + 8 : position + 8 + size], position + 8 + padded_size


def _unpack(file: BinaryIO, wanted: _Variable, order: str) -> bytes:
    """A variable with its tag, unpacked up to the size that its dimensions allow."""
    most = math.prod(wanted.shape) * 8 + _BESIDE_VALUES
    file.seek(wanted.at + 8)
    content = file.read(min(wanted.size, most))
    if wanted.kind == _Element.MATRIX:
        if wanted.size > most:
            raise _DamagedError(f"{wanted.name} is longer than its dimensions say")
        return struct.pack(f"{order}II", _Element.MATRIX, wanted.size) + content
    try:
        unpacker = zlib.decompressobj()
        unpacked = unpacker.decompress(content, most)
    except zlib.error as error:
        raise _DamagedError(str(error)) from error
    if not unpacker.eof:
        raise _DamagedError(f"{wanted.name} does not end where its dimensions say")
    return unpacked


def _decode(content: bytes, wanted: _Variable) -> FloatArray:
    from scipy.io import loadmat  # noqa: PLC0415

    try:
        loaded = loadmat(BytesIO(content), variable_names=[wanted.name])[wanted.name]  # type: ignore[arg-type]  # it accepts files too
        return np.asarray(loaded, dtype=np.float64).reshape(wanted.shape)
    except Exception as error:  # the library raises many kinds for damaged bytes
        raise _DamagedError(str(error)) from error
