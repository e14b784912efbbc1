"""The records of an MCAP file, byte by byte: one after the other, and again after damage.

A record is its opcode, the length of its body, and the body. A damaged file breaks this chain: a length leads
to a place at which no record begins. `Walk` then looks for the next place at which one does. A record is
recognised by its length, which has to be the one that its fields add up to, and by what follows it. What a
chunk holds uncompressed are records too, so they are found in the same way where the chunk itself is damaged.
"""

from __future__ import annotations

import re
import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from typing import BinaryIO, Final, NamedTuple

from mcap.opcode import Opcode

MAGIC: Final = b"\x89MCAP0\r\n"
"""Begins and ends a file."""
HEAD: Final = struct.Struct("<BQ")
"""Opcode and length of a record."""
MESSAGE: Final = struct.Struct("<HIQQ")
"""What a message begins with: channel, number, time of recording, time of publication (ns)."""
_PRIVATE: Final = 0x80
_BLOCK: Final = 1 << 20
"""Bytes read at once where a record is looked for."""
_PERHAPS: Final = re.compile(rb"(?=[\x01-\x0f][\x00-\xff]{4}\x00{4})")
"""Where a record of less than 4 GB may begin."""
_TEXT: Final = "text"
_BYTES: Final = "bytes"
_FIELDS: Final[Mapping[int, tuple[int | str, ...]]] = {
    Opcode.HEADER: (_TEXT, _TEXT),
    Opcode.FOOTER: (20,),
    Opcode.SCHEMA: (2, _TEXT, _TEXT, _TEXT),
    Opcode.CHANNEL: (4, _TEXT, _TEXT, _TEXT),
    Opcode.CHUNK: (28, _TEXT, _BYTES),
    Opcode.MESSAGE_INDEX: (2, _TEXT),
    Opcode.CHUNK_INDEX: (32, _TEXT, 8, _TEXT, 16),
    Opcode.ATTACHMENT: (16, _TEXT, _TEXT, _BYTES, 4),
    Opcode.ATTACHMENT_INDEX: (40, _TEXT, _TEXT),
    Opcode.STATISTICS: (42, _TEXT),
    Opcode.METADATA: (_TEXT, _TEXT),
    Opcode.METADATA_INDEX: (16, _TEXT),
    Opcode.SUMMARY_OFFSET: (17,),
    Opcode.DATA_END: (4,),
}
"""Fields of each kind of record but messages: so many bytes, or a length of 4 (text, lists) or 8 bytes
(bytes) followed by as many bytes."""
_LENGTHS: Final = {_TEXT: struct.Struct("<I"), _BYTES: struct.Struct("<Q")}


class FileRecord(NamedTuple):
    """A record in a file or chunk."""

    opcode: int
    at: int
    """Where it begins."""
    body: bytes
    """Less than its length says, if the file ends within it."""
    length: int

    @property
    def begin(self) -> int:
        """Where its body begins."""
        return self.at + HEAD.size

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.begin + self.length


class Walk:
    """The records between two places of a file, also those after damage."""

    def __init__(
        self,
        file: BinaryIO,
        begin: int,
        end: int,
        *,
        has_channel: Callable[[int], bool] = lambda _: True,
        chunks: Callable[[], Mapping[int, int]] = dict,
    ) -> None:
        """Prepare to read.

        Args:
            file: opened for reading.
            begin: where the first record begins.
            end: where the last one ends.
            has_channel: whether a channel of this number is there; messages of others are not looked for.
            chunks: where chunks begin, with the lengths of their bodies, as an index has them; called at the
                first damage.
        """
        self.at = begin
        """Where the next record is read; may be set, to read on at another place."""
        self.gaps = 0
        """Number of places at which no record begins."""
        self.first_gap = -1
        """The first of them; -1: none."""
        self.is_truncated = False
        """Whether the file ends within its last record."""
        self._file = file
        self._end = end
        self._has_channel = has_channel
        self._index = chunks
        self._chunks: Mapping[int, int] | None = None
        self._starts: list[int] = []

    def __iter__(self) -> Iterator[FileRecord]:
        """The records; a chunk may be torn, if it is the last record."""
        while self.at < self._end and not self._is_magic(self.at):
            record = self._read(self.at)
            if record is None:
                self._skip()
            else:
                self.at = min(record.end, self._end)
                yield record

    def _skip(self) -> None:
        """Go to the next record."""
        following = self._next(self.at + 1, self._end)
        number = bisect_right(self._starts, self.at)
        if number < len(self._starts):
            following = min(following, self._starts[number])
        if following == self._end and self._is_cut(self.at):
            self.is_truncated = True
        else:
            self._count_gap()
        self.at = following

    def _count_gap(self) -> None:
        self.gaps += 1
        if self.first_gap < 0:
            self.first_gap = self.at

    def _read(self, place: int) -> FileRecord | None:
        """The record at a place; None if none begins there, or it does not end where it says."""
        head = self._head(place)
        if head is not None and self._is_clear(place, *head):
            opcode, length = head
            return FileRecord(
                opcode, place, self._bytes(place + HEAD.size, length), length
            )
        if self._chunks is None:
            self._chunks = self._index()
            self._starts = sorted(self._chunks)
        if place in self._chunks:
            self._count_gap()
            length = self._chunks[place]
            return FileRecord(
                Opcode.CHUNK, place, self._bytes(place + HEAD.size, length), length
            )
        if head is not None and self._is_possible(place, *head):
            opcode, length = head
            return FileRecord(
                opcode, place, self._bytes(place + HEAD.size, length), length
            )
        return None

    def _is_clear(self, place: int, opcode: int, length: int) -> bool:
        """Whether the fields of a record add up to its length, or, of a message, another record follows."""
        begin = place + HEAD.size
        end = begin + length
        if opcode == Opcode.MESSAGE:
            return end <= self._end and self._may_begin(end)
        return (end <= self._end or opcode == Opcode.CHUNK) and self._fields_of(
            opcode, begin
        ) == length

    def _is_possible(self, place: int, opcode: int, length: int) -> bool:
        """Whether a record of an unknown kind, of unknown further fields, or before damage, may be one:
        another record follows, unless it is a message, and none begins within it."""
        end = place + HEAD.size + length
        if end > self._end or (opcode == Opcode.MESSAGE and length < MESSAGE.size):
            return False
        follows = opcode == Opcode.MESSAGE or self._may_begin(end)
        return follows and self._next(place + 1, end) == end

    def _head(self, place: int) -> tuple[int, int] | None:
        """Opcode and length of the record at a place; None if it cannot be one."""
        head = self._bytes(place, HEAD.size)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(head)
        if not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE):
            return None
        return opcode, length

    def _may_begin(self, place: int) -> bool:
        """Whether a complete record may begin at a place, or the file or its last record ends there."""
        if place == self._end or self._is_magic(place):
            return True
        head = self._head(place)
        return head is not None and place + HEAD.size + head[1] <= self._end

    def _is_magic(self, place: int) -> bool:
        return (
            place + len(MAGIC) == self._end and self._bytes(place, len(MAGIC)) == MAGIC
        )

    def _is_cut(self, place: int) -> bool:
        """Whether the record at a place is longer than what is left of the file."""
        if self._end - place < HEAD.size:
            return True
        head = self._head(place)
        return head is not None and place + HEAD.size + head[1] > self._end

    def _next(self, begin: int, end: int) -> int:
        """The first place between two at which a record begins for certain; the latter if none does."""
        block_begin = begin
        while block_begin < end:
            block = self._bytes(block_begin, min(_BLOCK, end - block_begin) + HEAD.size)
            for match in _PERHAPS.finditer(block):
                if block_begin + match.start() < end and self._begins(
                    block_begin + match.start()
                ):
                    return block_begin + match.start()
            block_begin += _BLOCK
        return end

    def _begins(self, place: int) -> bool:
        """Whether a record begins at a place for certain."""
        head = self._head(place)
        if head is None:
            return False
        opcode, length = head
        begin = place + HEAD.size
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size or not self._may_begin(begin + length):
                return False
            return self._has_channel(
                MESSAGE.unpack(self._bytes(begin, MESSAGE.size))[0]
            )
        if self._fields_of(opcode, begin) != length:
            return False
        return opcode == Opcode.CHUNK or self._may_begin(begin + length)

    def _fields_of(self, opcode: int, begin: int) -> int | None:
        """The length of a body, added up from its fields; None if it has none, or the file ends in them."""
        position = begin
        fields = _FIELDS.get(opcode, ())
        for field in fields:
            if isinstance(field, int):
                position += field
                continue
            number = _LENGTHS[field]
            text = self._bytes(position, number.size)
            if len(text) < number.size:
                return None
            (length,) = number.unpack(text)
            position += number.size + length
        return position - begin if fields else None

    def _bytes(self, place: int, count: int) -> bytes:
        """So many bytes of the file, fewer at its end."""
        if place >= self._end:
            return b""
        self._file.seek(place)
        return self._file.read(min(count, self._end - place))
