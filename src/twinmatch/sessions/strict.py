"""Whether a strict reader takes a file: all its checksums, and that its index points to what is there.

`Scan` reads what can be read; a file of which everything can be read may still have an index that leads
other programs astray. Only a file that this module takes is called complete.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from pathlib import Path
from typing import BinaryIO

from mcap.reader import SeekingReader
from mcap.records import Chunk, ChunkIndex, MessageIndex
from mcap.stream_reader import StreamReader

from twinmatch.sessions.files import open_regular
from twinmatch.sessions.records import HEAD


class _NotStrictError(Exception):
    """The index does not fit the data."""


def strict_refusal(path: Path) -> str:
    """Why a strict reader would not take a file; empty if it takes it.

    Raises:
        OSError: the file cannot be opened.
    """
    with open_regular(path) as file:
        try:
            _check_index(file)
            file.seek(0)
            _check_by_index(file)
        except OSError:
            raise
        except _NotStrictError as error:
            return str(error)
        except Exception as error:  # the library raises many kinds for damaged bytes
            return f"a strict reader refuses it ({type(error).__name__}: {' '.join(str(error).split())[:100]})"
    return ""


def _check_index(file: BinaryIO) -> None:
    """Read all records in their order, with all checksums; each index entry has to be true."""
    starts = array("Q")
    indexes = array("Q")
    listed = 0
    chunk: Chunk | None = None
    for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
        end = file.tell()
        if isinstance(record, Chunk):
            chunk = record
            starts.append(end - _length_of(record))
        elif isinstance(record, MessageIndex):
            indexes.append(end - HEAD.size - 6 - 16 * len(record.records))
            _check_messages(chunk, record)
        elif isinstance(record, ChunkIndex):
            listed += 1
            _check_entry(record, starts, indexes)
    if listed != len(starts):
        raise _NotStrictError(f"its index lists {listed} of {len(starts)} chunks")


def _check_messages(chunk: Chunk | None, index: MessageIndex) -> None:
    """Every entry of a message index is a message of its channel, at its place in the chunk before."""
    if chunk is None:
        raise _NotStrictError("an index of messages belongs to no chunk")
    if chunk.compression:
        # the places are those of the unpacked data, which the checksum of it confirms
        return
    for time, place in index.records:
        head = chunk.data[place : place + HEAD.size + 14]
        if (
            head[:1] != b"\x05"
            or int.from_bytes(head[9:11], "little") != index.channel_id
        ):
            raise _NotStrictError("an index of messages is wrong")
        if int.from_bytes(head[15:23], "little") != time:
            raise _NotStrictError("an index of messages is wrong")


def _check_entry(entry: ChunkIndex, starts: array[int], indexes: array[int]) -> None:
    if not _has(starts, entry.chunk_start_offset):
        raise _NotStrictError("its index points to chunks where there are none")
    if not all(_has(indexes, place) for place in entry.message_index_offsets.values()):
        raise _NotStrictError(
            "its index points to indexes of messages where there are none"
        )


def _has(places: array[int], place: int) -> bool:
    """Whether a place is among these, which are in order."""
    number = bisect_left(places, place)
    return number < len(places) and places[number] == place


def _length_of(chunk: Chunk) -> int:
    return HEAD.size + 40 + len(chunk.compression.encode()) + len(chunk.data)


def _check_by_index(file: BinaryIO) -> None:
    """Read all messages by the index, with all checksums."""
    reader = SeekingReader(file, validate_crcs=True)
    summary = reader.get_summary()
    if summary is None:
        raise _NotStrictError("it has no index")
    read = sum(1 for _ in reader.iter_messages(log_time_order=False))
    if summary.statistics is not None and summary.statistics.message_count != read:
        raise _NotStrictError(
            f"by its index it has {read} of {summary.statistics.message_count} messages"
        )
