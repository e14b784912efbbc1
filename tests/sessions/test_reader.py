"""Sessions as they are found: whole folders, single files, unfinished recordings, several rigs."""

from __future__ import annotations

import dataclasses
import struct
from io import BytesIO
from itertools import product
from pathlib import Path

import pytest
import yaml
from hypothesis import assume, given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from twinmatch.sessions import (
    Qos,
    SessionError,
    SessionWriter,
    Topic,
    read_session,
    write_session,
)
from twinmatch.sessions.cdr import encode_float64, encode_sample
from twinmatch.sessions.messages import REFERENCE, SAMPLE
from twinmatch.sessions.metadata import Part, Summary, files_listed, parse_qos, qos_text
from twinmatch.sessions.scan import MAGIC, Scan
from twinmatch.signals import Sample, SignalError


def run(count: int = 30, first: int = 0, step: int = 10**9) -> list[Sample]:
    return [
        Sample(first + k, (first + k) * step, 30.0, 25.0, float(first + k))
        for k in range(count)
    ]


def record(folder: Path, *rigs: tuple[Topic, list[Sample]]) -> Path:
    with SessionWriter(folder) as writer:
        for topic, samples in rigs:
            writer.add_topic(topic)
            for sample in samples:
                writer.write(topic.name, encode_sample(sample), sample.stamp)
    return folder


def test_a_folder_and_its_file_hold_the_same(tmp_path):
    folder = write_session(tmp_path / "night", run())
    by_folder = read_session(folder)
    by_file = read_session(str(folder / "night_0.mcap"))
    assert by_folder.samples == by_file.samples == run()
    assert by_folder.name == by_file.name == "night"
    assert (by_folder.path, by_file.path) == (folder, folder / "night_0.mcap")


def test_a_session_knows_its_duration_its_period_and_its_window(tmp_path):
    session = read_session(
        write_session(tmp_path / "fast", run(31, first=5, step=100_000_000))
    )
    assert session.duration == 3.0
    assert session.period == 0.1
    window = session.window()
    assert (window.first, len(window), window.period) == (5, 31, 0.1)


def test_messages_can_be_chosen(tmp_path):
    session = read_session(write_session(tmp_path / "run", run()))
    assert session.counts == {
        "/plant/sample": 30,
        "/plant/temperature": 30,
        "/plant/reference": 1,
    }
    chosen = list(session.messages(["/plant/reference"]))
    assert [m.data for m in chosen] == [encode_float64(30.0)]
    assert chosen[0].topic == REFERENCE
    assert len(list(session.messages())) == 61
    with pytest.raises(
        SessionError, match="has no topic /plant/speed; it has /plant/reference, "
    ):
        list(session.messages(["/plant/speed"]))


def test_it_reports_its_progress(tmp_path):
    folder = write_session(tmp_path / "long", run(9000))
    calls: list[tuple[int, int]] = []
    read_session(folder, progress=lambda done, total: calls.append((done, total)))
    size = (folder / "long_0.mcap").stat().st_size
    assert {total for _, total in calls} == {size}
    # 18,001 messages, spread evenly; a chunk that was read counts as a whole.
    assert [position / size for position, _ in calls] == pytest.approx(
        [5 / 18, 10 / 18, 15 / 18], abs=0.1
    )


def test_of_two_rigs_one_has_to_be_named(tmp_path):
    a, b = (SAMPLE._replace(name=f"/{rig}/plant/sample") for rig in "ab")
    folder = record(tmp_path / "run", (a, run(5)), (b, run(7)))
    with pytest.raises(
        SessionError,
        match=r"several rigs \(/a/plant/sample, /b/plant/sample\); give the topic",
    ):
        read_session(folder)
    assert len(read_session(folder, topic="/b/plant/sample").samples) == 7
    with pytest.raises(
        SessionError,
        match=r"has no topic /c/plant/sample of type .*; it has /a/plant/sample, /b",
    ):
        read_session(folder, topic="/c/plant/sample")


def test_samples_under_another_name_are_used_only_when_named(tmp_path):
    folder = record(tmp_path / "run", (SAMPLE._replace(name="/loop"), run(5)))
    with pytest.raises(SessionError, match="has no topic ending in plant/sample"):
        read_session(folder)
    assert len(read_session(folder, topic="/loop").samples) == 5


def test_any_namespace_is_found_and_other_comments_are_the_same_definition(tmp_path):
    bare = SAMPLE.schema.replace("# measured outputs y", "")
    rig = SAMPLE._replace(name="/lab/rig7/plant/sample", schema=bare)
    session = read_session(record(tmp_path / "run", (rig, run())))
    assert (session.topic, session.samples) == (rig.name, run())


@pytest.mark.parametrize(
    ("samples", "note"),
    [
        (run(10) + run(5, first=12), "step from 9 to 12"),
        (
            [sample for k in range(6) for sample in run(4, first=10 * k)],
            "step from 3 to 10, from 13 to 20, from 23 to 30 and 2 more",
        ),
        (run(10) + run(10), "step from 9 to 0"),  # the controller was restarted
    ],
)
def test_gaps_are_noted(tmp_path, samples, note):
    session = read_session(record(tmp_path / "run", (SAMPLE, samples)))
    assert session.samples == samples
    assert session.period == 1.0
    assert session.notes[0] == f"the samples' indices {note}: samples are missing there"
    with pytest.raises(SignalError, match=r"sample \d+ follows sample \d+"):
        session.window()


@pytest.mark.parametrize("field", ["reference", "output", "input"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_values_that_are_not_finite_are_named(tmp_path, field, value):
    samples = run(10)
    samples[6] = dataclasses.replace(samples[6], **{f"{field}s": value})
    with pytest.raises(
        SessionError, match=f"session run: {field} of sample 6 is {value}"
    ):
        read_session(record(tmp_path / "run", (SAMPLE, samples)))


def too_short(folder: Path) -> None:
    with SessionWriter(folder) as writer:
        writer.add_topic(SAMPLE)
        writer.write(SAMPLE.name, b"\0\1\0\0", 0)


def of_a_car(folder: Path) -> None:
    with SessionWriter(folder) as writer:
        for name in ("/speed", "/plant/sample"):
            writer.add_topic(REFERENCE._replace(name=name))
            writer.write(name, encode_float64(1.0), 0)


def of_another_definition(folder: Path) -> None:
    older = SAMPLE._replace(
        schema=SAMPLE.schema.replace("float64[] input", "float32[] input")
    )
    record(folder, (older, run()))


def cut_off(folder: Path) -> None:
    file = write_session(folder, run()) / "run_0.mcap"
    file.write_bytes(file.read_bytes()[:40])


def standing_still(folder: Path) -> None:
    record(folder, (SAMPLE, [dataclasses.replace(s, stamp=7) for s in run()]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda _: None, "does not exist"),
        (lambda path: path.mkdir(), "the folder has no MCAP file"),
        (lambda path: path.touch(), "the file is empty"),
        (lambda path: path.write_text("dear diary"), "is not a session"),
        (too_short, "4 bytes is too short"),
        (of_a_car, "LoopSample; it has /plant/sample, /speed"),
        (of_another_definition, "another definition of LoopSample"),
        (
            cut_off,
            r"session run; run_0\.mcap: the file is truncated: has no topic ending in",
        ),
        (standing_still, "the stamps do not advance between samples 0 and 29"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(tmp_path, make, message):
    make(tmp_path / "run")
    with pytest.raises(SessionError, match=message):
        read_session(tmp_path / "run")


@pytest.mark.parametrize(
    "text", [None, "", "[1, 2", "a: b", "rosbag2_bagfile_information: 3", "\0"]
)
def test_a_folder_without_usable_metadata_is_read_and_noted(tmp_path, text):
    folder = write_session(tmp_path / "run", run())
    (folder / "metadata.yaml").unlink()
    if text is not None:
        (folder / "metadata.yaml").write_text(text)
    session = read_session(folder)
    assert session.samples == run()
    assert session.notes == [
        "metadata.yaml is missing or unreadable: the recording was not finished"
    ]


def test_a_session_of_several_files_is_one(tmp_path):
    folder = record(tmp_path / "run", (SAMPLE, run(10)))
    second = record(tmp_path / "more", (SAMPLE, run(10, first=10)))
    (second / "more_0.mcap").rename(folder / "run_1.mcap")
    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
    names = ["run_0.mcap", "run_1.mcap", "run_2.mcap"]
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    session = read_session(folder)
    assert session.samples == run(20)
    assert session.counts == {"/plant/sample": 20}
    assert session.notes == ["run_2.mcap is listed in metadata.yaml but missing"]
    (folder / "metadata.yaml").unlink()
    assert read_session(folder).samples == run(20)


def test_a_torn_file_is_read_and_the_note_says_how_far(tmp_path):
    folder = write_session(tmp_path / "run", run(100, first=50))
    file = folder / "run_0.mcap"
    content = file.read_bytes()
    file.write_bytes(content[: content.index(encode_sample(run(100, first=50)[70]))])
    session = read_session(folder)
    assert session.samples == run(100, first=50)[:70]
    assert session.notes == [
        "run_0.mcap: the file is truncated; 70 samples up to t = 119 s could be read"
    ]
    assert len(list(session.messages(["/plant/sample"]))) == 70


@pytest.mark.parametrize(
    ("jump", "step"), [(-(10**9) // 2, 0.5), (5 * 10**9, 6.0), (-(10**9), 0.0)]
)
def test_a_clock_that_was_set_is_noted(tmp_path, jump, step):
    samples = [
        dataclasses.replace(s, stamp=s.stamp + 10**10 + (jump if s.index >= 20 else 0))
        for s in run(400)
    ]
    notes = read_session(record(tmp_path / "run", (SAMPLE, samples))).notes
    assert notes == (
        [] if step == 0.5 else [f"the stamps step by {step:g} s from sample 19 to 20"]
    )


def test_one_sample_has_the_usual_period_and_a_file_that_has_gone_is_said_when_it_is_wanted(
    tmp_path,
):
    session = read_session(write_session(tmp_path / "run", run(1)))
    assert session.period == 1.0
    assert session.notes == []
    (tmp_path / "run" / "run_0.mcap").unlink()
    with pytest.raises(SessionError, match="cannot be read"):
        list(session.messages())


def test_qos_survives_its_text_and_that_of_older_and_of_discovered_profiles_is_read():
    for reliability, durability in product(
        ["reliable", "best_effort"], ["volatile", "transient_local"]
    ):
        qos = Qos(reliability, durability, 42)
        assert parse_qos(qos_text(qos)) == qos
    older = "- {reliability: 2, durability: 1, depth: 0}"
    assert parse_qos(older) == Qos("best_effort", "transient_local", 10)
    for text in (
        "",
        "[]",
        "7",
        "- 7",
        "- {depth: 1}",
        "[",
        "- {reliability: x, durability: y, depth: 1}",
    ):
        assert parse_qos(text) == Qos()


def test_listed_files_stay_in_their_folder(tmp_path):
    text = Summary((Part("../../etc/passwd", 0, 0, 0),), {}, "unknown").file_text()
    (tmp_path / "metadata.yaml").write_text(text)
    assert files_listed(tmp_path) == ["passwd"]


# Torn and damaged files: what can be read is read, what no checksum confirms is marked, the damage is said.

COUNT = 60
SAMPLES = [Sample(k, k * 10**9, 30.0, 25.0 + k / 8, float(k)) for k in range(COUNT)]


def flushed_file(folder: Path, messages_per_chunk: int = 20) -> bytes:
    with SessionWriter(folder) as writer:
        writer.add_topic(SAMPLE)
        for sample in SAMPLES:
            writer.write(SAMPLE.name, encode_sample(sample), sample.stamp)
            if sample.index % messages_per_chunk == messages_per_chunk - 1:
                writer.flush()
    return (folder / f"{folder.name}_0.mcap").read_bytes()


def library_file(compression: CompressionType, *, use_chunking: bool = True) -> bytes:
    """A file as other recorders write it."""
    out = BytesIO()
    writer = Writer(
        out, chunk_size=2000, compression=compression, use_chunking=use_chunking
    )
    writer.start(profile="ros2")
    schema = writer.register_schema(SAMPLE.type, "ros2msg", SAMPLE.schema.encode())
    channel = writer.register_channel(SAMPLE.name, "cdr", schema)
    for sample in SAMPLES:
        writer.add_message(channel, sample.stamp, encode_sample(sample), sample.stamp)
    writer.finish()
    return out.getvalue()


def chunk_before(content: bytes, end: int) -> int:
    """Where the last chunk before a position begins."""
    place = len(MAGIC)
    chunk = 0
    while place < end:
        opcode, length = struct.unpack_from("<BQ", content, place)
        chunk = place if opcode == 6 else chunk
        place += 9 + length
    return chunk


def scan(path: Path, content: bytes) -> tuple[int, str]:
    """How many messages, those not marked as unsound all intact, and the fault."""
    path.write_bytes(content)
    walk = Scan(path)
    messages = list(walk)
    intact = iter([encode_sample(sample) for sample in SAMPLES])
    # in their order, none twice
    assert all(m.data in intact for m in messages if m.is_sound)
    assert sum(not m.is_sound for m in messages) == walk.unsound
    return len(messages), walk.fault


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    return flushed_file(tmp_path_factory.mktemp("scan") / "run")


def test_every_cut_gives_the_messages_before_it(tmp_path, whole):
    ends = [
        whole.index(encode_sample(sample)) + len(encode_sample(sample))
        for sample in SAMPLES
    ]
    for cut in range(1, len(MAGIC)):
        with pytest.raises(SessionError, match="is not a session"):
            scan(tmp_path / "x.mcap", whole[:cut])
    # A stride that meets every place within a record, for their length is not a multiple of it.
    for cut in range(len(MAGIC), len(whole), 29):
        count, fault = scan(tmp_path / "x.mcap", whole[:cut])
        assert count == sum(end <= cut for end in ends)
        assert fault.startswith("the file is truncated")


def taken_for(opcode: int):
    """Make the last chunk look like another record."""

    def spoil(whole: bytes) -> bytes:
        place = chunk_before(whole, whole.index(encode_sample(SAMPLES[45])))
        return whole[:place] + bytes([opcode]) + whole[place + 1 :]

    return spoil


def with_a_wrong_bit(sample: int, place: int):
    """Change a bit of a sample, so many bytes from its end."""

    def spoil(whole: bytes) -> bytes:
        data = encode_sample(SAMPLES[sample])
        byte = whole.index(data) + len(data) - place
        return whole[:byte] + bytes([whole[byte] ^ 1]) + whole[byte + 1 :]

    return spoil


def with_a_wrong_channel(whole: bytes) -> bytes:
    """Damage the definition of the topic in the first chunk; the summary still has it."""
    place = whole.index(b"/plant/sample")
    return whole[:place] + bytes(13) + whole[place + 13 :]


DAMAGED = "the file is damaged: "
WRONG = "the checksum of a chunk is wrong"
IMPOSSIBLE = "a message cannot be right and is left out"
INDEX = "the checksum of the index is wrong"


def stating(messages: int):
    """Change the number of messages in the statistics."""
    start_of_statistics = struct.Struct("<BQQ")
    return lambda whole: whole.replace(
        start_of_statistics.pack(11, 56, COUNT),
        start_of_statistics.pack(11, 56, messages),
    )


@pytest.mark.parametrize(
    ("spoil", "count", "fault"),
    [
        (taken_for(0x86), COUNT, "at byte "),  # of a private kind
        (taken_for(0x07), COUNT, "at byte "),  # an index of messages
        (
            with_a_wrong_bit(45, 9),
            COUNT,
            f"{WRONG}; 20 messages were read that no checksum confirms",
        ),
        (
            with_a_wrong_bit(45, 84),
            COUNT - 1,
            f"{WRONG}; {IMPOSSIBLE}; 19 messages were read",
        ),  # of its index
        (
            with_a_wrong_bit(5, 9),
            COUNT,
            f"{WRONG}; 20 messages were read that no checksum confirms",
        ),
        (
            with_a_wrong_channel,
            COUNT,
            f"{WRONG}; 20 messages were read that no checksum confirms",
        ),
        (
            lambda whole: whole[:8] + struct.pack("<BQ", 6, 2**63) + whole[8:],
            COUNT,
            INDEX,
        ),
        (stating(COUNT + 1), COUNT, f"{INDEX}; only 60 of 61 messages are left"),
        (stating(COUNT - 1), COUNT, f"{INDEX}; it has 60 messages, but states 59"),
        (lambda whole: whole + b"more", COUNT, "bytes follow its end"),
        (lambda whole: b"?" + whole[1:], COUNT, "its first bytes are wrong"),
    ],
)
def test_what_can_be_read_is_read(tmp_path, whole, spoil, count, fault):
    read, faults = scan(tmp_path / "x.mcap", spoil(whole))
    assert (read, faults[: len(DAMAGED + fault)]) == (count, DAMAGED + fault)


def test_a_file_that_ends_early_is_truncated_and_a_whole_one_has_no_fault(
    tmp_path, whole
):
    assert scan(tmp_path / "x.mcap", whole) == (COUNT, "")
    assert scan(tmp_path / "x.mcap", whole[:-1]) == (
        COUNT,
        "the file is truncated after its last message",
    )


@given(st.data())
def test_one_wrong_byte_costs_one_sample_at_most_and_never_gives_a_wrong_one(
    tmp_path_factory, whole, data
):
    place = data.draw(st.integers(0, len(whole) - 1))
    wrong = bytearray(whole)
    wrong[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.getbasetemp() / "wrong.mcap"
    count, fault = scan(path, bytes(wrong))
    assert count in {COUNT, COUNT - 1}
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
    assert fault.startswith(
        f"the file is damaged: at byte {len(head)} no record begins"
    )


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_other_recorders_are_read(tmp_path, compression):
    assert scan(tmp_path / "x.mcap", library_file(compression, use_chunking=False)) == (
        COUNT,
        "",
    )
    content = library_file(compression)
    assert scan(tmp_path / "x.mcap", content) == (COUNT, "")
    count, fault = scan(tmp_path / "x.mcap", content[: len(content) // 2])
    assert 0 < count < COUNT
    assert fault == "the file is truncated"


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_that_cannot_be_unpacked_costs_its_messages(tmp_path, compression):
    content = bytearray(library_file(compression))
    name = compression.name.lower().encode()
    first = content.index(name) + len(name) + 8
    content[first : first + 4] = b"\xff\xff\xff\xff"
    count, fault = scan(tmp_path / "x.mcap", bytes(content))
    assert 50 < count < COUNT
    assert fault == f"{DAMAGED}{WRONG}; only {count} of {COUNT} messages are left"


def record_scan(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


@pytest.mark.parametrize(
    ("tail", "fault"),
    [
        (record_scan(5, b"\1\0"), "the file is damaged: a message is too short"),
        (
            record_scan(5, bytes(22)),
            "the file is damaged: a message belongs to no topic",
        ),
        (record_scan(3, b"\1\0\4"), "the file is damaged: a schema cannot be read"),
        (record_scan(4, b""), "the file is damaged: a channel cannot be read"),
        (
            record_scan(6, bytes(32) + b"\xff" * 8),
            "the file is damaged: a chunk cannot be read",
        ),
        (record_scan(6, b"\1"), "the file is damaged: a chunk cannot be read"),
        (
            record_scan(0x90, b"private") + record_scan(0, b""),
            "the file is damaged: at byte 8 no record begins",
        ),
    ],
)
def test_invalid_records_are_reported(tmp_path, tail, fault):
    count, faults = scan(tmp_path / "x.mcap", MAGIC + tail)
    assert (count, faults[: len(fault)]) == (0, fault)
