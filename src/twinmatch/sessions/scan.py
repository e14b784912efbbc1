"""Reads whatever can be read of an MCAP file, and says what cannot.

A killed recorder leaves a file without index, often truncated within a record; a disk or a transfer may
change bytes anywhere. Libraries refuse such a file or return partial data as if complete, so this module
iterates over the records; the `mcap` library parses each. A record is read completely before it is parsed,
each chunk is checked against its CRC and unpacked only up to a limit, since some kilobytes may unpack to
gigabytes.

Reading continues after a fault: with the next record that can be recognised, and in a chunk with a wrong
checksum as far as its messages can be distinguished. These are marked, since their content may be wrong.
Topics whose definition is lost in the data are taken from the summary.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    Header,
    Metadata,
    Schema,
    Statistics,
)

from twinmatch.sessions.files import SessionError, open_regular
from twinmatch.sessions.messages import SAMPLE, SCALAR_SAMPLE, Message, Topic, fields_of
from twinmatch.sessions.metadata import parse_qos
from twinmatch.sessions.records import HEAD, MAGIC, MESSAGE, FileRecord, Walk
from twinmatch.sessions.salvage import mended

MAX_UNPACKED: Final = 1 << 28
"""Longest chunk, unpacked bytes: recorders write chunks of a few megabytes, or one longer message."""
TRUNCATED: Final = "the file is truncated"
"""Fault of a file that ends too early, and is sound up to there."""
_USUAL: Final = 1 << 23
"""Unpacked bytes that are read of a chunk that states less: its statement may be wrong."""
_PIECE: Final = 1 << 16
"""Packed bytes given to a compressor at once."""
_NEAR: Final = 1 << 16
"""Bytes in which a file that does not begin like an MCAP file must have a record of one."""
_HALF: Final = len(MAGIC) // 2
_CHUNK: Final = struct.Struct("<QQQI")
"""What a chunk begins with: times of its first and last message, unpacked size, CRC."""
_FOOTER: Final = HEAD.size + 20
_PACKED: Final = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}
"""Compressors, by what their output begins with."""
_WITHOUT: Final = Schema(0, b"", "", "")
"""What number 0 stands for: messages that have no schema, such as JSON."""

_Parsed = TypeVar(
    "_Parsed", Header, Schema, Channel, ChunkIndex, Metadata, Statistics, Footer
)


class _FaultError(Exception):
    """A record cannot be read; the message says why."""


class _Chunk(NamedTuple):
    """A chunk, as it is in the file."""

    size: int
    """Unpacked bytes, as stated."""
    crc: int
    compression: str
    begin: int
    """Where its data begin in the body."""
    data: bytes


class Scan:
    """One pass over a file: iterate it for the messages, then read topics, records and fault."""

    def __init__(self, path: Path) -> None:
        """Prepare to read a file; nothing is opened yet.

        Args:
            path: an MCAP file, complete, truncated or damaged.
        """
        self.path = path
        self.topics: list[Topic] = []
        """Topics found so far, with or without messages."""
        self.records: dict[str, dict[str, str]] = {}
        """Metadata records found so far; the last of those with the same name."""
        self.library = ""
        """Name of the program that wrote the file; empty if it cannot be read."""
        self.fault = ""
        """What is wrong with the file, once it has been read; empty: nothing."""
        self.read = 0
        """Bytes of the file read so far."""
        self.unsound = 0
        """Messages read so far that no checksum confirms although one should; their content may be wrong."""
        self._count = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Topic] = {}
        self._faults: dict[str, int] = {}
        self._index: dict[int, ChunkIndex] | None = None
        self._is_sound = True
        self._stated = -1
        self._ended = False

    @property
    def is_damaged(self) -> bool:
        """Whether it has another fault than to end too early."""
        return bool(self.fault) and not self.fault.startswith(TRUNCATED)

    def __iter__(self) -> Iterator[Message]:
        """The messages in the order in which they were written.

        Raises:
            SessionError: the file cannot be opened, is empty, or is not an MCAP file.
        """
        try:
            with open_regular(self.path) as file:
                size = os.fstat(file.fileno()).st_size
                self._check_beginning(file, size)
                walk = self._walk_over(file, len(MAGIC), size, file)
                yield from mended(self._messages(walk, file), self._drop)
                self.fault = self._conclusion(walk, file)
        except OSError as error:
            raise SessionError(
                f"session {self.path}: cannot be read ({error.strerror})"
            ) from error

    def _check_beginning(self, file: BinaryIO, size: int) -> None:
        beginning = file.read(len(MAGIC))
        if beginning == MAGIC:
            return
        if not beginning:
            raise SessionError(f"session {self.path}: the file is empty")
        same_bytes = sum(a == b for a, b in zip(beginning, MAGIC, strict=False))
        file.seek(max(0, size - len(MAGIC)))
        if size <= len(MAGIC) or (same_bytes < _HALF and file.read() != MAGIC):
            raise SessionError(
                f"session {self.path}: is not a session: it does not begin like an MCAP file"
            )
        if next(iter(Walk(file, len(MAGIC), min(size, _NEAR))), None) is None:
            raise SessionError(
                f"session {self.path}: is not a session: it does not begin like an MCAP file"
            )
        self._note("its first bytes are wrong")

    def _walk_over(
        self, source: BinaryIO, begin: int, end: int, file: BinaryIO
    ) -> Walk:
        def chunks() -> Mapping[int, int]:
            index = self._summary(file)
            return {
                start: entry.chunk_length - HEAD.size for start, entry in index.items()
            }

        is_file = source is file
        return Walk(
            source,
            begin,
            end,
            has_channel=self._channels.__contains__,
            chunks=chunks if is_file else dict,
        )

    def _messages(self, walk: Walk, file: BinaryIO) -> Iterator[Message]:
        gaps = 0
        for record in walk:
            self.read = walk.at
            if walk.gaps > gaps:
                gaps = walk.gaps
                self._is_sound = False
            if record.opcode == Opcode.CHUNK:
                yield from self._chunk(record, walk, file)
            elif record.opcode == Opcode.MESSAGE:
                yield from self._message(record.body, file)
            elif record.opcode == Opcode.FOOTER:
                self._check_summary(record, file)
                return
            else:
                self._take(record.opcode, record.body)
                if record.opcode == Opcode.DATA_END:
                    self._ended = True

    def _chunk(
        self, record: FileRecord, walk: Walk, file: BinaryIO
    ) -> Iterator[Message]:
        """The messages of a chunk; those of one that is not compressed and cannot be checked are left to the
        walk, which continues within it."""
        self._is_sound = True
        try:
            chunk = self._open(record)
            data = _unpacked(chunk)
        except _FaultError as fault:
            self._note(str(fault))
            self._summary(file)
            self._is_sound = False
            walk.at = record.begin
            return
        if len(record.body) < record.length:  # the file ends within it
            if not chunk.compression:
                walk.at = record.begin + chunk.begin
            return
        if len(data) == chunk.size and chunk.crc in {0, zlib.crc32(data)}:
            yield from self._within(data, file)
            return
        self._note("the checksum of a chunk is wrong")
        self._summary(file)
        self._is_sound = False
        if chunk.compression:
            yield from self._within(data, file)
        else:
            walk.at = record.begin + chunk.begin

    def _open(self, record: FileRecord) -> _Chunk:
        """A chunk by its own fields, or by those that the index has of it."""
        body = record.body
        if len(body) < _CHUNK.size + 4:
            raise _FaultError("a chunk cannot be read")
        _, _, size, crc = _CHUNK.unpack_from(body)
        entry = (self._index or {}).get(record.at)
        if entry is not None and _CHUNK.size <= len(
            body
        ) - entry.compressed_size <= len(body):
            begin = len(body) - entry.compressed_size
            return _Chunk(
                entry.uncompressed_size, crc, entry.compression, begin, body[begin:]
            )
        (length,) = struct.unpack_from("<I", body, _CHUNK.size)
        compression_begin = _CHUNK.size + 4
        size_begin = compression_begin + length
        begin = size_begin + 8
        stated_size = int.from_bytes(body[size_begin:begin], "little")
        if begin > len(body) or begin + stated_size != record.length:
            raise _FaultError("a chunk cannot be read")
        data = body[begin:]
        compression = body[compression_begin:size_begin].decode("utf-8", "replace")
        if compression and compression not in _PACKED.values():
            compression = _PACKED.get(data[:4], compression)
        return _Chunk(size, crc, compression, begin, data)

    def _within(self, data: bytes, file: BinaryIO) -> Iterator[Message]:
        """The messages in the unpacked bytes of a chunk."""
        position = 0
        end = len(data)
        while position + HEAD.size <= end:
            opcode, length = HEAD.unpack_from(data, position)
            begin = position + HEAD.size
            if (
                not opcode
                or begin + length > end
                or (opcode == Opcode.MESSAGE and length < MESSAGE.size)
            ):
                break
            if opcode == Opcode.MESSAGE:
                yield from self._message(data[begin : begin + length], file)
            else:
                self._take(opcode, data[begin : begin + length])
            position = begin + length
        if position == end:
            return
        self._is_sound = False
        walk = self._walk_over(BytesIO(data), position, end, file)
        for record in walk:
            if record.opcode == Opcode.MESSAGE:
                yield from self._message(record.body, file)
            elif record.opcode != Opcode.CHUNK:
                self._take(record.opcode, record.body)
        self._note("records of a chunk cannot be read")

    def _message(self, body: bytes, file: BinaryIO) -> Iterator[Message]:
        if len(body) < MESSAGE.size:
            self._note("a message is too short")
            return
        channel, _, logged, published = MESSAGE.unpack_from(body)
        if channel not in self._channels:
            self._summary(file)
        topic = self._channels.get(channel)
        if topic is None:
            self._note("a message belongs to no topic")
            return
        self._count += 1
        self.unsound += not self._is_sound
        yield Message(topic, logged, published, body[MESSAGE.size :], self._is_sound)

    def _take(self, opcode: int, body: bytes) -> None:
        """Take what a record says."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = _parse(Schema, body)
                self._schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                self._announce(_parse(Channel, body))
            elif opcode == Opcode.HEADER:
                self.library = _parse(Header, body).library
            elif opcode == Opcode.METADATA:
                record = _parse(Metadata, body)
                self.records[record.name] = record.metadata
            elif opcode == Opcode.STATISTICS:
                self._stated = _parse(Statistics, body).message_count
        except _FaultError as fault:
            self._note(str(fault))

    def _announce(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) if channel.schema_id else _WITHOUT
        if channel.id in self._channels or schema is None:
            return
        if self._index is not None:  # damage was met
            schema = _mended_schema(schema, channel)
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

    def _summary(self, file: BinaryIO) -> Mapping[int, ChunkIndex]:
        """Take topics from the summary, once, and return its index of the chunks by their places. It may be
        wrong, and is used only where no record can be read."""
        if self._index is None:
            self._index = {}
            size = os.fstat(file.fileno()).st_size
            footer = _footer_of(file, size)
            if footer is None:
                self._search_topics(file, size)
                return self._index
            end = size - len(MAGIC) - _FOOTER
            for record in Walk(file, footer.summary_start, end):
                if record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self._take(record.opcode, record.body)
                elif record.opcode == Opcode.CHUNK_INDEX:
                    try:
                        entry = _parse(ChunkIndex, record.body)
                    except _FaultError:
                        continue
                    if HEAD.size < entry.chunk_length <= end - entry.chunk_start_offset:
                        self._index[entry.chunk_start_offset] = entry
        return self._index

    def _search_topics(self, file: BinaryIO, size: int) -> None:
        """Take topics from wherever they are outside of chunks."""
        place = file.tell()
        for record in Walk(file, len(MAGIC), size, has_channel=lambda _: False):
            if record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._take(record.opcode, record.body)
        file.seek(place)

    def _check_summary(self, footer: FileRecord, file: BinaryIO) -> None:
        """Compare the summary with its checksum."""
        self._ended = True
        start, _, crc = struct.unpack("<QQI", footer.body[:20])
        if not crc:
            return
        if not start:
            start = footer.at
        if start > footer.at or _crc_of(file, start, footer.end - 4) != crc:
            self._note("the checksum of the index is wrong")

    def _drop(self) -> None:
        """Count a message that cannot be right."""
        self._count -= 1
        self.unsound -= 1
        self._note("a message cannot be right and is left out")

    def _note(self, fault: str) -> None:
        self._faults[fault] = self._faults.get(fault, 0) + 1

    def _conclusion(self, walk: Walk, file: BinaryIO) -> str:
        """What is wrong, in a sentence; empty: nothing."""
        faults = [
            fault + (f" ({n} times)" if n > 1 else "")
            for fault, n in self._faults.items()
        ]
        if walk.gaps:
            further = f", nor at {walk.gaps - 1} other places" if walk.gaps > 1 else ""
            faults.append(f"at byte {walk.first_gap} no record begins{further}")
        if self.unsound:
            faults.append(
                f"{self.unsound} messages were read that no checksum confirms"
            )
        if self._stated > self._count:
            faults.append(f"only {self._count} of {self._stated} messages are left")
        if 0 <= self._stated < self._count:
            faults.append(f"it has {self._count} messages, but states {self._stated}")
        file.seek(walk.at)
        end = file.read(len(MAGIC) + 1)
        if self._ended and end.startswith(MAGIC) and end != MAGIC:
            faults.append("bytes follow its end")
        elif faults and end != MAGIC:
            faults.append("its end is missing")
        if faults:
            return f"the file is damaged: {'; '.join(faults)}"
        if end == MAGIC and self._ended:
            return ""
        return f"{TRUNCATED} after its last message" if self._ended else TRUNCATED


def _mended_schema(schema: Schema, channel: Channel) -> Schema:
    """The definition of a topic in a damaged file; that of samples is the current one, if it may be wrong."""
    is_ours = (
        SAMPLE.type_hash == channel.metadata.get("topic_type_hash")
        or schema.name == SAMPLE.type
    )
    fields = fields_of(schema.data.decode("utf-8", "replace"))
    if not is_ours or fields == SCALAR_SAMPLE:
        return schema
    return Schema(schema.id, SAMPLE.schema.encode(), SAMPLE.language, SAMPLE.type)


def messages_of(files: Iterable[Path]) -> Iterator[Message]:
    """The messages of several files, one after the other."""
    return chain.from_iterable(map(Scan, files))


def _footer_of(file: BinaryIO, size: int) -> Footer | None:
    """The footer of a file with a summary; None if it has none."""
    file.seek(max(0, size - len(MAGIC) - _FOOTER))
    tail = file.read()
    if len(tail) < _FOOTER + len(MAGIC) or HEAD.unpack_from(tail) != (
        Opcode.FOOTER,
        20,
    ):
        return None
    footer = _parse(Footer, tail[HEAD.size : _FOOTER])
    footer_begin = size - len(MAGIC) - _FOOTER
    if not 0 < footer.summary_start < footer_begin:
        return None
    return footer


def _crc_of(file: BinaryIO, begin: int, end: int) -> int:
    """CRC of the bytes between two places."""
    crc = 0
    file.seek(begin)
    remaining = end - begin
    while remaining > 0 and (block := file.read(min(remaining, _PIECE))):
        crc = zlib.crc32(block, crc)
        remaining -= len(block)
    return crc


def _parse(kind: type[_Parsed], body: bytes) -> _Parsed:
    try:
        record: _Parsed = kind.read(ReadDataStream(BytesIO(body)))
    except (struct.error, ValueError, OverflowError, EndOfFile) as error:
        raise _FaultError(f"a {kind.__name__.lower()} cannot be read") from error
    return record


def _unpacked(chunk: _Chunk) -> bytes:
    """The records in a chunk, as many as can be unpacked within the limits."""
    if not chunk.compression:
        return chunk.data
    size = chunk.size if chunk.size <= MAX_UNPACKED else 0
    if chunk.compression not in _PACKED.values():
        raise _FaultError(
            f"a chunk is compressed with {chunk.compression[:40]!r}, which is not supported"
        )
    unpack = _unpack_zstd if chunk.compression == "zstd" else _unpack_lz4
    return unpack(chunk.data, max(size, _USUAL) + 1)


def _unpack_zstd(data: bytes, most: int) -> bytes:
    import zstandard  # noqa: PLC0415

    unpacked = bytearray()
    with zstandard.ZstdDecompressor(max_window_size=MAX_UNPACKED).stream_reader(
        data
    ) as reader:
        try:
            while len(unpacked) < most and (
                piece := reader.read(min(_PIECE, most - len(unpacked)))
            ):
                unpacked += piece
        except zstandard.ZstdError:  # what comes before is kept
            pass
    return bytes(unpacked)


def _unpack_lz4(data: bytes, most: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415

    unpacked = bytearray()
    reader: Any = LZ4FrameDecompressor()
    piece = data
    try:
        while len(unpacked) < most and not reader.eof:
            unpacked += reader.decompress(
                piece, max_length=min(_PIECE, most - len(unpacked))
            )
            piece = b""
            if reader.needs_input:
                break
    except RuntimeError:  # what comes before is kept
        pass
    return bytes(unpacked)
