"""A recording: split into files that belong together, whole when it stops for want of room."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from twinmatch.sessions import SessionError, SessionWriter, read_session
from twinmatch.sessions.messages import SAMPLE, encode_sample
from twinmatch.sessions.recording import DiskFullError, Recording, RecordingLimits
from twinmatch.signals import Sample

SECOND = 10**9


def fill(recording: Recording, count: int, first: int = 0) -> None:
    recording.add_topic(SAMPLE)
    for k in range(first, first + count):
        recording.write(SAMPLE.name, encode_sample(Sample(k, k * SECOND, 30.0, 25.0, 1.0)), k * SECOND)
        if k % 10 == 9:
            recording.flush()


def indices(folder: Path) -> list[int]:
    return [sample.index for sample in read_session(folder).samples]


@pytest.mark.parametrize(
    ("limits", "files"),
    [(RecordingLimits(0.0), 1), (RecordingLimits(0.0, 0.0125), 5), (RecordingLimits(0.0, 0.0, 49.0), 8)],
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
    assert [f["starting_time"]["nanoseconds_since_epoch"] for f in described["files"]] == [
        k * 50 * SECOND for k in range(3)
    ]
    for k, count in enumerate([50, 50, 20]):
        with (recording.folder / f"run_{k}.mcap").open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            records = {record.name: record.metadata for record in reader.iter_metadata()}
            assert len(list(reader.iter_messages())) == count
        assert records["twinmatch/settings"] == {"matcher": "{}"}
        own = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
        assert (own["message_count"], own["relative_file_paths"]) == (count, [f"run_{k}.mcap"])


def test_a_file_without_messages_does_not_widen_the_span(tmp_path):
    with SessionWriter(tmp_path / "run") as writer:
        writer.add_topic(SAMPLE)
        writer.write(SAMPLE.name, encode_sample(Sample(7, 7, 1.0, 2.0, 3.0)), 7 * SECOND)
        writer.split()
    described = yaml.safe_load((tmp_path / "run/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert described["starting_time"]["nanoseconds_since_epoch"] == 7 * SECOND
    assert described["duration"]["nanoseconds"] == 0
    assert indices(tmp_path / "run") == [7]


def test_a_nearly_full_disk_is_not_begun_on(tmp_path):
    with pytest.raises(
        DiskFullError, match="not started: 20 MB are free on the disk, but 50 MB must stay free"
    ):
        Recording(tmp_path / "run", RecordingLimits(50.0), free=lambda _: 20_000_000)
    assert not (tmp_path / "run").exists()


def test_it_stops_in_time_and_leaves_a_whole_session(tmp_path):
    rooms = itertools.chain([90_000_000] * 5, itertools.repeat(49_000_000))
    recording = Recording(tmp_path / "run", RecordingLimits(50.0), free=lambda _: next(rooms))
    with pytest.raises(DiskFullError, match="stopped after 50 messages: 49 MB are free"):
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
    with pytest.raises(SessionError, match=r"cannot be written \(Is a directory\) after 10 messages"):
        fill(recording, 50)
    with pytest.raises(SessionError, match="writing failed before"):
        recording.write(SAMPLE.name, b"", 0)
    recording.close()
