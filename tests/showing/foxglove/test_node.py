"""The whole command: a real graph on one side, a viewer that decodes what it is given on the other."""

from __future__ import annotations

import json
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rclpy.context import Context
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Float64, Float64MultiArray

from tests.support.places import SHIPPED
from tests.support.plants import Motor
from tests.support.processes import Process
from tests.support.schemas import bare
from tests.support.verdicts import verdict
from tests.support.waiting import wait_for
from twinmatch.comparing import TrustLevel
from twinmatch.nodes.messages import description_message, message_of
from twinmatch.plants.records import description_of
from twinmatch.plants.tclab import TCLabBoth
from twinmatch.sessions import read_session, write_session
from twinmatch_msgs.msg import (
    EstimatedReading,
    LoopSample,
    ModelScore,
    PlantDescription,
)

pytestmark = pytest.mark.ros
RELIABLE = QoSProfile(depth=100)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


class Graph:
    """Publishers as the graph has them, under one namespace."""

    def __init__(self, namespace: str = "", reference: Any = Float64) -> None:
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(
            "graph", namespace=namespace, context=self.context
        )
        make = self.node.create_publisher
        self.samples = make(LoopSample, "plant/sample", RELIABLE)
        self.references = make(reference, "plant/reference", LATCHED)
        self.scores = make(ModelScore, "twin/model_score", RELIABLE)
        self.images = make(Image, "thermal/image", SENSOR)
        self.clocks: Any = None

    def sample(self, index: int) -> LoopSample:
        message = LoopSample(
            index=index, reference=[60.0], output=[25.5 + index], input=[-255.0 / 3]
        )
        message.header.stamp.sec = 100 + index
        self.samples.publish(message)
        return message

    def is_heard(self) -> bool:
        return all(
            p.get_subscription_count() for p in (self.samples, self.scores, self.images)
        )

    def tell_clock(self, seconds: int) -> None:
        if self.clocks is None:
            self.clocks = self.node.create_publisher(Clock, "/clock", 10)
        message = Clock()
        message.clock.sec = seconds
        self.clocks.publish(message)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def graph(ros: None) -> Iterator[Callable[..., Graph]]:  # noqa: ARG001
    started: list[Graph] = []

    def start(namespace: str = "", **more: Any) -> Graph:
        started.append(Graph(namespace, **more))
        return started[-1]

    yield start
    for opened in started:
        opened.close()


def decode(channel: dict[str, Any], data: bytes) -> Any:
    """A message by the definition that the channel came with, as a viewer has to."""
    schema = Schema(
        id=1,
        name=channel["schemaName"],
        encoding=channel["schemaEncoding"],
        data=channel["schema"].encode(),
    )
    decoder = DecoderFactory().decoder_for(channel["encoding"], schema)
    assert decoder is not None
    return decoder(data)


def definition(channel: dict[str, Any]) -> tuple[str, ...]:
    """What a viewer is sent about a topic."""
    return tuple(
        channel[key] for key in ("encoding", "schemaName", "schemaEncoding", "schema")
    )


def definitions(path: Path) -> dict[str, tuple[str, ...]]:
    """What a recorded session says of its topics."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    by_topic = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        by_topic[channel.topic] = (
            channel.message_encoding,
            schema.name,
            schema.encoding,
            schema.data.decode(),
        )
    return by_topic


def test_messages_arrive_whole_and_decode_by_the_definitions_that_come_with_them(
    serve: Callable[..., Any], view: Callable[[str], Any], graph: Callable[..., Graph]
) -> None:
    rig = graph()
    viewer = view(serve().url)
    viewer.subscribe("/plant/sample", "/twin/model_score", "/thermal/image")
    viewer.wait(rig.is_heard, "its reader")
    sent = [rig.sample(k) for k in range(3)]
    score = message_of(verdict(TrustLevel.TRUSTED, nominal="60 °C"), 0)
    score.candidates[0].orders[0].y.gain = 12.5
    image = Image(height=2, width=3, encoding="32FC1", step=12, data=bytes(range(24)))
    rig.scores.publish(score)
    rig.images.publish(image)
    viewer.wait(
        lambda: {m.topic for m in viewer.messages} == set(viewer.subscribed),
        "one of each",
    )
    # bytes between the fields are not always the same
    arrived = viewer.heard("/twin/model_score")[0].data
    assert str(deserialize_message(arrived, ModelScore)) == str(score)
    first = deserialize_message(viewer.heard("/plant/sample")[0].data, LoopSample)
    assert first == sent[first.index]
    decoded = decode(
        viewer.channels["/plant/sample"], viewer.heard("/plant/sample")[0].data
    )
    assert (list(decoded.output), list(decoded.input)) == (
        [25.5 + decoded.index],
        [-85.0],
    )
    decoded = decode(
        viewer.channels["/twin/model_score"], viewer.heard("/twin/model_score")[-1].data
    )
    assert (decoded.nominal, decoded.decided) == ("60 °C", score.decided)
    assert [list(c.nu_gap_low) for c in decoded.candidates] == [
        list(c.nu_gap_low) for c in score.candidates
    ]
    assert decoded.candidates[0].orders[0].y.gain == 12.5
    decoded = decode(
        viewer.channels["/thermal/image"], viewer.heard("/thermal/image")[-1].data
    )
    assert bytes(decoded.data) == bytes(range(24))


def test_definitions_are_those_of_an_imported_session_and_there_before_the_graph(
    serve: Callable[..., Any], view: Callable[[str], Any], tmp_path: Path
) -> None:
    viewer = view(serve().url)
    [path] = write_session(tmp_path / "today", read_session(SHIPPED).samples).glob(
        "*.mcap"
    )
    recorded = definitions(path)
    assert {"/plant/sample", "/plant/reference", "/plant/temperature"} <= set(recorded)
    viewer.wait(lambda: set(recorded) <= set(viewer.channels), "the topics")
    shown = {topic: definition(viewer.channels[topic]) for topic in recorded}
    assert {t: (*d[:-1], bare(d[-1])) for t, d in recorded.items()} == {
        t: (*d[:-1], bare(d[-1])) for t, d in shown.items()
    }


def test_definitions_are_those_of_a_session_recorded_at_the_same_time(
    serve: Callable[..., Any],
    view: Callable[[str], Any],
    graph: Callable[..., Graph],
    tmp_path: Path,
) -> None:
    rig = graph()
    viewer = view(serve().url)
    options = ["--ros-args", "-p", f"folder:={tmp_path}", "-p", "name:=session"]
    command = [sys.executable, "-m", "twinmatch.nodes", "recorder", *options]
    recorder = Process(*command, output=tmp_path / "recorder.txt", forked=True)
    try:
        readers = (rig.samples, rig.scores, rig.images, rig.references)
        viewer.wait(
            lambda: all(p.get_subscription_count() == 2 for p in readers),
            "both readers",
        )
        rig.sample(0)
        rig.scores.publish(ModelScore())
    finally:
        assert recorder.end(signal.SIGINT) == 0, recorder.text
    [path] = (tmp_path / "session").glob("*.mcap")
    recorded = definitions(path)
    assert {
        "/plant/sample",
        "/twin/model_score",
        "/thermal/image",
        "/diagnostics",
    } <= set(recorded)
    assert recorded == {topic: definition(viewer.channels[topic]) for topic in recorded}


def test_it_survives_the_graph_and_shows_the_next_one(
    serve: Callable[..., Any], view: Callable[[str], Any], graph: Callable[..., Graph]
) -> None:
    server = serve()
    viewer = view(server.url)
    first = graph()
    first.references.publish(Float64(data=30.0))
    viewer.subscribe("/plant/reference", "/plant/sample")
    viewer.wait(lambda: viewer.heard("/plant/reference"), "the latched set-point")
    first.close()
    second = graph()
    second.references.publish(Float64(data=45.0))
    viewer.wait(
        lambda: len(viewer.heard("/plant/reference")) == 2,
        "the set-point of the next graph",
    )
    assert (
        decode(
            viewer.channels["/plant/reference"],
            viewer.heard("/plant/reference")[1].data,
        ).data
        == 45.0
    )
    viewer.wait(
        lambda: second.sample(3) and viewer.heard("/plant/sample"),
        "a sample of the next graph",
    )
    late = view(server.url)
    late.subscribe("/plant/reference")
    late.wait(lambda: late.heard("/plant/reference"), "what was said before it came")
    assert (
        late.heard("/plant/reference")[0].data
        == viewer.heard("/plant/reference")[1].data
    )


def test_set_points_of_several_loops_are_shown(
    serve: Callable[..., Any], view: Callable[[str], Any], graph: Callable[..., Graph]
) -> None:
    """They have another type than those of one, which is advertised before the graph is there."""
    viewer = view(serve().url)
    viewer.wait(lambda: "/plant/reference" in viewer.channels, "what is advertised")
    graph(reference=Float64MultiArray).references.publish(
        Float64MultiArray(data=[50.0, 35.0])
    )
    viewer.wait(
        lambda: "MultiArray" in viewer.channels["/plant/reference"]["schemaName"],
        "the new type",
    )
    viewer.subscribe("/plant/reference")
    viewer.wait(lambda: viewer.heard("/plant/reference"), "the set-points")
    (heard,) = viewer.heard("/plant/reference")
    assert list(decode(viewer.channels["/plant/reference"], heard.data).data) == [
        50.0,
        35.0,
    ]


def test_time_is_that_of_the_plant(
    serve: Callable[..., Any], view: Callable[[str], Any], graph: Callable[..., Graph]
) -> None:
    rig = graph()
    viewer = view(serve().url)
    viewer.subscribe("/plant/sample")
    viewer.wait(lambda: viewer.times, "a time")
    assert abs(viewer.times[-1] - time.time_ns()) < 60 * 10**9
    viewer.wait(
        lambda: rig.tell_clock(1234) or viewer.times[-1] == 1234 * 10**9,
        "the time of the plant",
    )
    viewer.wait(rig.is_heard, "its reader")
    rig.sample(0)
    viewer.wait(lambda: viewer.heard("/plant/sample"), "a sample")
    assert viewer.heard("/plant/sample")[-1].stamp == 1234 * 10**9


def test_it_shows_the_rig_of_its_namespace_and_tells_how_it_is(
    serve: Callable[..., Any], view: Callable[[str], Any], graph: Callable[..., Graph]
) -> None:
    rig = graph("/rig_a")
    other_rig = graph("/rig_b")
    viewer = view(serve("--namespace", "/rig_a").url)
    viewer.subscribe("/diagnostics", "/rig_a/plant/sample")
    viewer.wait(rig.is_heard, "its reader")

    indices = count()

    def shown() -> object:
        # another one, until the viewer's own wish has arrived
        rig.sample(next(indices))
        return viewer.heard("/rig_a/plant/sample")

    viewer.wait(shown, "a sample")
    assert not other_rig.samples.get_subscription_count()
    assert not any(
        name.startswith(("/rig_b", "/plant", "/twin")) for name in viewer.channels
    )
    viewer.wait(lambda: viewer.heard("/diagnostics"), "its health")
    status = deserialize_message(
        viewer.heard("/diagnostics")[-1].data, DiagnosticArray
    ).status[0]
    assert "foxglove" in status.name
    assert status.level == b"\x00"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_cleanly_while_somebody_looks(
    serve: Callable[..., Any], view: Callable[[str], Any], number: signal.Signals
) -> None:
    server = serve()
    viewer = view(server.url)
    viewer.wait(lambda: viewer.info, "the greeting")
    assert server.end(number) == 0
    assert len(server.text.splitlines()) == 1
    assert "OPEN" not in server.text


def test_a_layout_is_written_when_the_plant_says_what_it_is(
    serve: Callable[..., Any], graph: Callable[..., Graph], tmp_path: Path
) -> None:
    out = tmp_path / "motor.json"
    rig = graph("rig_a")
    serving = serve("--namespace", "/rig_a", "--layout", str(out))
    assert not out.exists()
    describer = rig.node.create_publisher(
        PlantDescription, "plant/description", LATCHED
    )
    describer.publish(description_message(description_of(Motor), 0.05))
    wait_for(
        lambda: out.exists() and "Image!thermal" in out.read_text("utf-8"),
        "a panel for the graph's image",
    )
    serving.said(f"layout for DC motor: {re.escape(str(out))}")
    panels = json.loads(out.read_text("utf-8"))["configById"]
    assert panels["Plot!output"]["yAxisLabel"] == "speed / rad/s"
    assert panels["Plot!input"]["paths"][0]["value"] == "/rig_a/plant/sample.input[0]"
    assert len(panels["Plot!input"]["paths"]) == 2  # nobody applies a PWM here


def test_what_a_sensor_should_read_reaches_the_viewer_beside_a_column_for_each_signal(
    serve: Callable[..., Any],
    graph: Callable[..., Graph],
    view: Callable[..., Any],
    tmp_path: Path,
) -> None:
    out = tmp_path / "two.json"
    rig = graph("rig_a")
    serving = serve("--namespace", "/rig_a", "--layout", str(out))
    describer = rig.node.create_publisher(
        PlantDescription, "plant/description", LATCHED
    )
    describer.publish(description_message(description_of(TCLabBoth), 1.0))
    wait_for(
        lambda: out.exists() and "temperature T2 / °C" in out.read_text("utf-8"),
        "its signals' names",
    )
    panels = json.loads(out.read_text("utf-8"))["configById"]
    assert (
        panels["Plot!output_2"]["paths"][1]["value"] == "/rig_a/plant/sample.output[1]"
    )
    estimates = rig.node.create_publisher(EstimatedReading, "plant/estimate", RELIABLE)
    viewer = view(serving.url)
    viewer.subscribe("/rig_a/plant/estimate")
    wait_for(estimates.get_subscription_count, "the relay", meanwhile=viewer.read)
    estimates.publish(
        EstimatedReading(sample=7, signal="second_temperature", value=41.3, band=0.9)
    )
    (arrived,) = viewer.wait(
        lambda: viewer.heard("/rig_a/plant/estimate"), "the estimate"
    )
    read = deserialize_message(arrived.data, EstimatedReading)
    assert (read.sample, read.signal, read.value, read.band) == (
        7,
        "second_temperature",
        41.3,
        0.9,
    )
