"""Files that come from outside: opened without waiting for anybody, and read only so far.

A name may stand for a pipe that nobody fills or a device that never ends, and a file may hold more than
there is memory. What cannot be used is an `OSError` whose `strerror` says why, as the operating system's own
are, so that a caller has one thing to catch and name.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

__all__ = ["Told", "lines_of", "open_regular", "read_bounded"]

Told = Callable[[int, int], None]
"""Is told how many of how many are done."""

MOST_LINE = 1 << 20
"""Longest line of a table, characters: no table of samples has one like it, a file without line ends has."""
LINES_BETWEEN = 10_000
"""Lines between two words about how far it has come."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading; pipes, devices, sockets and folders are refused without being opened.

    Raises:
        OSError: it is none, is not there, or cannot be opened.
    """
    try:
        _require_regular(os.stat(path).st_mode)  # noqa: PTH116 - as `fstat` below
        # It may have been exchanged since: without O_NONBLOCK a pipe would still be waited for.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a name with a zero byte in it
        raise OSError(errno.EINVAL, str(error)) from None
    file = os.fdopen(handle, "rb")
    try:
        _require_regular(os.fstat(handle).st_mode)
    except OSError:
        file.close()
        raise
    return file


def read_bounded(path: Path, most: int) -> bytes:
    """All bytes of a file that has at most `most` of them.

    Raises:
        OSError: it is no regular file, has more, or cannot be read.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"has more than {most} bytes, which is too long for what it is")
    return content


def lines_of(path: Path, told: Told | None = None) -> Iterator[str]:
    """The lines of a text in UTF-8, without their ends, one after the other.

    Args:
        path: a regular file.
        told: called now and then with the bytes read so far and all of them.

    Raises:
        OSError: it is no regular file, cannot be read, or has a line of more than `MOST_LINE` characters.
        UnicodeDecodeError: it is no text.
    """
    with open_regular(path) as file, TextIOWrapper(file, encoding="utf-8-sig") as text:
        size = os.fstat(file.fileno()).st_size
        number = 0
        while line := text.readline(MOST_LINE):
            number += 1
            if len(line) == MOST_LINE and not line.endswith("\n"):
                raise OSError(errno.EFBIG, f"line {number} has more than {MOST_LINE} characters")
            if told is not None and number % LINES_BETWEEN == 0:
                told(min(file.tell(), size), size)
            yield line.rstrip("\n")


def _require_regular(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder")
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a pipe, a device or a socket; give a file")
