"""Text of a table: its encoding, the lines that hold the table, and what separates its columns."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.files import lines_of, open_regular

__all__ = ["TableText", "table_text"]

_MARKS: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
"""Byte-order marks of encodings other than UTF-8."""
_ARCHIVE: Final = b"PK\x03\x04"
_WESTERN: Final = "cp1252"
"""What Windows programs write where they do not write UTF-8: `°` and `µ` are single bytes."""
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")
"""Characters that no text has; a file with them is binary, or has another encoding."""
_SEPARATOR: Final = re.compile(r"^\s*sep=(.)\s*$", re.IGNORECASE)
"""The line that names the separator for Excel."""


class TableText(NamedTuple):
    """Lines that are not empty and not comments."""

    numbers: tuple[int, ...]
    """Number of each line in the file, from 1."""
    lines: tuple[str, ...]
    divider: str
    """What separates columns."""


def table_text(path: Path) -> TableText:
    """Read a table's text.

    Raises:
        RecordingError: it is not text, or has less than a line of names and two rows.
        OSError: as `lines_of`.
    """
    held = [
        (k, line)
        for k, line in enumerate(_lines(path), 1)
        if line.strip(" ,;\t") and line.lstrip()[:1] != "#"
    ]
    stated = _SEPARATOR.match(held[0][1]) if held else None
    if stated:
        held = held[1:]
    if len(held) < 3:
        msg = f"{path}: give column names and at least two rows; the file has {len(held)} lines of a table"
        raise RecordingError(msg)
    numbers, lines = zip(*held, strict=True)
    divider = stated[1] if stated else max(",;\t", key=lines[0].count)
    return TableText(numbers, lines, divider)


def _lines(path: Path) -> list[str]:
    """All lines, in UTF-8, in UTF-16 with a byte-order mark, or in the encoding of Western Windows."""
    with open_regular(path) as file:
        first = file.read(4)
    if first == _ARCHIVE:
        msg = f"{path}: is a ZIP archive, such as an Excel workbook; save the table as CSV"
        raise RecordingError(msg)
    for encoding in (_MARKS.get(first[:2], "utf-8-sig"), _WESTERN):
        try:
            lines = list(lines_of(path, encoding=encoding))
        except UnicodeError:
            continue
        if not any(map(_CONTROL.search, lines)):
            return lines
        break
    raise RecordingError(f"{path}: is not text in a known encoding; save it as UTF-8")
