"""Recorded sessions damaged as disks and transfers do it, and what plain readers find in them."""

from __future__ import annotations

import random
import struct
from bisect import bisect_left
from collections.abc import Iterator, Sequence, Set
from io import BytesIO
from pathlib import Path
from typing import Final

from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from twinmatch.sessions.cdr import decode_sample, encode_sample, encode_temperature
from twinmatch.sessions.messages import SAMPLE, TEMPERATURE_READING
from twinmatch.signals import NANOSECONDS, Sample

_BLOCK: Final = 512


def whole_file(
    count: int = 600,
    every: int = 60,
    compression: CompressionType = CompressionType.NONE,
) -> bytes:
    """A session's file of so many samples, in chunks of `every` samples."""
    out = BytesIO()
    writer = Writer(out, chunk_size=1 << 20, compression=compression)
    writer.start(profile="ros2", library="twinmatch")
    channels = {}
    for topic in (SAMPLE, TEMPERATURE_READING):
        schema = writer.register_schema(topic.type, "ros2msg", topic.schema.encode())
        channels[topic] = writer.register_channel(topic.name, "cdr", schema)
    writer.add_metadata("twinmatch/plant", {"plant": "peltier"})
    for k in range(count):
        stamp = (1_000_000 + k) * NANOSECONDS
        temperature = 25.0 + k % 7 / 8
        writer.add_message(
            channels[TEMPERATURE_READING],
            stamp,
            encode_temperature(stamp, temperature),
            stamp,
        )
        writer.add_message(
            channels[SAMPLE],
            stamp,
            encode_sample(Sample(k, stamp, 30.0, temperature, 1.0)),
            stamp,
        )
        if k % every == every - 1:
            writer.flush()  # type: ignore[no-untyped-call]
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def _flip(rng: random.Random, data: bytearray) -> None:
    for _ in range(rng.choice([1, 1, 1, 3, 20])):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _flip_first(rng: random.Random, data: bytearray) -> None:
    """In the first chunk, where the topics are."""
    data[rng.randrange(8, len(data) // 10)] ^= 1 << rng.randrange(8)


def _truncate(rng: random.Random, data: bytearray) -> None:
    del data[rng.randrange(1, len(data)) :]


def _zero(rng: random.Random, data: bytearray) -> None:
    place = rng.randrange(len(data)) // _BLOCK * _BLOCK
    end = min(len(data), place + _BLOCK * rng.choice([1, 1, 8]))
    data[place:end] = bytes(end - place)


def _swap(rng: random.Random, data: bytearray) -> None:
    """Two blocks."""
    last = len(data) // _BLOCK - 1
    a = rng.randrange(last) * _BLOCK
    b = rng.randrange(last) * _BLOCK
    first = data[a : a + _BLOCK]
    data[a : a + _BLOCK] = data[b : b + _BLOCK]
    data[b : b + _BLOCK] = first


def _remove(rng: random.Random, data: bytearray) -> None:
    place = rng.randrange(len(data))
    del data[place : place + rng.choice([1, 9, _BLOCK])]


def _destroy_index(rng: random.Random, data: bytearray) -> None:
    """In the summary, or the lengths of records outside of chunks."""
    footer = len(data) - 8 - 29
    (start,) = struct.unpack_from("<Q", data, footer + 9)
    for _ in range(rng.choice([1, 4])):
        data[rng.randrange(start, len(data))] = rng.randrange(256)


def _destroy_length(rng: random.Random, data: bytearray) -> None:
    """The opcode or length of a record between two chunks."""
    place = 8
    heads = []
    while place + 9 < len(data) - 8:
        heads.append(place)
        place += 9 + struct.unpack_from("<Q", data, place + 1)[0]
    data[rng.choice(heads) + rng.randrange(9)] ^= 1 << rng.randrange(8)


KINDS: Final = (
    _flip,
    _flip_first,
    _truncate,
    _zero,
    _swap,
    _remove,
    _destroy_index,
    _destroy_length,
)


def kind_of(number: int) -> str:
    """Name of the damage that a number gets."""
    return KINDS[number % len(KINDS)].__name__.strip("_").replace("_", " ")


def broken(sound: bytes, rng: random.Random, number: int) -> bytes:
    """A damaged copy; consecutive numbers are damaged in all ways in turn."""
    data = bytearray(sound)
    while data == sound:
        KINDS[number % len(KINDS)](rng, data)
    return bytes(data)


def samples_in(sound: bytes) -> Set[bytes]:
    """The messages with the samples of a sound file."""
    return set(_plain(StreamReader(BytesIO(sound), emit_chunks=True).records))


def plainly_found(content: bytes, sound: Set[bytes]) -> Set[bytes]:
    """Those of the sound samples that plain readers find in their order: chunk by chunk, from the beginning
    or by the index, without checking checksums. A sample among others of another time is not counted."""
    from_the_beginning = [
        data for data in _from_the_beginning(content) if data in sound
    ]
    by_the_index = [data for data in _by_the_index(content) if data in sound]
    return max(_in_order(from_the_beginning), _in_order(by_the_index), key=len)


def _in_order(messages: Sequence[bytes]) -> Set[bytes]:
    """As many of the messages as possible whose indices increase."""
    tails: list[int] = []
    ends: list[list[bytes]] = []
    for data in messages:
        index = decode_sample(data).index
        place = bisect_left(tails, index)
        row = [*ends[place - 1], data] if place else [data]
        tails[place : place + 1] = [index]
        ends[place : place + 1] = [row]
    return set(ends[-1]) if ends else set()


def _from_the_beginning(content: bytes) -> Iterator[bytes]:
    try:
        yield from _plain(
            StreamReader(
                BytesIO(content), emit_chunks=True, record_size_limit=1 << 24
            ).records
        )
    except Exception:
        return


def _plain(records: Iterator[object]) -> Iterator[bytes]:
    numbers: set[int] = set()
    for record in records:
        if isinstance(record, Chunk):
            yield from _of_chunk(record, numbers)


def _of_chunk(chunk: Chunk, numbers: set[int]) -> Iterator[bytes]:
    try:
        records = breakup_chunk(chunk)
    except Exception:
        return
    numbers.update(
        r.id for r in records if isinstance(r, Channel) and r.topic == SAMPLE.name
    )
    for record in records:
        if isinstance(record, Message) and record.channel_id in numbers:
            yield record.data


def _by_the_index(content: bytes) -> Iterator[bytes]:
    try:
        summary = SeekingReader(
            BytesIO(content), record_size_limit=1 << 24
        ).get_summary()
    except Exception:
        return
    if summary is None:
        return
    numbers = {
        number
        for number, channel in summary.channels.items()
        if channel.topic == SAMPLE.name
    }
    for entry in summary.chunk_indexes:
        yield from _messages_numbered(content, entry, numbers)


def _messages_numbered(
    content: bytes, entry: ChunkIndex, numbers: set[int]
) -> Iterator[bytes]:
    from mcap.data_stream import ReadDataStream

    stream = BytesIO(content)
    try:
        stream.seek(entry.chunk_start_offset + 9)
        chunk = Chunk.read(ReadDataStream(stream))
    except Exception:
        return
    yield from _of_chunk(chunk, numbers)


def strictly_read(content: bytes) -> bool:
    """Whether the library takes a file with all its checksums, and finds as many messages by the index."""
    try:
        stream = StreamReader(
            BytesIO(content), validate_crcs=True, record_size_limit=1 << 24
        )
        in_stream = sum(isinstance(record, Message) for record in stream.records)
        reader = SeekingReader(
            BytesIO(content), validate_crcs=True, record_size_limit=1 << 24
        )
        by_index = sum(1 for _ in reader.iter_messages(log_time_order=False))
    except Exception:
        return False
    return (
        in_stream == by_index
        and content.startswith(b"\x89MCAP")
        and content.endswith(b"\x89MCAP0\r\n")
    )


def as_session(folder: Path, content: bytes) -> Path:
    """The content as the only file of a session whose metadata are lost."""
    folder.mkdir()
    (folder / f"{folder.name}_0.mcap").write_bytes(content)
    return folder
