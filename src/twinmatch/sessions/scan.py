"""Reads an MCAP file from its beginning as far as it is intact.

A killed recorder leaves a file without index, often truncated within a record. Libraries refuse such a file
or return partial data as if complete, so this module iterates over the records; the `mcap` library parses
each. A record is read completely before it is parsed, each chunk is checked against its CRC and unpacked only
up to the size it states, since some kilobytes may unpack to gigabytes. Reading ends at the first fault.
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Iterable, Iterator
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema, Statistics

from twinmatch.sessions.files import SessionError, open_regular
from twinmatch.sessions.messages import Message, Topic
from twinmatch.sessions.metadata import parse_qos

MAGIC = b"\x89MCAP0\r\n"

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_PRIVATE = 0x80
MAX_UNPACKED = 1 << 28
"""Longest chunk, unpacked bytes: recorders write chunks of a few megabytes, or one longer message."""

_WITHOUT = Schema(0, b"", "", "")
"""What number 0 stands for: messages that have no schema, such as JSON."""

_Record = TypeVar("_Record", Header, Schema, Channel, Chunk, Metadata, Statistics)


class _FaultError(Exception):
    """Reading ends here; the message says why."""


class _TornError(Exception):
    """The file ends within a record."""

    def __init__(self, opcode: int, body: bytes) -> None:
        super().__init__("the file is truncated")
        self.opcode = opcode
        self.body = body


class Scan:
    """One pass over a file: iterate it for the messages, then read topics, records and fault."""

    def __init__(self, path: Path) -> None:
        """Prepare to read a file; nothing is opened yet.

        Args:
            path: an MCAP file, complete or truncated.
        """
        self.path = path
        self.topics: list[Topic] = []
        """Topics found so far, with or without messages."""
        self.records: dict[str, dict[str, str]] = {}
        """Metadata records found so far; the last of those with the same name."""
        self.library = ""
        """Name of the program that wrote the file."""
        self.fault = ""
        """Why reading ended early; empty if it did not."""
        self.read = 0
        """Bytes of the file read so far."""
        self._count = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Topic] = {}

    def __iter__(self) -> Iterator[Message]:
        """The messages in the order in which they were written.

        Raises:
            SessionError: the file cannot be opened, is empty, or is not an MCAP file.
        """
        try:
            with open_regular(self.path) as file:
                if (beginning := file.read(len(MAGIC))) != MAGIC:
                    what = "is not a session: it does not begin like an MCAP file"
                    raise SessionError(f"session {self.path}: {what if beginning else 'the file is empty'}")
                yield from self._messages(file)
        except _FaultError as fault:
            self.fault = str(fault)
        except OSError as error:
            raise SessionError(f"session {self.path}: cannot be read ({error.strerror})") from error

    def _messages(self, file: BinaryIO) -> Iterator[Message]:
        try:
            records = _records(file, len(MAGIC), self.path.stat().st_size)
            for opcode, body in records:
                self.read += _RECORD.size + len(body)
                if opcode == Opcode.CHUNK:
                    yield from self._chunk(_unpack(_parse(Chunk, body)))
                elif opcode == Opcode.DATA_END:
                    self._check_end(records, file)
                    return
                else:
                    yield from self._record(opcode, body)
        except _TornError as torn:
            if torn.opcode == Opcode.CHUNK:
                yield from self._torn_chunk(torn.body)
        raise _FaultError("the file is truncated")

    def _chunk(self, data: bytes) -> Iterator[Message]:
        for opcode, body in _records(BytesIO(data), 0, len(data)):
            yield from self._record(opcode, body)

    def _torn_chunk(self, body: bytes) -> Iterator[Message]:
        """The complete messages of a truncated chunk; none if it is compressed."""
        try:
            chunk = _parse(Chunk, body)
        except _FaultError:  # truncated before its data
            return
        if not chunk.compression:
            with contextlib.suppress(_TornError):
                yield from self._chunk(chunk.data)

    def _check_end(self, records: Iterator[tuple[int, bytes]], file: BinaryIO) -> None:
        try:
            for opcode, body in records:
                if opcode == Opcode.STATISTICS:
                    stated = _parse(Statistics, body).message_count
                    if stated > self._count:
                        raise _FaultError(
                            f"the file is damaged: only {self._count} of {stated} messages are left"
                        )
                    if stated < self._count:
                        raise _FaultError(
                            f"the file is damaged: it has {self._count} messages, but states {stated}"
                        )
                elif opcode == Opcode.FOOTER:
                    break
        except _TornError:
            pass
        if (end := file.read(len(MAGIC) + 1)) != MAGIC:
            longer = end.startswith(MAGIC)
            what = "damaged: bytes follow its end" if longer else "truncated after its last message"
            raise _FaultError(f"the file is {what}")

    def _record(self, opcode: int, body: bytes) -> Iterator[Message]:
        if opcode == Opcode.MESSAGE:
            if len(body) < _MESSAGE.size:
                raise _FaultError("the file is damaged: a message is too short")
            channel, _, logged, published = _MESSAGE.unpack_from(body)
            topic = self._channels.get(channel)
            if topic is None:
                raise _FaultError("the file is damaged: a message belongs to no topic")
            self._count += 1
            yield Message(topic, logged, published, body[_MESSAGE.size :])
        elif opcode == Opcode.SCHEMA:
            schema = _parse(Schema, body)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            self._announce(_parse(Channel, body))
        elif opcode == Opcode.HEADER:
            self.library = _parse(Header, body).library
        elif opcode == Opcode.METADATA:
            record = _parse(Metadata, body)
            self.records[record.name] = record.metadata

    def _announce(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) if channel.schema_id else _WITHOUT
        if channel.id in self._channels or schema is None:
            return
        topic = Topic(
            channel.topic,
            schema.name,
            schema.data.decode("utf-8", "replace"),
            channel.metadata.get("topic_type_hash", ""),
            parse_qos(channel.metadata.get("offered_qos_profiles", "")),
            channel.message_encoding,
            schema.encoding,
        )
        self._channels[channel.id] = topic
        self.topics.append(topic)


def messages_of(files: Iterable[Path]) -> Iterator[Message]:
    """The messages of several files, one after the other."""
    return chain.from_iterable(map(Scan, files))


def _records(file: BinaryIO, begin: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of the records between two byte positions."""
    at = begin
    while at < end:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise _TornError(0, b"")
        opcode, length = _RECORD.unpack(head)
        if not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE):
            raise _FaultError(f"the file is damaged at byte {at}: no record begins there")
        at += _RECORD.size
        body = file.read(min(length, end - at))
        if len(body) < length:
            raise _TornError(opcode, body)
        yield opcode, body
        at += length


def _parse(kind: type[_Record], body: bytes) -> _Record:
    try:
        record: _Record = kind.read(ReadDataStream(BytesIO(body)))
    except (struct.error, ValueError, OverflowError, EndOfFile) as error:
        raise _FaultError(f"the file is damaged: a {kind.__name__.lower()} cannot be read") from error
    return record


def _unpack(chunk: Chunk) -> bytes:
    """The records in a chunk, checked against its stated size and CRC."""
    size = chunk.uncompressed_size
    if size > MAX_UNPACKED:
        raise _FaultError(f"a chunk of {size} bytes is longer than the limit of {MAX_UNPACKED}")
    data = chunk.data
    if chunk.compression:
        try:
            data = _decompress(chunk.compression, data, size + 1)
        except _FaultError:
            raise
        except Exception as error:  # every compressor raises its own
            raise _FaultError(
                f"a chunk compressed with {chunk.compression} cannot be unpacked ({error})"
            ) from error
    if len(data) != size or chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise _FaultError("the file is damaged: the checksum of a chunk is wrong")
    return data


def _decompress(compression: str, data: bytes, most: int) -> bytes:
    """The first `most` unpacked bytes."""
    if compression == "zstd":
        import zstandard  # noqa: PLC0415 - rarely needed

        with zstandard.ZstdDecompressor(max_window_size=MAX_UNPACKED).stream_reader(data) as reader:
            return bytes(reader.read(most))
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415

        return bytes(LZ4FrameDecompressor().decompress(data, max_length=most))
    raise _FaultError(f"a chunk is compressed with {compression[:40]!r}, which is not supported")
