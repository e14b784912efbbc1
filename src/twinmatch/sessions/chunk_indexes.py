"""The index of the chunks of an MCAP file, kept on disk until the file is finished."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mcap.data_stream import RecordBuilder
    from mcap.records import ChunkIndex

__all__ = ["ChunkIndexes"]

BLOCK = 1 << 20
"""Bytes written to the summary at once."""


class _Block(NamedTuple):
    """Encoded chunk index records for the summary."""

    data: bytes

    def write(self, stream: RecordBuilder) -> None:
        stream.write(self.data)


class ChunkIndexes:
    """Replaces the list in which a writer collects its chunk indexes.

    The file has no name: it vanishes with the process, however it ends.
    """

    def __init__(self, folder: Path) -> None:
        """Start empty; the file is in this folder, on the disk of the session."""
        from mcap.data_stream import RecordBuilder  # noqa: PLC0415 - as for the writer

        self._file = tempfile.TemporaryFile(dir=folder, prefix=".chunks-")  # noqa: SIM115 - closed with the object
        self._record = RecordBuilder()

    def append(self, index: ChunkIndex) -> None:
        """Append the index of a chunk; raises `OSError` if writing fails."""
        index.write(self._record)
        self._file.write(self._record.end())  # type: ignore[no-untyped-call]

    def __iter__(self) -> Iterator[_Block]:
        self._file.seek(0)
        while data := self._file.read(BLOCK):
            yield _Block(data)

    def close(self) -> None:
        """Close the file, which deletes it."""
        self._file.close()
