"""The writer a live recorder uses: any topics, flushed as it goes, honest about the disk."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader

from tests.support.processes import kill_once_it_says
from twinmatch.sessions import Qos, SessionError, SessionWriter, Topic, read_session
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import PLANT_TOPICS, SAMPLE
from twinmatch.signals import Sample

IMAGE = Topic(
    "/thermal/image_raw",
    "sensor_msgs/msg/Image",
    "uint8[] data\n",
    "RIHS01_ab",
    Qos("best_effort"),
)


def encoded(index: int) -> bytes:
    return encode_sample(Sample(index, index * 10**9, 30.0, 25.0, 1.0))


def write(folder: Path, count: int, **options: str) -> Path:
    with SessionWriter(folder, **options) as writer:
        writer.add_topic(SAMPLE)
        for index in range(count):
            writer.write(SAMPLE.name, encoded(index), index * 10**9)
    return folder


def test_raw_messages_of_any_type_come_back_as_they_were(tmp_path):
    stored = [
        (IMAGE, 5, 4, b"\0\1\0\0 abc"),
        (SAMPLE, 6, 6, encoded(0)),
        (IMAGE, 7, 5, b"\0\1\0\0 def"),
    ]
    with SessionWriter(tmp_path / "live", ros_distro="kilted") as writer:
        for topic in (SAMPLE, IMAGE):
            writer.add_topic(topic)
        for topic, logged, published, data in stored:
            writer.write(topic.name, data, logged, published)
        assert writer.counts == {SAMPLE: 1, IMAGE: 2}
    session = read_session(tmp_path / "live")
    assert [tuple(message[:4]) for message in session.messages()] == stored
    assert [m.data for m in session.messages(["/plant/sample"])] == [encoded(0)]
    assert session.topics == [SAMPLE, IMAGE]
    assert (session.start, session.end) == (5, 7)


def test_the_file_says_all_that_rosbag2_asks(tmp_path):
    folder = write(tmp_path / "live", 3, ros_distro="kilted")
    with (folder / "live_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        (record,) = reader.iter_metadata()
        assert reader.get_header().profile == "ros2"
        assert len(list(reader.iter_messages())) == 3
    (schema,) = summary.schemas.values()
    (channel,) = summary.channels.values()
    assert (schema.name, schema.encoding) == (SAMPLE.type, "ros2msg")
    assert schema.data.decode() == SAMPLE.schema
    assert (channel.topic, channel.message_encoding) == ("/plant/sample", "cdr")
    assert channel.metadata["topic_type_hash"] == SAMPLE.type_hash
    written = yaml.safe_load((folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert record.name == "rosbag2"
    assert yaml.safe_load(record.metadata["serialized_metadata"]) == written
    (listed,) = written["topics_with_message_count"]
    assert (
        yaml.safe_load(channel.metadata["offered_qos_profiles"])
        == (listed["topic_metadata"]["offered_qos_profiles"])
    )
    assert written["version"] == 9
    assert written["ros_distro"] == "kilted"
    assert written["duration"]["nanoseconds"] == 2 * 10**9


def test_messages_out_of_order_widen_the_span(tmp_path):
    with SessionWriter(tmp_path / "live") as writer:
        writer.add_topic(SAMPLE)
        for index, logged in enumerate([50, 20, 70]):
            writer.write(SAMPLE.name, encoded(index), logged)
    session = read_session(tmp_path / "live")
    assert (session.start, session.end) == (20, 70)
    assert [m.log_time for m in session.messages()] == [50, 20, 70]


def test_adding_a_topic_again_is_harmless_but_not_as_another(tmp_path):
    with SessionWriter(tmp_path / "live") as writer:
        for topic in PLANT_TOPICS:
            writer.add_topic(topic)
            writer.add_topic(topic)
        with pytest.raises(
            SessionError,
            match="/plant/sample was added before with another type or QoS",
        ):
            writer.add_topic(SAMPLE._replace(qos=Qos("best_effort")))


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda w: w.write("/other", b"", 0), "was not added before"),
        (lambda w: w.write(SAMPLE.name, b"", -1, 0), "negative time"),
        (lambda w: w.write(SAMPLE.name, b"", 0, -1), "negative time"),
        (lambda w: SessionWriter(w.folder), "exists already"),
        (
            lambda w: SessionWriter(w.folder / "live_0.mcap" / "run"),
            r"\(Not a directory\) to begin with",
        ),
        (lambda _: SessionWriter("/"), "a folder with a name"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, write, message):
    with SessionWriter(tmp_path / "live") as writer:
        writer.add_topic(SAMPLE)
        with pytest.raises(SessionError, match=message):
            write(writer)


def test_closing_twice_does_nothing_more_also_without_messages(tmp_path):
    with SessionWriter(tmp_path / "idle") as writer:
        writer.add_topic(SAMPLE)
        writer.flush()
        writer.close()
        before = (tmp_path / "idle" / "idle_0.mcap").read_bytes()
    assert (tmp_path / "idle" / "idle_0.mcap").read_bytes() == before
    with pytest.raises(SessionError, match="has no samples"):
        read_session(tmp_path / "idle")


def test_an_error_of_the_recorder_still_finishes_the_file(tmp_path):
    def record() -> None:
        with SessionWriter(tmp_path / "live") as writer:
            writer.add_topic(SAMPLE)
            writer.write(SAMPLE.name, encoded(0), 0)
            raise RuntimeError("the node fell over")

    with pytest.raises(RuntimeError, match="fell over"):
        record()
    assert read_session(tmp_path / "live").notes == []


def record_flushing(writer: SessionWriter) -> None:
    for index in range(5000):
        writer.write(SAMPLE.name, encoded(index), index * 10**9)
        if index % 10 == 9:
            writer.flush()


def test_a_full_disk_is_said_once_and_what_was_written_is_kept(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = SessionWriter(tmp_path / "live")
    writer.add_topic(SAMPLE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(
            SessionError, match="free some disk space or choose another folder"
        ):
            record_flushing(writer)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    size = (tmp_path / "live" / "live_0.mcap").stat().st_size
    with pytest.raises(SessionError, match="writing failed before"):
        writer.write(SAMPLE.name, encoded(0), 0)
    writer.close()
    assert (tmp_path / "live" / "live_0.mcap").stat().st_size == size
    session = read_session(tmp_path / "live")
    assert len(session.samples) >= writer.counts[SAMPLE] - 10
    assert "metadata.yaml is missing" in session.notes[0]
    assert "the file is truncated" in session.notes[1]


def test_a_killed_recorder_loses_nothing_that_was_flushed(tmp_path):
    program = """
        import sys, time
        from twinmatch.sessions import SessionWriter
        from twinmatch.sessions.cdr import encode_sample
        from twinmatch.sessions.messages import SAMPLE
        from twinmatch.signals import Sample

        writer = SessionWriter(sys.argv[1])
        writer.add_topic(SAMPLE)
        for k in range(1234):
            writer.write(SAMPLE.name, encode_sample(Sample(k, k * 10**9, 30.0, 25.0, 1.0)), k * 10**9)
        writer.flush()
        for k in range(1234, 1250):
            writer.write(SAMPLE.name, encode_sample(Sample(k, k * 10**9, 30.0, 25.0, 1.0)), k * 10**9)
        print("flushed", flush=True)
        time.sleep(60)
    """
    folder = tmp_path / "live"
    kill_once_it_says("flushed", program, folder)
    session = read_session(folder)
    assert [s.index for s in session.samples] == list(range(1234))
    assert session.notes == [
        "metadata.yaml is missing or unreadable: the recording was not finished",
        "live_0.mcap: the file is truncated; 1234 samples up to t = 1233 s could be read",
    ]
