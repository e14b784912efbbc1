"""The recorder as a process: which topics, everything that was sent, rates and silence, whatever ends it."""

from __future__ import annotations

import itertools
import json
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Temperature
from std_msgs.msg import Float64, String

from tests.support.disks import small_disk
from tests.support.processes import Start
from tests.support.recorded import wait_for_recorded, written
from tests.support.ros import Listener
from tests.support.schemas import bare
from tests.support.waiting import wait_for
from twinmatch.errors import EXIT_USER_ERROR
from twinmatch.nodes import doubts, recorder
from twinmatch.nodes.messages import sample_message
from twinmatch.nodes.recorder import Arrivals
from twinmatch.nodes.topics import LATCHED, RELIABLE, offered, profile_of, wanted
from twinmatch.sessions import Qos, Session, SessionError, read_session, recording
from twinmatch.sessions.cdr import decoded
from twinmatch.sessions.files import EXIT_DISK
from twinmatch.sessions.messages import SAMPLE, schema_of
from twinmatch.sessions.metadata import CANDIDATES, parameters_of
from twinmatch.sessions.recording import repair_session
from twinmatch.signals import Sample
from twinmatch_msgs.msg import LoopSample

pytestmark = pytest.mark.ros

SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


class Rig:
    """Publishes what a rig publishes."""

    def __init__(self, listener: Listener, namespace: str = "") -> None:
        self.listener = listener
        make = listener.node.create_publisher
        self.samples = make(LoopSample, f"{namespace}plant/sample", RELIABLE)
        self.temperatures = make(Temperature, f"{namespace}plant/temperature", SENSOR)
        self.references = make(Float64, f"{namespace}plant/reference", LATCHED)
        self.images = make(Image, f"{namespace}thermal/image_raw", SENSOR)
        assert not listener.health

    def wait_for_reader(self) -> None:
        publishers = (self.samples, self.temperatures, self.references, self.images)
        self.listener.spin_until(
            lambda: all(p.get_subscription_count() for p in publishers), "the recorder"
        )

    def sample(self, index: int) -> LoopSample:
        message = sample_message(
            Sample(index, 10**18 + index * 10**9, 30.0, 25.0 + 1e-9 * index, -3.5)
        )
        self.samples.publish(message)
        return message


@pytest.fixture
def rig(listener: Listener) -> Rig:
    return Rig(listener)


def into(folder: Path) -> list[str]:
    return ["-p", f"folder:={folder}", "-p", "name:=run", "-p", "min_free_mb:=1.0"]


@pytest.fixture
def record(start: Start, tmp_path: Path) -> Start:
    """Start a recorder; it records into `run` in the test's folder."""
    return lambda *arguments: start("recorder", *into(tmp_path), *arguments)


def messages_of(session: Session, topic: str, kind: Any) -> list[Any]:
    """The messages of a topic; their bytes differ from others of the same content in the padding."""
    return [
        deserialize_message(message.data, kind) for message in session.messages([topic])
    ]


def test_everything_is_recorded_as_it_was_sent(
    record: Start, rig: Rig, tmp_path: Path
) -> None:
    """At twenty times the rates of the rig and more: 200 samples, images and temperatures a second."""
    rig.references.publish(Float64(data=40.0))
    process = record()
    rig.wait_for_reader()
    sent: dict[str, list[Any]] = {"sample": [], "temperature": [], "image_raw": []}
    for k in range(300):
        sent["sample"].append(rig.sample(k))
        temperature = Temperature(temperature=25.0 + k)
        rig.temperatures.publish(temperature)
        sent["temperature"].append(temperature)
        image = Image(
            height=60, width=80, encoding="mono16", step=160, data=os.urandom(9600)
        )
        rig.images.publish(image)
        sent["image_raw"].append(image)
        time.sleep(0.005)
    late = rig.listener.node.create_publisher(String, "notes", 10)
    rig.listener.spin_until(
        late.get_subscription_count, "the recorder at the new topic"
    )
    late.publish(String(data="seen"))
    counts = dict.fromkeys(
        ("plant__sample", "plant__temperature", "thermal__image_raw"), 300
    )
    wait_for_recorded(tmp_path / "run", notes=1, **counts)
    assert process.end() == 0
    session = read_session(tmp_path / "run")
    assert session.notes == []
    assert messages_of(session, "/plant/sample", LoopSample) == sent["sample"]
    assert (
        messages_of(session, "/plant/temperature", Temperature) == sent["temperature"]
    )
    assert messages_of(session, "/thermal/image_raw", Image) == sent["image_raw"]
    assert messages_of(session, "/plant/reference", Float64) == [Float64(data=40.0)]
    assert messages_of(session, "/notes", String) == [String(data="seen")]
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == sum(session.counts.values())
    qos = {
        topic.name: (topic.qos.reliability, topic.qos.durability)
        for topic in session.topics
    }
    assert qos["/plant/temperature"] == ("best_effort", "volatile")
    assert qos["/plant/reference"] == ("reliable", "transient_local")
    (sample,) = [topic for topic in session.topics if topic.name == "/plant/sample"]
    assert bare(sample.schema) == bare(SAMPLE.schema)
    assert sample.type_hash == SAMPLE.type_hash


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"\0\3" + data[2:],
        lambda data: data.replace(b"plate", b"\xb0C\0C\xff"),
    ],
    ids=["encoding", "text"],
)
def test_what_only_ros_can_read_is_recorded_so_that_others_can(
    record: Start, rig: Rig, tmp_path: Path, spoil: Callable[[bytes], bytes]
) -> None:
    """One such message would else make a session unreadable."""
    process = record()
    rig.wait_for_reader()
    sent = rig.sample(0)
    next_one = serialize_message(
        sample_message(Sample(1, 10**18 + 10**9, 30.0, 25.0, 0.0))
    )
    rig.samples.publish(spoil(bytes(next_one)))
    wait_for_recorded(tmp_path / "run", plant__sample=2)
    assert process.end() == 0
    session = read_session(tmp_path / "run")
    assert [sample.index for sample in session.samples] == [0, 1]
    first, second = map(decoded, session.messages(["/plant/sample"]))
    assert first.header.frame_id == sent.header.frame_id
    assert second.index == 1


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for messages of a publisher that is gone."""
    monkeypatch.setattr(doubts, "ALONE", 0.0)


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize(
    ("name", "doubted"),
    [
        ("passer_by", "listener and passer_by"),
        ("listener", ""),
        ("", "a node that is gone"),
    ],
)
def test_samples_that_somebody_else_may_have_published_are_doubted(
    record: Start, rig: Rig, tmp_path: Path, name: str, doubted: str
) -> None:
    """Not those of a node that was started again: while DDS lists its predecessor, both have one name."""
    process = record()
    (node,) = process.nodes
    rig.wait_for_reader()
    sent = 0

    def publishers() -> list[str]:
        return sorted(
            info.node_name
            for info in node.get_publishers_info_by_topic("/plant/sample")
        )

    def send(number: int) -> None:
        nonlocal sent
        for _ in range(number):
            rig.sample(sent)
            sent += 1
        wait_for_recorded(tmp_path / "run", plant__sample=sent)

    send(5)
    foreign_node = Node(name or "gone", context=rig.listener.node.context)
    samples = foreign_node.create_publisher(LoopSample, "plant/sample", RELIABLE)
    rig.listener.spin_until(samples.get_subscription_count, "the recorder")
    if name:
        both = sorted(["listener", name])
        rig.listener.spin_until(lambda: publishers() == both, "its name")
        send(3)
    foreign_node.destroy_node()
    rig.listener.spin_until(
        lambda: node.count_publishers("/plant/sample") == 1, "its end"
    )
    send(5)
    assert process.end() == 0
    notes = [note for note in read_session(tmp_path / "run").notes if "doubted" in note]
    if not doubted:
        assert notes == []
        return
    (note,) = notes
    doubt = re.match(
        r"samples 4 to (\d+) are doubted: /plant/sample was published by (.+), and a twin",
        note,
    )
    assert doubt, note
    assert 4 <= int(doubt[1]) <= sent - 1
    assert doubted in doubt[2]


@pytest.mark.parametrize("after", [0.7, 1.5])
def test_a_killed_recorder_loses_less_than_a_second(
    start_process: Start, rig: Rig, tmp_path: Path, after: float
) -> None:
    process = start_process("recorder", *into(tmp_path))
    rig.wait_for_reader()
    sent = []
    deadline = time.monotonic() + after
    while time.monotonic() < deadline:
        rig.sample(len(sent))
        sent.append(time.monotonic())
        time.sleep(0.02)
    killed = time.monotonic()
    process.kill()
    session = read_session(tmp_path / "run")
    indices = [s.index for s in session.samples]
    assert indices == list(range(len(indices)))
    assert all(killed - send_time < 1.0 for send_time in sent[len(indices) :])
    assert "metadata.yaml is missing" in session.notes[0]
    repair = repair_session(tmp_path / "run")
    assert repair.messages == sum(session.counts.values())
    assert [s.index for s in read_session(tmp_path / "run").samples] == indices
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == repair.messages


def test_names_of_other_rigs_and_what_is_left_out_are_not_recorded(
    record: Start, listener: Listener, tmp_path: Path
) -> None:
    mine = Rig(listener, "/one/")
    other_rig = Rig(listener, "/two/")
    process = record(
        "-r", "__ns:=/one", "-p", "leave_out:=[thermal/]", "-p", "also:=[/weather]"
    )
    weather = listener.node.create_publisher(Float64, "/weather", 10)
    listener.spin_until(mine.samples.get_subscription_count, "the recorder")
    listener.spin_until(weather.get_subscription_count, "the recorder")
    mine.sample(0)
    other_rig.sample(5)
    weather.publish(Float64(data=18.0))
    wait_for_recorded(tmp_path / "run", weather=1, one__plant__sample=1)
    assert mine.images.get_subscription_count() == 0
    assert other_rig.samples.get_subscription_count() == 0
    assert process.end() == 0
    session = read_session(tmp_path / "run")
    assert session.topic == "/one/plant/sample"
    assert {"/weather", "/one/plant/temperature"} < set(session.counts)
    assert not {"/clock", "/rosout", "/diagnostics", "/one/thermal/image_raw"} & set(
        session.counts
    )


def test_a_publisher_that_offers_less_is_received_too(
    record: Start, listener: Listener, rig: Rig, tmp_path: Path
) -> None:
    process = record()
    rig.wait_for_reader()
    rig.sample(0)
    first = listener.node.create_publisher(Float64, "extra", RELIABLE)
    listener.spin_until(first.get_subscription_count, "the recorder")
    first.publish(Float64(data=1.0))
    wait_for_recorded(tmp_path / "run", extra=1)
    # at first the recorder asks for more
    quiet = PublisherEventCallbacks(use_default_callbacks=False)
    second = listener.node.create_publisher(
        Float64, "extra", SENSOR, event_callbacks=quiet
    )
    listener.spin_until(second.get_subscription_count, "the recorder")
    second.publish(Float64(data=2.0))
    wait_for_recorded(tmp_path / "run", extra=2, plant__sample=1)
    assert process.end() == 0
    extra = messages_of(read_session(tmp_path / "run"), "/extra", Float64)
    assert extra == [Float64(data=1.0), Float64(data=2.0)]


def test_parameters_of_the_nodes_are_in_the_session(
    record: Start, start: Start, rig: Rig, tmp_path: Path
) -> None:
    family = tmp_path / "family.yaml"
    family.write_text(
        "candidates:\n  - {name: a, operating_point: 40.0, seebeck: 0.08}\n"
    )
    process = record()
    start("matcher", "-p", "seed:=7")
    start("discriminator", "-p", "seed:=7", "-p", f"candidates:={family}")

    def recorded() -> bool:
        session = written(tmp_path / "run")
        names = {"twinmatch/parameters/discriminator", "twinmatch/parameters/matcher"}
        return session is not None and names <= set(session.records)

    rig.wait_for_reader()
    rig.sample(0)
    rig.listener.spin_until(recorded, "the parameters")
    assert process.end() == 0
    records = read_session(tmp_path / "run").records
    parameters = parameters_of(records, "/matcher")
    assert parameters["seed"] == 7
    assert parameters["free"] == ["seebeck", "conductance", "heat_capacity"]
    assert parameters["use_sim_time"] is False
    assert records[CANDIDATES]["text"] == family.read_text()
    assert json.loads(records["twinmatch/parameters/discriminator"]["period"]) == 1.0


def test_a_node_that_was_killed_before_it_answered_is_asked_again(
    record: Start, start_process: Start, rig: Rig, tmp_path: Path
) -> None:
    graph = rig.listener.node
    lost = start_process("matcher", "-p", "seed:=6")
    rig.listener.spin_until(lambda: "matcher" in graph.get_node_names(), "the matcher")
    lost.freeze()
    record()
    rig.wait_for_reader()
    time.sleep(1.0)
    lost.kill()
    start_process("matcher", "-p", "seed:=7")

    def seed() -> object:
        session = written(tmp_path / "run")
        records = {} if session is None else session.records
        return (
            "twinmatch/parameters/matcher" in records
            and parameters_of(records, "/matcher")["seed"]
        )

    rig.sample(0)
    rig.listener.spin_until(lambda: seed() == 7, "the parameters of the other matcher")


def test_a_reader_that_stood_still_is_given_what_it_missed(
    start_process: Start, rig: Rig, tmp_path: Path
) -> None:
    """A thousand messages are kept for it: more than DDS had room for on the way."""
    process = start_process("recorder", *into(tmp_path))
    rig.wait_for_reader()
    process.freeze()
    for index in range(1000):
        rig.sample(index)
    process.thaw()
    wait_for_recorded(tmp_path / "run", plant__sample=1000)


@pytest.mark.parametrize(
    ("room", "code", "words"),
    [
        ("900000000.0", EXIT_DISK, "recording run: not started: no space left in"),
        ("1.0", EXIT_USER_ERROR, "exists already"),
    ],
)
def test_without_room_or_beside_a_session_it_does_not_start(
    start: Start, tmp_path: Path, room: str, code: int, words: str
) -> None:
    if room == "1.0":
        (tmp_path / "run").mkdir()
    process = start("recorder", *into(tmp_path)[:-1], f"min_free_mb:={room}")
    assert process.wait() == code
    assert words in process.text
    assert not list(tmp_path.glob("run/*"))


def test_a_folder_that_cannot_be_written_is_named(start: Start, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here")
    with small_disk(tmp_path / "fixed", 1000, read_only=True) as fixed:
        for folder, why in (
            (tmp_path / "file", "Not a directory"),
            (fixed, "Read-only file system"),
        ):
            process = start("recorder", *into(folder)[:-1], "min_free_mb:=0.0")
            assert process.wait() == EXIT_DISK
            assert f"{folder} cannot be written ({why})" in process.text
            assert "Traceback" not in process.text


def test_a_disk_that_is_full_at_the_start_is_named(
    start: Start, tmp_path: Path
) -> None:
    with small_disk(tmp_path / "full", 100) as full:
        (full / "others").write_bytes(bytes(100 * 1024))
        process = start("recorder", *into(full)[:-1], "min_free_mb:=0.0")
        assert process.wait() == EXIT_DISK
        assert f"no space left in {full}" in process.text


def test_what_a_small_disk_has_room_for_can_be_read(
    start: Start, rig: Rig, tmp_path: Path
) -> None:
    with small_disk(tmp_path / "small", 400) as small:
        process = start("recorder", *into(small)[:-1], "min_free_mb:=0.0")
        rig.wait_for_reader()
        image = Image(
            height=60, width=80, encoding="mono16", step=160, data=bytes(9600)
        )
        numbers = itertools.count()

        def publish() -> None:
            rig.images.publish(image)
            rig.sample(next(numbers))
            time.sleep(0.02)

        wait_for(
            lambda: not process.running,
            lambda: f"its end: {process.text}",
            meanwhile=publish,
        )
        assert process.wait() == EXIT_DISK
        assert f"no space left in {small} after" in process.text
        samples = read_session(small / "run").samples
    assert len(samples) > 5
    assert [sample.index for sample in samples] == list(range(len(samples)))


def test_a_full_disk_ends_it_with_one_line(
    start_script: Start, rig: Rig, tmp_path: Path
) -> None:
    """A limit on the size of files stands for the disk; the session is readable up to there."""
    process = start_script(f"""
import resource, sys
from twinmatch.nodes.__main__ import main
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
sys.argv = ["recorder", "--ros-args", "-p", "folder:={tmp_path}", "-p", "name:=run", "-p", "min_free_mb:=1.0"]
main()
""")
    rig.wait_for_reader()
    image = Image(height=60, width=80, encoding="mono16", step=160, data=bytes(9600))
    k = 0

    def publish() -> None:
        nonlocal k
        rig.images.publish(image)
        rig.sample(k)
        k += 1
        time.sleep(0.02)

    wait_for(
        lambda: not process.running,
        lambda: f"its end: {process.text}",
        meanwhile=publish,
    )
    assert process.wait() == EXIT_DISK
    assert "free some disk space or choose another folder" in process.text
    assert "Traceback" not in process.text
    session = read_session(tmp_path / "run")
    assert len(session.samples) > 5
    assert "the file is truncated" in session.notes[1]
    repair_session(tmp_path / "run")
    assert read_session(tmp_path / "run").samples == session.samples
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == sum(session.counts.values())


def test_a_disk_that_fills_up_ends_it_with_a_whole_session(
    start: Start, rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = 20_000_000
    monkeypatch.setattr(recording, "free_bytes", lambda _: free)
    process = start("recorder", *into(tmp_path)[:-1], "min_free_mb:=10.0")
    rig.wait_for_reader()
    for k in range(10):
        rig.sample(k)
    wait_for_recorded(tmp_path / "run", plant__sample=10)
    free = 9_000_000
    assert process.wait() == EXIT_DISK
    assert "recording run: stopped after" in process.text
    assert "9 MB are free on the disk, but 10 MB must stay free" in process.text
    session = read_session(tmp_path / "run")
    assert session.notes == []
    assert len(session.samples) == 10


def test_rates_and_silence_are_on_diagnostics(record: Start, rig: Rig) -> None:
    record()
    rig.wait_for_reader()
    begun = time.monotonic()
    for k in range(40):
        rig.sample(k)
        time.sleep(0.05)
    sent = 40 / (time.monotonic() - begun)
    rig.listener.spin_until(
        lambda: rig.listener.said("silent: /plant/sample"), "the warning"
    )
    rate, unit, count, _ = rig.listener.values("/plant/sample")[-1].split()
    assert (unit, count) == ("Hz,", "40")
    assert sent / 3 < float(rate) < 3 * sent  # as received, on whatever machine


def test_a_type_that_is_not_installed_is_named(
    record: Start, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def some(kind: str) -> str:
        if kind == "std_msgs/msg/String":
            raise SessionError(
                "session: the definition of std_msgs/msg/String is not installed"
            )
        return schema_of(kind)

    monkeypatch.setattr(recorder, "schema_of", some)
    record()
    rig.listener.node.create_publisher(String, "notes", 10)
    rig.listener.spin_until(
        lambda: rig.listener.said("/notes is not recorded: session: the definition"),
        "the warning",
    )
    rig.wait_for_reader()


def test_with_simulated_time_the_times_are_those_of_the_clock(
    record: Start, rig: Rig, tmp_path: Path
) -> None:
    clock = rig.listener.node.create_publisher(Clock, "/clock", 10)
    process = record("-p", "use_sim_time:=true")
    rig.listener.spin_until(clock.get_subscription_count, "the recorder")

    def tick() -> bool:
        message = Clock()
        message.clock.sec = 5000
        clock.publish(message)
        return bool(rig.samples.get_subscription_count())

    rig.listener.spin_until(tick, "the recorder at the samples")
    rig.sample(0)
    wait_for_recorded(tmp_path / "run", plant__sample=1)
    assert process.end() == 0
    (message,) = read_session(tmp_path / "run").messages(["/plant/sample"])
    assert message.log_time == 5000 * 10**9


@pytest.mark.parametrize(
    ("name", "namespace", "expected"),
    [
        ("/plant/sample", "/", True),
        ("/one/plant/sample", "/one", True),
        ("/one/plant/sample", "/", True),
        ("/two/plant/sample", "/one", False),
        ("/onesie/plant/sample", "/one", False),
        ("/clock", "/", False),
        ("/rosout", "/", False),
        ("/_hidden/topic", "/", False),
        ("/diagnostics", "/one", True),
        ("/thermal/image", "/", False),
    ],
)
def test_topics_of_the_own_rig_and_those_named_are_recorded_and_no_others(
    name: str, namespace: str, expected: bool
) -> None:
    assert wanted(name, namespace, ["/diagnostics"], ["thermal/"]) is expected


def endpoint(*, reliable: bool = True, latched: bool = False, depth: int = 10) -> Any:
    return SimpleNamespace(
        qos_profile=SimpleNamespace(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE
            if reliable
            else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if latched
            else DurabilityPolicy.VOLATILE,
        )
    )


@pytest.mark.parametrize(
    ("endpoints", "qos"),
    [
        ([endpoint()], Qos("reliable", "volatile", 10)),
        ([endpoint(reliable=False, depth=5)], Qos("best_effort", "volatile", 5)),
        ([endpoint(latched=True, depth=0)], Qos("reliable", "transient_local", 1)),
        ([endpoint(latched=True), endpoint(depth=20)], Qos("reliable", "volatile", 20)),
        ([endpoint(), endpoint(reliable=False)], Qos("best_effort", "volatile", 10)),
    ],
)
def test_the_weakest_offer_is_taken(endpoints: list[Any], qos: Qos) -> None:
    assert offered(endpoints) == qos
    profile = profile_of(qos)
    for offering in endpoints:
        # a reader that asks for more than is offered receives nothing
        assert profile.reliability == ReliabilityPolicy.BEST_EFFORT or (
            offering.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        )
        assert profile.durability == DurabilityPolicy.VOLATILE or (
            offering.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        )


@given(st.floats(0.01, 1.0), st.integers(10, 100))
def test_a_rhythm_is_silent_when_it_stops(interval: float, count: int) -> None:
    arrivals = Arrivals()
    for k in range(count):
        arrivals.push(k * interval)
        assert not arrivals.silent(k * interval + interval)
    assert arrivals.rate == pytest.approx(1 / interval)
    assert arrivals.text() == f"{arrivals.rate:.1f} Hz, {count} messages"
    arrivals.lost = 3
    assert arrivals.text().endswith(", 3 lost")
    last = (count - 1) * interval
    assert not arrivals.silent(last + max(3.0, 10 * interval) - 0.01)
    assert arrivals.silent(last + max(3.0, 10 * interval) + 0.01)


def test_what_comes_now_and_then_is_never_silent() -> None:
    arrivals = Arrivals()
    assert not arrivals.silent(1e9)
    for k in range(9):
        arrivals.push(float(k))
    assert not arrivals.silent(1e9)
