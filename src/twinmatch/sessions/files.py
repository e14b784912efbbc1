"""Reading files from outside: opened without blocking, and bounded; and the errors of sessions.

A path may be a pipe without a writer or an endless device, and a file may be larger than the memory. A file
that cannot be used raises an `OSError` with a `strerror`, like errors of the operating system, so that
callers catch only one kind.

TwinmatchError
├── SessionError           a session cannot be read or written
│   ├── DiskError          no room, or a folder that cannot be written
│   └── RecordingError     a recording (.mat, .csv, a bag) cannot be imported
└── DocumentError          a YAML or JSON text cannot be used, in `documents`
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

from twinmatch.errors import TwinmatchError

ProgressCallback = Callable[[int, int], None]
"""Called with the amount done and the total."""

MAX_LINE = 1 << 20
"""Longest line of a table, characters: tables of samples are far below, files without line ends above."""
LINES_BETWEEN = 10_000
"""Lines between two reports of progress."""


class SessionError(TwinmatchError):
    """A session cannot be read or written; the message names the file and the place in it."""


EXIT_DISK = 74
"""Exit code of a recorder that can no longer write: EX_IOERR of sysexits.h."""


class DiskError(SessionError):
    """A session cannot be written where it should be; what was written before can be read."""

    NODE_EXIT = EXIT_DISK

    @classmethod
    def of(cls, folder: Path, error: OSError, when: str) -> DiskError:
        """The error for a session's folder; `when` says how far it was."""
        why = f"{folder.parent} cannot be written ({error.strerror or error})"
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            why = f"no space left in {folder.parent}"
        return cls(
            f"session {folder.name}: {why} {when}; free some disk space or choose another folder"
        )


class RecordingError(SessionError):
    """A recording cannot be imported; the message names the file and the place in it."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading; pipes, devices, sockets and folders are refused without being opened.

    Raises:
        OSError: it does not exist, is not a regular file, or cannot be opened.
    """
    try:
        _require_regular(os.stat(path).st_mode)  # noqa: PTH116
        # It may have been replaced since: O_NONBLOCK keeps the call from waiting for a pipe's writer.
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


def part_of(
    progress: ProgressCallback | None, number: int, count: int
) -> ProgressCallback | None:
    """The callback for one task, `number` from 0, of `count` equally long ones, one after the other."""
    if progress is None:
        return None
    return lambda done, total: progress(number * total + done, count * total)


def read_bounded(path: Path, most: int) -> bytes:
    """All bytes of a file of at most `most` bytes.

    Raises:
        OSError: it is not a regular file, is longer, or cannot be read.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(
            errno.EFBIG, f"has more than {most} bytes, the limit for such a file"
        )
    return content


def lines_of(
    path: Path, progress: ProgressCallback | None = None, *, encoding: str = "utf-8-sig"
) -> Iterator[str]:
    """The lines of a text file, without line ends.

    Args:
        path: a regular file.
        encoding: UTF-8, with or without a byte-order mark, if not given.
        progress: called every `LINES_BETWEEN` lines with the bytes read so far and the total.

    Raises:
        OSError: it is not a regular file, cannot be read, or has a line of more than `MAX_LINE` characters.
        UnicodeDecodeError: it is not text in that encoding.
    """
    with open_regular(path) as file, TextIOWrapper(file, encoding=encoding) as text:
        size = os.fstat(file.fileno()).st_size
        number = 0
        while line := text.readline(MAX_LINE):
            number += 1
            if len(line) == MAX_LINE and not line.endswith("\n"):
                raise OSError(
                    errno.EFBIG, f"line {number} has more than {MAX_LINE} characters"
                )
            if progress is not None and number % LINES_BETWEEN == 0:
                progress(min(file.tell(), size), size)
            yield line.rstrip("\n")


def _require_regular(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder")
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a pipe, a device or a socket; give a file")
