"""One matrix of a MATLAB file of version 5 (`save -v6` and `-v7`), checked before it is unpacked.

A few kilobytes may unpack to gigabytes, and the sizes a file states may be wrong. The search over the
variables therefore unpacks only the beginning of each, which has name, class and dimensions; only the wanted
one is unpacked, at most to the size given by its dimensions, and then decoded in memory by `scipy`.

Source: MathWorks, *MAT-File Format*, section "Level 5 MAT-File Format".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.files import open_regular

__all__ = ["MAT_BEGINNING", "read_matrix"]

MAT_BEGINNING = b"MATLAB 5.0 MAT-file"
HEADER = 128
"""Bytes before the first variable."""
HEAD = 1024
"""Bytes of a variable that are searched for its flags, dimensions and name."""
SLACK = 64 * 1024
"""Bytes that a variable may have besides its values: tags, name, padding."""
MOST_VARIABLES = 10_000
MOST_SHOWN = 20
"""Most names of variables in one message."""

_MATRIX, _COMPRESSED = 14, 15
_NUMERIC = range(6, 16)
"""Classes of arrays of numbers, `double` to `uint64`."""
_COMPLEX = 0x08


class _DamagedError(Exception):
    """The bytes do not follow the format."""


class _Variable(NamedTuple):
    """A variable, from its header in the file."""

    name: str
    shape: tuple[int, ...]
    real: bool
    """Whether it is a full matrix of real numbers."""
    at: int
    """Where its tag begins in the file."""
    kind: int
    """Matrix or compressed matrix."""
    size: int
    """Bytes after the tag."""


def read_matrix(path: Path, name: str, columns: int, most_rows: int) -> Any:
    """Read a matrix of real numbers, shape (N, columns).

    Raises:
        RecordingError: the file is not of version 5, or has no such matrix of this shape and size.
        OSError: the file cannot be read.
    """
    with open_regular(path) as file:
        header = file.read(HEADER)
        _check_beginning(path, header)
        order = ">" if header[126:128] == b"MI" else "<"
        try:
            held = list(_variables(file, order))
            wanted = next((variable for variable in held if variable.name == name), None)
            if wanted is None:
                more = ", …" if len(held) > MOST_SHOWN else ""
                names = ", ".join(variable.name[:40] for variable in held[:MOST_SHOWN]) or "nothing"
                msg = f"recording {path}: has no matrix {name}; it has {names}{more}"
                raise RecordingError(msg)
            _check(path, wanted, columns, most_rows)
            return _decoded(header + _unpacked(file, wanted, order), name)
        except _DamagedError as error:
            msg = f"recording {path}: is truncated or damaged; copy it again ({error})"
            raise RecordingError(msg) from error


def _check_beginning(path: Path, header: bytes) -> None:
    if header.startswith(b"MATLAB 7.3"):
        msg = f"recording {path}: is a MATLAB 7.3 file; save it again with the option -v7"
        raise RecordingError(msg)
    if not header.startswith(MAT_BEGINNING):
        msg = f"recording {path}: is not a MATLAB file of version 5; save it with the option -v7"
        raise RecordingError(msg)


def _check(path: Path, wanted: _Variable, columns: int, most_rows: int) -> None:
    """Refuse a matrix of wrong type, shape or size before it is unpacked."""
    if not wanted.real:
        msg = f"recording {path}: {wanted.name} is not a matrix of real numbers; log it as an array"
        raise RecordingError(msg)
    if len(wanted.shape) != 2 or wanted.shape[0] < 0 or wanted.shape[1] != columns:
        msg = (
            f"recording {path}: {wanted.name} has the shape {wanted.shape}; it needs {columns} columns: PWM, "
            "temperature, time, set-point"
        )
        raise RecordingError(msg)
    if wanted.shape[0] > most_rows:
        rows = wanted.shape[0]
        msg = f"recording {path}: {wanted.name} has {rows} rows; split it into parts of {most_rows}"
        raise RecordingError(msg)


def _variables(file: BinaryIO, order: str) -> Iterator[_Variable]:
    """The variables of the file, from their headers."""
    at = HEADER
    for _ in range(MOST_VARIABLES):
        file.seek(at)
        tag = file.read(8)
        if not tag:
            return
        if len(tag) < 8:
            raise _DamagedError("a variable begins where the file ends")
        kind, size = struct.unpack(f"{order}II", tag)
        if kind not in (_MATRIX, _COMPRESSED):
            raise _DamagedError(f"no variable begins at byte {at}")
        head = file.read(min(size, HEAD))
        try:
            if kind == _COMPRESSED:
                head = zlib.decompressobj().decompress(head, HEAD)[8:]
            yield _Variable(*_head(head, order), at, kind, size)
        except (struct.error, zlib.error, IndexError) as error:
            raise _DamagedError(f"the variable at byte {at} has no readable beginning: {error}") from error
        at += 8 + size
    raise _DamagedError(f"there are more than {MOST_VARIABLES} variables")


def _head(head: bytes, order: str) -> tuple[str, tuple[int, ...], bool]:
    """Name, shape, and whether it is a real matrix, from the beginning of a variable."""
    (flags,) = struct.unpack_from(f"{order}I", head, 8)
    real = flags & 0xFF in _NUMERIC and not (flags >> 8) & _COMPLEX
    dimensions, at = _part(head, 16, order)
    name, _ = _part(head, at, order)
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    return name.decode("latin-1"), shape, real


def _part(head: bytes, at: int, order: str) -> tuple[bytes, int]:
    """The bytes of the part at a position, and the position of the next part."""
    kind, size = struct.unpack_from(f"{order}II", head, at)
    if kind >> 16:  # up to four bytes are in the tag itself
        return head[at + 4 : at + 4 + min(kind >> 16, 4)], at + 8
    if size > len(head) - at - 8:
        raise IndexError("a part is longer than the whole")
    return head[at + 8 : at + 8 + size], at + 8 + -(-size // 8) * 8


def _unpacked(file: BinaryIO, wanted: _Variable, order: str) -> bytes:
    """The variable as in an uncompressed file, including its tag."""
    most = wanted.shape[0] * wanted.shape[1] * 8 + SLACK
    file.seek(wanted.at + 8)
    content = file.read(min(wanted.size, most))
    if wanted.kind == _MATRIX:
        if wanted.size > most:
            raise _DamagedError(f"{wanted.name} is longer than its dimensions say")
        return struct.pack(f"{order}II", _MATRIX, wanted.size) + content
    try:
        unpacker = zlib.decompressobj()
        unpacked = unpacker.decompress(content, most)
    except zlib.error as error:
        raise _DamagedError(str(error)) from error
    if not unpacker.eof:
        raise _DamagedError(f"{wanted.name} does not end where its dimensions say")
    return unpacked


def _decoded(content: bytes, name: str) -> Any:
    from scipy.io import loadmat  # noqa: PLC0415 - takes 0.25 s, not needed for sessions

    try:
        return loadmat(BytesIO(content), variable_names=[name])[name]  # type: ignore[arg-type]  # it accepts files too
    except Exception as error:  # the library raises many kinds for damaged bytes
        raise _DamagedError(str(error)) from error
