"""Torn and damaged files: what comes before the damage is read, and the damage is said."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from twinmatch.sessions import SessionError, SessionWriter, read_session
from twinmatch.sessions.messages import SAMPLE, encode_sample
from twinmatch.sessions.scan import MAGIC, Scan
from twinmatch.signals import Sample

COUNT = 60
SAMPLES = [Sample(k, k * 10**9, 30.0, 25.0 + k / 8, float(k)) for k in range(COUNT)]


def flushed_file(folder: Path, every: int = 20) -> bytes:
    with SessionWriter(folder) as writer:
        writer.add_topic(SAMPLE)
        for sample in SAMPLES:
            writer.write(SAMPLE.name, encode_sample(sample), sample.stamp)
            if sample.index % every == every - 1:
                writer.flush()
    return (folder / f"{folder.name}_0.mcap").read_bytes()


def library_file(compression: CompressionType, *, use_chunking: bool = True) -> bytes:
    """A file as other recorders write it."""
    out = BytesIO()
    writer = Writer(out, chunk_size=2000, compression=compression, use_chunking=use_chunking)
    writer.start(profile="ros2")
    schema = writer.register_schema(SAMPLE.type, "ros2msg", SAMPLE.schema.encode())
    channel = writer.register_channel(SAMPLE.name, "cdr", schema)
    for sample in SAMPLES:
        writer.add_message(channel, sample.stamp, encode_sample(sample), sample.stamp)
    writer.finish()
    return out.getvalue()


def chunk_before(content: bytes, end: int) -> int:
    """Where the last chunk before a position begins."""
    at, chunk = len(MAGIC), 0
    while at < end:
        opcode, length = struct.unpack_from("<BQ", content, at)
        chunk = at if opcode == 6 else chunk
        at += 9 + length
    return chunk


def scan(path: Path, content: bytes) -> tuple[int, str]:
    """How many messages, all of them intact, and the fault."""
    path.write_bytes(content)
    walk = Scan(path)
    messages = [m.data for m in walk]
    intact = iter([encode_sample(sample) for sample in SAMPLES])
    assert all(message in intact for message in messages)  # in their order, none twice
    return len(messages), walk.fault


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    return flushed_file(tmp_path_factory.mktemp("scan") / "run")


def test_every_cut_gives_the_messages_before_it(tmp_path, whole):
    ends = [whole.index(encode_sample(sample)) + len(encode_sample(sample)) for sample in SAMPLES]
    # A stride that meets every place within a record, for their length is not a multiple of it.
    for cut in range(len(MAGIC), len(whole), 11):
        count, fault = scan(tmp_path / "x.mcap", whole[:cut])
        assert count == sum(end <= cut for end in ends)
        assert fault.startswith("the file is truncated")


def test_a_cut_within_the_first_bytes_is_not_a_session(tmp_path, whole):
    for cut in range(1, len(MAGIC)):
        with pytest.raises(SessionError, match="is not a session"):
            scan(tmp_path / "x.mcap", whole[:cut])


LOST = "the file is damaged: only 40 of 60 messages are left"


def taken_for_something_else(whole: bytes) -> bytes:
    at = chunk_before(whole, whole.index(encode_sample(SAMPLES[45])))
    return whole[:at] + b"\x86" + whole[at + 1 :]


def with_a_wrong_bit(whole: bytes) -> bytes:
    at = whole.index(encode_sample(SAMPLES[45])) + 30
    return whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]


@pytest.mark.parametrize(
    ("spoil", "count", "fault"),
    [
        (bytes, COUNT, ""),
        (lambda whole: whole[:-1], COUNT, "the file is truncated after its last message"),
        (taken_for_something_else, 40, LOST),
        (with_a_wrong_bit, 40, "the file is damaged: the checksum of a chunk is wrong"),
        (lambda whole: MAGIC + struct.pack("<BQ", 6, 2**63) + whole[8:], 0, "the file is truncated"),
    ],
)
def test_what_comes_before_the_damage_is_read(tmp_path, whole, spoil, count, fault):
    assert scan(tmp_path / "x.mcap", spoil(whole)) == (count, fault)


@given(st.data())
def test_one_wrong_byte_never_gives_a_wrong_sample(tmp_path_factory, whole, data):
    place = data.draw(st.integers(0, len(whole) - 1))
    wrong = bytearray(whole)
    wrong[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.getbasetemp() / "wrong.mcap"
    if place < len(MAGIC):
        with pytest.raises(SessionError, match="is not a session"):
            scan(path, bytes(wrong))
    else:
        count, fault = scan(path, bytes(wrong))
        assert count == COUNT or fault


@given(st.binary(max_size=400))
def test_garbage_is_refused_or_read_as_nothing(tmp_path_factory, garbage):
    assume(not garbage.startswith(MAGIC))
    path = tmp_path_factory.getbasetemp() / "garbage.mcap"
    path.write_bytes(garbage)
    with pytest.raises(SessionError, match=r"is not a session|the file is empty"):
        read_session(path)
    path.write_bytes(MAGIC + garbage)
    with pytest.raises(SessionError, match="has no topics"):
        read_session(path)


def test_zeros_where_a_record_should_begin_are_said(tmp_path, whole):
    head = whole[: chunk_before(whole, whole.index(encode_sample(SAMPLES[20])))]
    count, fault = scan(tmp_path / "x.mcap", head + bytes(500))
    assert count == 20
    assert fault == f"the file is damaged at byte {len(head)}: no record begins there"


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_other_recorders_are_read(tmp_path, compression):
    content = library_file(compression)
    assert scan(tmp_path / "x.mcap", content) == (COUNT, "")
    count, fault = scan(tmp_path / "x.mcap", content[: len(content) // 2])
    assert 0 < count < COUNT
    assert fault == "the file is truncated"


def test_files_without_chunks_are_read(tmp_path):
    content = library_file(CompressionType.NONE, use_chunking=False)
    assert scan(tmp_path / "x.mcap", content) == (COUNT, "")


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_damaged_compressed_chunk_ends_the_reading(tmp_path, compression):
    content = bytearray(library_file(compression))
    name = compression.name.lower().encode()
    first = content.index(name) + len(name) + 8
    content[first : first + 4] = b"\xff\xff\xff\xff"
    count, fault = scan(tmp_path / "x.mcap", bytes(content))
    assert count == 0
    assert fault.startswith(f"a chunk compressed with {compression.name.lower()} cannot be unpacked")


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


@pytest.mark.parametrize(
    ("tail", "fault"),
    [
        (record(5, b"\1\0"), "the file is damaged: a message is too short"),
        (record(5, bytes(22)), "the file is damaged: a message belongs to no topic"),
        (record(3, b"\1\0\4"), "the file is damaged: a schema cannot be read"),
        (record(4, b""), "the file is damaged: a channel cannot be read"),
        (record(6, bytes(32) + b"\xff" * 8), "the file is damaged: a chunk cannot be read"),
        (record(6, b"\1"), "the file is damaged: a chunk cannot be read"),
        (record(0x90, b"private") + record(0, b""), "the file is damaged at byte 24: no record begins there"),
    ],
)
def test_invalid_records_are_reported(tmp_path, tail, fault):
    assert scan(tmp_path / "x.mcap", MAGIC + tail) == (0, fault)


def test_a_file_that_cannot_be_opened_is_named(tmp_path):
    with pytest.raises(SessionError, match="cannot be read"):
        list(Scan(tmp_path / "missing.mcap"))
