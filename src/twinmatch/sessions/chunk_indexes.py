"""Where the chunks of an MCAP file are, kept on the disk until the file is finished."""

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
"""Bytes given to the summary at once."""


class _Block(NamedTuple):
    """Chunk index records as they stand in the summary."""

    data: bytes

    def write(self, stream: RecordBuilder) -> None:
        stream.write(self.data)


class ChunkIndexes:
    """Takes the place of the list in which a writer gathers its chunk indexes.

    The file has no name: it goes with the process, however that ends.
    """

    def __init__(self, folder: Path) -> None:
        """Begin empty; the file lies in this folder, on the disk of the session."""
        from mcap.data_stream import RecordBuilder  # noqa: PLC0415 - as for the writer

        self._file = tempfile.TemporaryFile(dir=folder, prefix=".chunks-")  # noqa: SIM115 - closed with the object
        self._record = RecordBuilder()

    def append(self, index: ChunkIndex) -> None:
        """Take the index of a chunk; raises `OSError` if the disk refuses it."""
        index.write(self._record)
        self._file.write(self._record.end())  # type: ignore[no-untyped-call]

    def __iter__(self) -> Iterator[_Block]:
        self._file.seek(0)
        while data := self._file.read(BLOCK):
            yield _Block(data)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()
