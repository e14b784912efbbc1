"""What a node receives is checked before anything else sees it: nonsense is refused, and ends nothing."""

from __future__ import annotations

import io
import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import DescribeParameters, GetParameterTypes
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Temperature
from std_srvs.srv import SetBool, Trigger

from tests.support.nonsense import Nonsense
from tests.support.recorded import wait_for_recorded
from tests.support.ros import Inside, Listener
from tests.support.verdicts import LED, verdict
from tests.support.waiting import wait_for
from twinmatch.comparing import TrustLevel
from twinmatch.fitting import Match, Status
from twinmatch.fitting.match import Fit
from twinmatch.launching.live import Live, LiveRun
from twinmatch.launching.plan import LivePlan
from twinmatch.launching.watch import Settled, Watch
from twinmatch.nodes.entrance import ALONE, Course, Entrance
from twinmatch.nodes.expected import MESSAGES, check
from twinmatch.nodes.fields import MessageError
from twinmatch.nodes.messages import message_of, sample_message
from twinmatch.nodes.past import PAST
from twinmatch.nodes.topics import EVERYTHING, NEWEST
from twinmatch.nodes.twin import MAX_WAITING
from twinmatch.plants import Peltier
from twinmatch.sessions import read_session
from twinmatch.showing.console import Console
from twinmatch.showing.foxglove.node import Foxglove
from twinmatch.showing.page.node import Dashboard
from twinmatch.showing.terminal import Screen
from twinmatch.signals import Sample, Window
from twinmatch.twin import MatchReport, MatchRequest, carry_out
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import Past

pytestmark = pytest.mark.ros


def sound_match() -> messages.Match:
    match = Match(
        parameters=Peltier.model().parameters(),
        free=("seebeck", "conductance"),
        starts={},
        covariance=np.diag([1e-6, 1e-4]),
        fisher=np.eye(2),
        eigenvalues=np.ones(2),
        condition=1.0,
        bounds_hit=(),
        fit=Fit(0.9, 0.8),
        held_back=Fit(0.9, 0.8),
        chi2=1.0,
        samples=(60, 300),
        status=Status.ACCEPTED,
        reason="",
        directions=np.eye(2),
        intervals=np.array([[0.0, 1.0], [0.0, 1.0]]),
    )
    return message_of(MatchReport(320, 40.0, match), 0)


def sound_score() -> messages.ModelScore:
    return message_of(replace(LED, horizons=(10.0,)), 0)


def sound_sample() -> messages.LoopSample:
    return sample_message(Sample(5, 0, 25.0, 24.0, 3.0))


SOUND: dict[str, Callable[[], Any]] = {
    "match": sound_match,
    "score": sound_score,
    "sample": sound_sample,
    "clock": Clock,
    "temperature": Temperature,
    "image": lambda: Image(
        height=2, width=3, encoding="32FC1", step=12, data=bytes(24)
    ),
    "health": lambda: DiagnosticArray(
        status=[DiagnosticStatus(name="a", level=b"\x01")]
    ),
}


@pytest.mark.parametrize("name", SOUND)
def test_sound_messages_pass(name: str) -> None:
    message = SOUND[name]()
    check(message, Peltier)
    MESSAGES[type(message)].read(message)


@pytest.mark.parametrize(
    ("name", "field", "value", "words"),
    [
        ("match", "status", 77, "status is 77 with the word 'accepted'"),
        ("match", "status_name", "perfect", "status is 0 with the word 'perfect'"),
        (
            "match",
            "covariance",
            [1.0],
            "covariance has 1 values for its free parameters; expected 4",
        ),
        ("match", "covariance", [1.0, 2.0, 2.0, 1.0], "covariance is none"),
        (
            "match",
            "covariance",
            [math.nan] * 4,
            "covariance of an accepted match is not finite",
        ),
        (
            "match",
            "parameters.values",
            [math.nan] * 9,
            "parameters: seebeck is not a finite number",
        ),
        (
            "match",
            "parameters.plant",
            "tclab",
            "are those of plant 'tclab'; this run is of peltier",
        ),
        ("match", "parameters.structure", "x (FMU 0ab36ba3)", "has no structure 'x"),
        (
            "match",
            "starts",
            ["sink"],
            "start_values has 0 values for its starts; expected 1",
        ),
        (
            "match",
            "intervals",
            [1.0, 0.0, 0.0, 1.0],
            "intervals: a low end is above its high end",
        ),
        ("match", "intervals", [1.0], "intervals has 1 values"),
        ("match", "first", 2**63, "first is 9223372036854775808"),
        ("match", "last", 400, "its window is 60 to 400 at sample 320"),
        ("score", "level", 9, "level is 9 with the word"),
        ("score", "nu_gap", [0.1, 0.2], "nu_gap has 2 values for its candidates"),
        ("score", "identified_gap", [0.1, 0.2], "identified_gap has 2 values"),
        ("score", "nominal", "nobody", "nominal 'nobody' is not among those listed"),
        ("score", "horizons", [math.nan], "horizons does not rise"),
        (
            "score",
            "horizons",
            [1.0, 2.0],
            "gains has 1 values for its horizons; expected 2",
        ),
        (
            "sample",
            "output",
            [],
            "has 1 references, 0 outputs and 1 inputs; every sample has",
        ),
        (
            "sample",
            "input",
            [1.0, 2.0],
            "1 outputs and 2 inputs; plant peltier has 1, 1, 1",
        ),
        ("sample", "output", [math.nan], "output is nan; expected a finite number"),
        (
            "sample",
            "index",
            2**64 - 1,
            "index is 18446744073709551615; expected −1 to 2⁵³",
        ),
        (
            "sample",
            "header.stamp.sec",
            -1,
            "its stamp is -1 s and 0 ns; a time is not negative",
        ),
        ("clock", "clock.sec", -1, "clock is -1 s and 0 ns; a time is not negative"),
        ("temperature", "header.stamp.sec", -5, "its stamp is -5 s"),
        ("image", "height", 0, "data has 24 bytes for 0 rows of 12 bytes"),
        ("image", "width", 4, "a row has 12 bytes for 4 values of 4 bytes"),
        ("health", "status", [DiagnosticStatus(level=b"\xff")], "expected 0 to 3"),
    ],
)
def test_nonsense_is_refused_with_its_reason(
    name: str, field: str, value: Any, words: str
) -> None:
    message = owner = SOUND[name]()
    *path, last = field.split(".")
    for part in path:
        owner = getattr(owner, part)
    setattr(owner, last, value)
    with pytest.raises(MessageError) as error:
        check(message, Peltier)
    assert words in str(error.value)


@pytest.mark.parametrize(
    "kind", [messages.Match, messages.ModelScore, messages.LoopSample]
)
def test_a_message_of_default_values_is_refused(kind: Any) -> None:
    with pytest.raises(MessageError):
        check(kind())


def sample_at(index: int, seconds: float = 0.0) -> messages.LoopSample:
    return sample_message(Sample(index, round(seconds * 1e9), 0.0, 0.0, 0.0))


class Publishers:
    """Who publishes."""

    def __init__(self) -> None:
        self.there = frozenset([b"one"])

    def __call__(self) -> frozenset[bytes]:
        return self.there


def passed(course: Course, *indices: int) -> list[int]:
    """Those of the samples, one a second, that follow."""
    followed = []
    for index in indices:
        try:
            course.follow(sample_at(index, index), time.monotonic())
        except MessageError:
            continue
        followed.append(index)
    return followed


@pytest.fixture
def publishers() -> Publishers:
    return Publishers()


@pytest.fixture
def course(publishers: Publishers) -> Course:
    return Course(MESSAGES[messages.LoopSample].departs, publishers)


def test_samples_that_go_back_are_refused(course: Course) -> None:
    assert passed(course, 7, 8, 3, 9, 8, 12) == [7, 8, 9, 12]


def test_an_index_does_not_run_ahead_of_its_stamp(course: Course) -> None:
    assert passed(course, 0, 1) == [0, 1]
    with pytest.raises(MessageError, match="sample 1000000 came 1 s after sample 1"):
        course.follow(sample_at(1_000_000, 2.0), time.monotonic())
    assert passed(course, 2) == [2]


def test_a_forged_sample_far_ahead_does_not_end_a_stream(course: Course) -> None:
    """The third true one in a row is believed."""
    assert passed(course, 1, 2, 90_000, 3, 4, 5, 6) == [1, 2, 90_000, 5, 6]


def test_another_publisher_begins_another_session(
    course: Course, publishers: Publishers
) -> None:
    """But not one that publishes beside the first."""
    assert passed(course, 50, 51) == [50, 51]
    publishers.there = frozenset([b"one", b"two"])
    assert passed(course, 0) == []
    publishers.there = frozenset([b"two"])
    time.sleep(0.6)
    assert passed(course, 0, 1) == [0, 1]


def time_of(seconds: float) -> Clock:
    return Clock(clock=Time(nanoseconds=round(seconds * 1e9)).to_msg())


class ClockCourse(Course):
    """That of /clock, with publishers that come and go; a step of it is a twentieth of a second."""

    def __init__(self) -> None:
        self.others = Publishers()
        super().__init__(MESSAGES[Clock].departs, self.others, owned=True)
        self.second = self.seen
        self.now = 1000.0
        self._several = False

    def meet(self, *publishers: bytes) -> None:
        self.others.there = frozenset(publishers)
        self._several = True

    def seen(self) -> bool:
        were_several = self._several
        self._several = len(self.others.there) > 1
        return were_several

    def passed(self, *times: float) -> list[float]:
        """Those of the times that follow."""
        followed = []
        for seconds in times:
            self.now += 0.05
            with suppress(MessageError):
                self.follow(time_of(seconds), self.now)
                followed.append(seconds)
        return followed


FAR = 2e9


def test_a_time_that_goes_back_or_jumps_beyond_what_the_wall_clock_allows_is_refused() -> (
    None
):
    course = ClockCourse()
    course.meet(b"one", b"two")
    assert course.passed(5, 6, FAR, FAR + 1, FAR + 2, 7) == [5, 6, 7]
    with pytest.raises(MessageError, match="the time goes back by 7 s"):
        course.follow(time_of(0), course.now)
    with pytest.raises(
        MessageError, match=r"the time jumps ahead by 2e\+09 s within 0 s"
    ):
        course.follow(time_of(FAR), course.now)


def test_one_publisher_alone_may_jump_ahead_and_be_set_back() -> None:
    """A player at a gap of its session; a plant that was started again, which is believed the third time."""
    assert ClockCourse().passed(5, 6, 7000, 7001, 1, 2, 3, 4) == [
        5,
        6,
        7000,
        7001,
        3,
        4,
    ]


@pytest.mark.parametrize(
    "forged", [[FAR + k for k in range(9)], [0.1 * k for k in range(9)]]
)
def test_who_began_owns_the_clock(forged: list[float]) -> None:
    """However many times another one agrees with itself, also while the owner is silent, and just after."""
    course = ClockCourse()
    assert course.passed(5, 6) == [5, 6]
    course.meet(b"one", b"two")
    assert course.passed(*forged) == []
    course.meet(b"one")
    assert course.passed(*forged) == []
    assert course.passed(7, 8) == [7, 8]


def test_a_clock_whose_owner_was_replaced_is_believed() -> None:
    course = ClockCourse()
    assert course.passed(FAR) == [FAR]  # from one who began too early
    course.meet(b"one", b"two")
    assert course.passed(5, 6, 7, 8) == []
    course.meet(b"two")
    course.now += ALONE
    assert course.passed(9, 10, 11, 12) == [9, 10, 11, 12]


@pytest.mark.parametrize("forged", [FAR, 0.0])
def test_a_forged_clock_is_not_time(
    start: Callable[..., Inside], listener: Listener, forged: float
) -> None:
    """From real publishers that come, publish and go at once, or stay."""
    (node,) = start("twin_simulator", "-p", "use_sim_time:=true").nodes
    owner = listener.node.create_publisher(Clock, "/clock", 10)
    listener.spin_until(owner.get_subscription_count, "the simulator")
    owner_time = 10.0

    def goes_on() -> None:
        """Time continues, and is that of the owner."""
        nonlocal owner_time
        owner_time += 1.0
        wait_for(
            lambda: heard() == owner_time,
            lambda: f"{owner_time} s, not {heard()}",
            meanwhile=lambda: (
                owner.publish(time_of(owner_time)),
                listener.spin_once(),
            ),
        )

    def heard() -> float:
        return node.get_clock().now().nanoseconds / 1e9

    def refused() -> int:
        assert heard() <= owner_time
        return int(node.health.report().values.get("refused: /clock", "0"))

    goes_on()
    for _ in range(10):
        forger = listener.node.create_publisher(Clock, "/clock", 10)
        before = refused()
        listener.spin_until(forger.get_subscription_count, "the simulator")
        for k in range(3):
            forger.publish(time_of(forged + k))
        listener.node.destroy_publisher(forger)
        listener.spin_until(lambda before=before: refused() > before, "the refusal")
        goes_on()
    forger = listener.node.create_publisher(Clock, "/clock", NEWEST)
    for k in range(20):
        before = refused()
        wait_for(
            lambda before=before: refused() > before,
            "the refusal",
            meanwhile=lambda k=k: (
                forger.publish(time_of(forged + k)),
                listener.spin_once(),
            ),
        )
        goes_on()


def test_counts_of_a_report_are_read_as_they_are_written() -> None:
    settled = Settled()
    for text in ("²", "9" * 5000, "", "-3", "4 "):
        values = [KeyValue(key=key, value=text) for key in ("settled", "verdicts")]
        status = DiagnosticStatus(name="discriminator: health", values=values)
        settled.take(DiagnosticArray(status=[status]))
        assert not settled.complete(0, 0)


class Bare(LiveRun):
    """A launcher without processes."""

    def start(self, node: Watch) -> None:
        node.create_subscription(
            messages.LoopSample, "plant/sample", self.live.take_sample, 100
        )

    def show(self, line: str) -> None:
        """Nobody looks."""


def launcher() -> type[Watch]:
    console = Console(file=io.StringIO(), force_terminal=True, width=140, height=50)
    run = Bare(Live(LivePlan(Path("rig.yaml"))), Screen(console, "live"))
    return type("LiveWatch", (Watch,), {"NAME": "live_watch", "supervised": run})


PROGRAMS: dict[str, tuple[str, ...]] = {
    "twin": (),
    "rig": (),
    "plant_clock": ("-p", "address:=localhost:9"),
    "sampler": (
        "-p",
        "map.output:=/y:data",
        "-p",
        "map.input:=/u:data",
        "-p",
        "wait_timeout:=0.0",
    ),
    "recorder": (),
    "player": ("-p", "wait_for:=9"),
    "dashboard": ("-p", "port:=0", "-p", "control:=true"),
    "foxglove": ("-p", "port:=0"),
    "live_watch": (),
}
KINDS: dict[str, Callable[[], list[Any]]] = {
    "dashboard": lambda: [Dashboard],
    "foxglove": lambda: [Foxglove],
    "live_watch": lambda: [launcher()],
}
ANYTHING = {
    Trigger.Request,
    SetBool.Request,
    GetParameterTypes.Request,
    DescribeParameters.Request,
}
"""Requests of which nothing is expected."""
OF_RCLPY = "get_type_description"
"""A service that rclpy answers outside Python."""
EACH = 15
"""Messages of nonsense for each topic and service."""
MALFORMED = int(os.environ.get("TWINMATCH_FUZZ", "120"))
"""Malformed messages for each program."""


@pytest.fixture
def program(
    request: pytest.FixtureRequest, tmp_path: Path, session: Path
) -> Iterator[Inside]:
    name = request.param
    own_arguments = {
        "recorder": ("-p", f"folder:={tmp_path}"),
        "player": ("-p", f"session:={session}", "-p", "wait_timeout:=3600.0"),
    }
    arguments = (
        *PROGRAMS[name],
        "-p",
        "use_sim_time:=true",
        *own_arguments.get(name, ()),
    )
    inside = Inside(name, *arguments, kinds=KINDS[name]() if name in KINDS else ())
    launchers = [node.supervised for node in inside.nodes if isinstance(node, Watch)]
    yield inside
    inside.end()
    for run in launchers:
        run.live.results.close()


def receiving(program: Inside) -> dict[str, Any]:
    """The types of all topics that its nodes read; the log is only passed on, once somebody publishes it."""
    readers = (reader for node in program.nodes for reader in node.subscriptions)
    return {
        reader.topic_name: reader.msg_type
        for reader in readers
        if reader.msg_type is not Log
    }


def serving(program: Inside) -> dict[str, Any]:
    """The types of all services that its nodes offer."""
    kinds = {
        service.service_name: service.srv_type
        for node in program.nodes
        for service in node.services
    }
    return {name: kind for name, kind in kinds.items() if OF_RCLPY not in name}


class Beside:
    """Publishes on every topic that a program reads, and asks all its services."""

    def __init__(self, program: Inside, listener: Listener) -> None:
        self._program = program
        self._listener = listener
        self.topics = receiving(program)
        self.services = serving(program)
        qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = listener.node.create_publisher
        client = listener.node.create_client
        self.writers = {
            name: publisher(kind, name, qos) for name, kind in self.topics.items()
        }
        self.clients = [client(kind, name) for name, kind in self.services.items()]
        self._answers: list[Any] = []
        listener.spin_until(
            lambda: (
                all(writer.get_subscription_count() for writer in self.writers.values())
                and all(client.service_is_ready() for client in self.clients)
            ),
            "the program",
        )

    def ask(self, client: Any, request: Any) -> None:
        self._answers.append(client.call_async(request))

    def hear_out(self) -> None:
        """Until everything is answered: what was published before was then read."""
        self._listener.spin_until(
            lambda: (
                all(answer.done() for answer in self._answers)
                or not self._program.running
            ),
            "answers",
        )
        self._answers.clear()
        assert self._program.running, self._program.text

    def end(self) -> None:
        """End the program, which has said what it refused."""
        refusal_counters = {
            k
            for node in self._program.nodes
            for k in node.health.report().values
            if "refused" in k
        }
        assert len(refusal_counters) >= len(self.topics)
        assert all(
            node.entrance.refusals <= Entrance.MAX_KINDS for node in self._program.nodes
        )
        assert self._program.end() == 0, self._program.text


@pytest.mark.parametrize("program", PROGRAMS, indirect=True)
def test_nonsense_on_every_topic_and_service_ends_nothing(
    program: Inside, listener: Listener
) -> None:
    """Every program continues and says what it refused."""
    beside = Beside(program, listener)
    drawn = Nonsense(18)
    assert beside.topics
    assert beside.services
    assert {kind for kind in beside.topics.values() if kind not in MESSAGES} == set()
    assert {
        kind.Request for kind in beside.services.values()
    } <= MESSAGES.keys() | ANYTHING
    for _ in range(EACH):
        for name, writer in beside.writers.items():
            writer.publish(drawn.message(beside.topics[name]))
        for client in beside.clients:
            request = drawn.message(client.srv_type.Request)
            if not turns_time_off(request):
                beside.ask(client, request)
        beside.hear_out()
    beside.end()


@pytest.mark.parametrize("program", PROGRAMS, indirect=True)
def test_malformed_bytes_on_every_topic_end_nothing(
    program: Inside, listener: Listener, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nor does rclpy write about them."""
    beside = Beside(program, listener)
    drawn = Nonsense(27)
    (*_, client) = (
        client for client in beside.clients if client.srv_type is DescribeParameters
    )
    for _ in range(-(-MALFORMED // len(beside.topics))):
        for name, writer in beside.writers.items():
            writer.publish(drawn.malformed(beside.topics[name]))
        beside.ask(client, DescribeParameters.Request())
        beside.hear_out()
    beside.end()
    assert "error state" not in capfd.readouterr().err


def turns_time_off(request: Any) -> bool:
    """Whether a request sets a parameter that every node has, which may be meant."""
    return any(p.name == "use_sim_time" for p in getattr(request, "parameters", ()))


def test_a_refusal_is_reported_once_with_its_sender(
    start: Callable[..., Inside], listener: Listener, steps: list[Sample]
) -> None:
    assert not listener.health
    start("twin_simulator")
    listener.spin_until(listener.samples.get_subscription_count, "the simulator")
    for _ in range(3):
        listener.samples.publish(messages.LoopSample())
    refusal = "plant/sample: sample 0 has 0 references, 0 outputs and 0 inputs"
    listener.spin_until(lambda: listener.said(refusal), "the refusal")
    listener.spin_until(
        lambda: "3" in listener.values("refused: plant/sample"), "the count"
    )
    listener.spin_until(lambda: listener.said("(published by listener)"), "its sender")
    reported = [
        s.message
        for s in listener.reports("twin_simulator: health")
        if refusal in s.message
    ]
    assert {message.count(refusal) for message in reported} == {1}
    listener.send(steps[:3])
    listener.spin_until(
        lambda: "2" in listener.values("sample"), "the samples after it"
    )


def test_many_kinds_of_nonsense_on_a_topic_are_counted_and_few_are_reported(
    start: Callable[..., Inside], listener: Listener
) -> None:
    """Nobody knows of whom they are: many possible senders are not named one by one."""
    assert not listener.health
    start("twin_simulator")
    listener.spin_until(listener.samples.get_subscription_count, "the simulator")
    other_nodes = [
        Node(f"other_{k}", context=listener.node.context)
        for k in range(Entrance.MAX_NAMES)
    ]
    for node in other_nodes:
        node.create_publisher(messages.LoopSample, "plant/sample", 10)
    many = Entrance.MAX_NAMES + 1
    listener.spin_until(
        lambda: listener.node.count_publishers("plant/sample") == many, "the publishers"
    )
    draw = Nonsense(seed=27)
    for _ in range(60):
        listener.samples.publish(draw.refused(messages.LoopSample))
    listener.spin_until(
        lambda: "60" in listener.values("refused: plant/sample"), "the count"
    )
    listener.spin_until(
        lambda: listener.said(f"(published by one of {many} nodes; ros2 topic"),
        "the senders",
    )
    kinds_told = [
        status.message.count("refused: ")
        for status in listener.reports("twin_simulator: health")
    ]
    assert max(kinds_told) == Entrance.MAX_REASONS
    for node in other_nodes:
        node.destroy_node()


@pytest.mark.parametrize(
    ("topic", "kind", "words"),
    [
        (
            "plant/sample",
            messages.LoopSample,
            "/plant/sample is published by controller and listener",
        ),
        ("/clock", Clock, "/clock is published by listener and listener"),
    ],
)
def test_a_second_publisher_is_named(
    start: Callable[..., Inside], listener: Listener, topic: str, kind: Any, words: str
) -> None:
    assert not listener.health
    start("rig")
    listener.spin_until(lambda: listener.reports("keeper: health"), "the keeper")
    assert not listener.said("is published by")
    publishers = [
        listener.node.create_publisher(kind, topic, 10)
        for _ in range(words.count("listener"))
    ]
    listener.spin_until(lambda: listener.said(words), "the name")
    for publisher in publishers:
        listener.node.destroy_publisher(publisher)
    listener.spin_until(
        lambda: words not in listener.reports("keeper: health")[-1].message, "its end"
    )


def test_a_flood_of_sound_messages_is_not_queued(
    start: Callable[..., Inside], listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matches that nobody asked for, and requests beyond some: they would be asked for again."""
    let = threading.Event()
    monkeypatch.setattr(
        "twinmatch.nodes.twin.carry_out",
        lambda *given: let.wait() and carry_out(*given),
    )
    twin = start("twin")
    nodes = {node.NAME: node for node in twin.nodes}
    matches = listener.node.create_publisher(messages.Match, "twin/match", EVERYTHING)
    requests = listener.node.create_publisher(
        messages.MatchRequest, "twin/match_request", EVERYTHING
    )
    listener.spin_until(
        lambda: all(p.get_subscription_count() for p in (matches, requests)), "the twin"
    )
    for k in range(300):
        matches.publish(sound_match())
        requests.publish(sound_request(k))
    counts = {
        "discriminator": "matches not asked for",
        "matcher": "left to be repeated",
    }

    def counted() -> bool:
        assert twin.running, twin.text
        dropped = {
            name: nodes[name].health.report().values.get(key, "0")
            for name, key in counts.items()
        }
        return (
            int(dropped["discriminator"]) == 300
            and int(dropped["matcher"]) == 300 - MAX_WAITING
        )

    listener.spin_until(
        counted, lambda: str([node.health.report() for node in twin.nodes])
    )
    assert nodes["discriminator"].worker.depth == 0
    assert nodes["matcher"].worker.depth < MAX_WAITING
    let.set()


def sound_request(sample: int) -> messages.MatchRequest:
    window = Window(*(np.full(300, 30.0) for _ in range(3)), first=sample)
    asked = MatchRequest(sample + 299, 30.0, window, Peltier.model().parameters(), None)
    return message_of(asked, 0)


def of_plant(name: str, message: Any) -> Any:
    """The message, with the parameters in it said to be those of another plant."""
    for field in getattr(message, "get_fields_and_field_types", dict)():
        value = getattr(message, field)
        if isinstance(value, messages.Parameters) and value.names:
            value.plant = name
        for part in value if isinstance(value, list) else (value,):
            of_plant(name, part)
    return message


@pytest.mark.parametrize("late", [False, True])
def test_what_is_said_of_a_plant_in_a_file_is_recorded(
    start: Callable[..., Inside],
    listener: Listener,
    steps: list[Sample],
    tmp_path: Path,
    late: bool,
) -> None:
    """The recorder has not loaded it, and receives it live or from the keeper. A message of a plant that it
    has loaded is refused if it cannot be read."""
    published = {"twin/match": sound_match(), "twin/model_score": sound_score()}
    if not late:
        published |= {
            "twin/match_request": sound_request(1),
            "twin/leader": published["twin/model_score"].forecasts[0],
        }
    published = {
        topic: of_plant("of_nobody_here", message)
        for topic, message in published.items()
    }
    make = listener.node.create_publisher
    writers = {
        topic: make(type(message), topic, EVERYTHING)
        for topic, message in published.items()
    }
    publishers = (*writers.values(), listener.samples)
    assert not listener.health
    arguments = "-p", f"folder:={tmp_path}", "-p", "name:=run", "-p", "min_free_mb:=1.0"
    reader = start("rig") if late else start("recorder", *arguments)

    def refused() -> set[tuple[str, str]]:
        entries = [
            v
            for name in ("keeper", "recorder")
            for s in listener.reports(f"{name}: health")
            for v in s.values
        ]
        return {
            (v.key.replace(" /", " "), v.value)
            for v in entries
            if v.key.startswith("refused: ")
        }

    listener.spin_until(
        lambda: all(publisher.get_subscription_count() for publisher in publishers),
        "a reader",
    )
    unreadable = sound_match()
    unreadable.parameters.values = [-1.0] * len(unreadable.parameters.values)
    writers["twin/match"].publish(unreadable)
    listener.send(steps[:330])
    for topic, writer in writers.items():
        writer.publish(published[topic])
    listener.spin_until(refused, "the refusal")
    if late:
        keeper = next(node for node in reader.nodes if node.NAME == "keeper")

        def kept(topic: str) -> int:
            return int(keeper.health.report().values.get(topic, "0"))

        listener.spin_until(
            lambda: kept("twin/match") and kept("twin/model_score"), "the keeper"
        )
        before = listener.samples.get_subscription_count()
        start("recorder", *arguments)
        listener.spin_until(
            lambda: listener.samples.get_subscription_count() > before, "the recorder"
        )
    listener.send(steps[330:331])
    counts = {topic.replace("/", "__"): 1 for topic in published}
    wait_for_recorded(tmp_path / "run", plant__sample=331, **counts)
    assert refused() == {("refused: twin/match", "1")}
    session = read_session(tmp_path / "run")
    for topic, message in published.items():
        (recorded,) = session.messages([f"/{topic}"])
        assert repr(deserialize_message(recorded.data, type(message))) == repr(message)


def test_a_keeper_keeps_no_more_verdicts_than_there_are_samples(
    start: Callable[..., Inside], listener: Listener
) -> None:
    keeper = next(node for node in start("rig").nodes if node.NAME == "keeper")
    scores = listener.node.create_publisher(
        messages.ModelScore, "twin/model_score", EVERYTHING
    )
    listener.spin_until(scores.get_subscription_count, "the keeper")
    for k in range(150):
        scores.publish(message_of(verdict(TrustLevel.TRUSTED, sample=300 + k), 0))
    key = "twin/model_score: more than samples"
    listener.spin_until(
        lambda: keeper.health.report().values.get(key) == "50", "the count"
    )
    assert keeper.report().values["twin/model_score"] == "100"


def test_samples_beyond_what_memory_should_hold_are_left_to_be_fetched(
    start: Callable[..., Inside],
    listener: Listener,
    steps: list[Sample],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("twinmatch.nodes.samples.SampleNode.MAX_QUEUED", -1)
    requests: list[Past.Request] = []

    def answer(request: Past.Request, nothing: Past.Response) -> Past.Response:
        requests.append(request)
        return nothing

    listener.node.create_service(Past, PAST, answer)
    (node,) = start("twin_simulator").nodes
    listener.spin_until(listener.samples.get_subscription_count, "the simulator")
    listener.send(steps[:30])
    listener.spin_until(
        lambda: node.health.report().values.get("samples left to be fetched") == "30",
        "the count",
    )
    monkeypatch.undo()
    listener.send(steps[30:31])
    listener.spin_until(lambda: requests, "the wish for the others")
    assert (requests[0].first, requests[0].count) == (0, 30)
