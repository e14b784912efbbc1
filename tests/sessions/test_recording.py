"""Whole sessions: all of what goes in or nothing; live ones are split, and stop whole for want of room."""

from __future__ import annotations

import dataclasses
import itertools
import math
import resource
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from tests.support.processes import kill_once_it_says
from twinmatch.sessions import (
    SessionError,
    SessionWriter,
    read_session,
    samples_of,
    write_session,
)
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import PLANT_TOPICS, SAMPLE
from twinmatch.sessions.recording import (
    EPOCH,
    DiskFullError,
    Recording,
    RecordingLimits,
)
from twinmatch.signals import Sample, Window

SECOND = 10**9
values = st.floats(allow_nan=False, allow_infinity=False)
runs = st.builds(
    lambda first, start, step, rows: [
        Sample(first + i, start + i * step, *row) for i, row in enumerate(rows)
    ],
    st.integers(0, 2**63),
    st.integers(0, 2**31 * 10**9 - 1 - 40 * 10**9),
    st.integers(1, 10**9),
    st.lists(st.tuples(values, values, values), min_size=1, max_size=40),
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def hour(count: int = 3601) -> list[Sample]:
    k = np.arange(count)
    return samples_of(
        Window(
            30.0 + 20.0 * (k // 600 % 2),
            25.0 + 5.0 * np.sin(k / 50),
            np.clip(k * 0.1 - 100, -255, 255),
        )
    )


@given(runs)
def test_samples_survive_the_round_trip(tmp_path_factory, samples):
    folder = tmp_path_factory.mktemp("round") / "trip"
    session = read_session(write_session(folder, samples))
    assert session.samples == samples
    assert session.notes == []
    assert (
        session.counts["/plant/sample"]
        == session.counts["/plant/temperature"]
        == len(samples)
    )


def test_two_writes_give_the_same_bytes(tmp_path):
    for place in ("a", "b"):
        write_session(tmp_path / place / "run", hour(900))
    for name in ("metadata.yaml", "run_0.mcap"):
        assert (tmp_path / "a/run" / name).read_bytes() == (
            tmp_path / "b/run" / name
        ).read_bytes()


def test_samples_of_a_window_are_stamped_by_its_period():
    window = Window([1.0, 2.0], [3.0, 4.0], [5.0, 6.0], first=10, period=0.1)
    assert samples_of(window) == [
        Sample(10, EPOCH + 1_000_000_000, 1.0, 3.0, 5.0),
        Sample(11, EPOCH + 1_100_000_000, 2.0, 4.0, 6.0),
    ]


def test_a_plant_with_several_signals_has_samples_alone(tmp_path):
    """Temperature and reference are topics of one loop."""
    rows = np.arange(40.0).reshape(20, 2)
    window = Window(
        rows, rows + 0.5, rows[:, ::-1], first=7, period=0.5, disturbances=rows[:, :1]
    )
    samples = samples_of(window)
    assert samples[1] == Sample(
        8, EPOCH + 4 * 10**9, (2.0, 3.0), (2.5, 3.5), (3.0, 2.0), (2.0,)
    )
    session = read_session(write_session(tmp_path / "two", samples))
    assert session.samples == samples
    assert session.counts == {"/plant/sample": 20}
    window_read = session.window()
    assert (window_read.first, window_read.period) == (7, 0.5)
    for name in ("references", "outputs", "inputs", "disturbances"):
        np.testing.assert_array_equal(getattr(window_read, name), getattr(window, name))
    wrong = [*samples[:5], dataclasses.replace(samples[5], outputs=(1.0, math.nan))]
    with pytest.raises(
        SessionError, match=r"output of sample 12 is 1.0, nan; only finite values"
    ):
        write_session(tmp_path / "wrong", wrong)


def test_rosbags_reads_folder_metadata_and_messages(tmp_path):
    samples = hour(700)
    folder = write_session(tmp_path / "run", samples)
    with AnyReader([folder]) as reader:
        assert {(c.topic, c.msgtype, c.digest) for c in reader.connections} == {
            (topic.name, topic.type, topic.type_hash) for topic in PLANT_TOPICS
        }
        offered = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
        assert offered["/plant/sample"].reliability == QosReliability.RELIABLE
        assert offered["/plant/temperature"].reliability == QosReliability.BEST_EFFORT
        assert offered["/plant/reference"].durability == QosDurability.TRANSIENT_LOCAL
        assert reader.start_time == EPOCH
        # rosbags counts the end as the nanosecond after
        assert reader.duration == 699 * 10**9 + 1
        theirs = [
            (c.topic, stamp, bytes(data), reader.deserialize(data, c.msgtype))
            for c, stamp, data in reader.messages()
        ]
    ours = [(m.topic.name, m.log_time, m.data) for m in read_session(folder).messages()]
    assert sorted(t[:3] for t in theirs) == sorted(ours)
    stored = [m for topic, *_, m in theirs if topic == "/plant/sample"]
    assert [
        Sample(
            m.index,
            m.header.stamp.sec * 10**9 + m.header.stamp.nanosec,
            *m.reference,
            *m.output,
            *m.input,
        )
        for m in stored
    ] == samples
    assert {m.header.frame_id for m in stored} == {"plate"}
    readings = [m for topic, *_, m in theirs if topic == "/plant/temperature"]
    assert [(m.temperature, m.variance) for m in readings] == [
        (s.output, 0.0) for s in samples
    ]
    changes = [
        (stamp, m.data) for topic, stamp, _, m in theirs if topic == "/plant/reference"
    ]
    assert changes == [(EPOCH, 30.0), (EPOCH + 600 * 10**9, 50.0)]


def test_an_existing_session_is_kept_unless_asked(tmp_path):
    folder = write_session(tmp_path / "run", hour(10))
    with pytest.raises(SessionError, match="exists already"):
        write_session(folder, hour(20))
    assert len(read_session(folder).samples) == 10
    write_session(folder, hour(20), overwrite=True)
    assert len(read_session(folder).samples) == 20
    assert names(tmp_path) == ["run"]


def test_only_sessions_are_overwritten(tmp_path):
    folder = tmp_path / "home"
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(SessionError, match="is not a session and will not be"):
        write_session(folder, hour(3), overwrite=True)
    (tmp_path / "file").write_text("x")
    with pytest.raises(SessionError, match="is not a session and will not be"):
        write_session(tmp_path / "file", hour(3), overwrite=True)
    (tmp_path / "link").symlink_to(write_session(tmp_path / "run", hour(3)))
    with pytest.raises(SessionError, match="is not a session and will not be"):
        write_session(tmp_path / "link", hour(3), overwrite=True)
    assert (folder / "thesis.tex").read_text() == "years of work"


def test_the_replaced_session_comes_back_when_the_new_one_cannot_move(
    tmp_path, monkeypatch
):
    folder = write_session(tmp_path / "run", hour(10))
    rename = Path.rename

    def refuse(self, target):
        if self.parent != tmp_path and self.name == "run":
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(SessionError, match="cannot be moved to its destination"):
        write_session(folder, hour(20), overwrite=True)
    assert len(read_session(folder).samples) == 10
    assert names(tmp_path) == ["run"]


def test_a_place_that_cannot_be_written_is_named_and_a_session_needs_a_name(tmp_path):
    (tmp_path / "file").write_text("x")
    for place, message in (
        (tmp_path / "file" / "run", "cannot be written"),
        ("/", "a folder with a name"),
    ):
        with pytest.raises(SessionError, match=message):
            write_session(place, hour(3))


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        ([], "has no samples"),
        (
            [Sample(0, 0, 1.0, 2.0, 3.0), Sample(2, 2, 1.0, 2.0, 3.0)],
            "sample 2 follows sample 0",
        ),
        ([Sample(5, 0, 1.0, float("nan"), 3.0)], "output of sample 5 is nan"),
        ([Sample(5, -1, 1.0, 2.0, 3.0)], "negative time"),
        ([Sample(5, 2**61, 1.0, 2.0, 3.0)], "outside 1970 to 2038"),
    ],
)
def test_samples_that_are_not_a_session_leave_nothing(tmp_path, samples, message):
    with pytest.raises(SessionError, match=message):
        write_session(tmp_path / "run", samples)
    assert names(tmp_path) == []


@pytest.fixture
def small_disk(tmp_path):
    """No file may grow beyond half an hour, which fails as a full disk does."""
    (file,) = write_session(tmp_path / "whole", hour()).glob("*.mcap")
    size = file.stat().st_size
    shutil.rmtree(tmp_path / "whole")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size // 2, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_nothing_but_the_session_that_was_there(tmp_path, request):
    folder = write_session(tmp_path / "old", hour(10))
    request.getfixturevalue("small_disk")
    for name in ("run", "old"):
        message = rf"session {name}: {tmp_path}\S+ cannot be written \(File too large\) after \d+ messages"
        with pytest.raises(SessionError, match=message):
            write_session(tmp_path / name, hour(), overwrite=True)
    assert names(tmp_path) == ["old"]
    assert len(read_session(folder).samples) == 10


def test_a_kill_while_writing_leaves_no_session(tmp_path):
    program = """
        import sys, time
        from twinmatch.sessions import recording
        from twinmatch.signals import Sample

        whole = recording.plant_messages
        def slow(samples, topics):
            for count, message in enumerate(whole(samples, topics)):
                if count == 3000:
                    print("writing", flush=True)
                    time.sleep(60)
                yield message
        recording.plant_messages = slow
        recording.write_session(sys.argv[1], [Sample(k, k, 1.0, 2.0, 3.0) for k in range(3000)])
    """
    folder = tmp_path / "run"
    kill_once_it_says("writing", program, folder)
    assert not folder.exists()
    write_session(folder, hour(5))
    assert len(read_session(folder).samples) == 5


def fill(recording: Recording, count: int, first: int = 0) -> None:
    recording.add_topic(SAMPLE)
    for k in range(first, first + count):
        recording.write(
            SAMPLE.name,
            encode_sample(Sample(k, k * SECOND, 30.0, 25.0, 1.0)),
            k * SECOND,
        )
        if k % 10 == 9:
            recording.flush()


def indices(folder: Path) -> list[int]:
    return [sample.index for sample in read_session(folder).samples]


@pytest.mark.parametrize(
    ("limits", "files"),
    [
        (RecordingLimits(0.0), 1),
        (RecordingLimits(0.0, 0.0125), 5),
        (RecordingLimits(0.0, 0.0, 49.0), 8),
    ],
)
def test_a_split_session_is_one_session(tmp_path, limits, files):
    recording = Recording(tmp_path / "run", limits, ros_distro="kilted")
    recording.add_record("twinmatch/settings", {"matcher": "{}"})
    fill(recording, 375)
    recording.close()
    names = [f"run_{k}.mcap" for k in range(files)]
    assert sorted(p.name for p in recording.folder.glob("*.mcap")) == names
    session = read_session(recording.folder)
    assert [s.index for s in session.samples] == list(range(375))
    assert session.notes == []
    assert session.records["twinmatch/settings"] == {"matcher": "{}"}
    with Reader(recording.folder) as reader:
        assert reader.message_count == 375
        assert [t // SECOND for _, t, _ in reader.messages()] == list(range(375))
        assert (reader.start_time, reader.end_time) == (0, 374 * SECOND + 1)


def test_every_file_stands_for_itself(tmp_path):
    recording = Recording(tmp_path / "run", RecordingLimits(0.0, 0.0, 49.0))
    recording.add_record("twinmatch/settings", {"matcher": "{}"})
    fill(recording, 120)
    recording.close()
    described = yaml.safe_load((recording.folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert [f["message_count"] for f in described["files"]] == [50, 50, 20]
    assert [
        f["starting_time"]["nanoseconds_since_epoch"] for f in described["files"]
    ] == [k * 50 * SECOND for k in range(3)]
    for k, count in enumerate([50, 50, 20]):
        with (recording.folder / f"run_{k}.mcap").open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            records = {
                record.name: record.metadata for record in reader.iter_metadata()
            }
            assert len(list(reader.iter_messages())) == count
        assert records["twinmatch/settings"] == {"matcher": "{}"}
        metadata = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
        assert (metadata["message_count"], metadata["relative_file_paths"]) == (
            count,
            [f"run_{k}.mcap"],
        )


def test_a_file_without_messages_does_not_widen_the_span(tmp_path):
    with SessionWriter(tmp_path / "run") as writer:
        writer.add_topic(SAMPLE)
        writer.write(
            SAMPLE.name, encode_sample(Sample(7, 7, 1.0, 2.0, 3.0)), 7 * SECOND
        )
        writer.split()
    described = yaml.safe_load((tmp_path / "run/metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert described["starting_time"]["nanoseconds_since_epoch"] == 7 * SECOND
    assert described["duration"]["nanoseconds"] == 0
    assert indices(tmp_path / "run") == [7]


def test_a_nearly_full_disk_is_not_begun_on(tmp_path):
    with pytest.raises(
        DiskFullError,
        match=r"not started: no space left .*: 20 MB are free on the disk, but 50 MB must stay free",
    ):
        Recording(tmp_path / "run", RecordingLimits(50.0), free=lambda _: 20_000_000)
    assert not (tmp_path / "run").exists()


def test_it_stops_in_time_and_leaves_a_whole_session(tmp_path):
    rooms = itertools.chain([90_000_000] * 5, itertools.repeat(49_000_000))
    recording = Recording(
        tmp_path / "run", RecordingLimits(50.0), free=lambda _: next(rooms)
    )
    with pytest.raises(
        DiskFullError,
        match=r"stopped after 50 messages: no space left .*: 49 MB are free",
    ):
        fill(recording, 500)
    session = read_session(tmp_path / "run")
    assert len(session.samples) == 50
    assert session.notes == []
    recording.close()
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 50


def test_the_room_is_that_of_the_disk(tmp_path):
    with pytest.raises(DiskFullError, match="must stay free"):
        Recording(tmp_path / "not" / "yet" / "there", RecordingLimits(1e12))


def test_after_a_failed_split_nothing_is_written(tmp_path):
    recording = Recording(tmp_path / "run", RecordingLimits(0.0, 0.0, 5.0))
    (tmp_path / "run" / "run_1.mcap").mkdir()
    with pytest.raises(
        SessionError, match=r"cannot be written \(Is a directory\) after 10 messages"
    ):
        fill(recording, 50)
    with pytest.raises(SessionError, match="writing failed before"):
        recording.write(SAMPLE.name, b"", 0)
    recording.close()
