"""Records every topic of its namespace into a session, as the bytes that the entrance hands on."""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import parameter_value_to_python

from twinmatch.nodes.doubts import Doubts, Tell
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.node import TwinmatchNode, Worker
from twinmatch.nodes.past import CatchingUp, RecorderPast
from twinmatch.nodes.topics import Following, offered, wanted
from twinmatch.parameters.declared import Setting, given_to, parameters_of
from twinmatch.sessions import Recording, RecordingLimits, SessionError, Topic
from twinmatch.sessions.cdr import decode_sample
from twinmatch.sessions.documents import DocumentError, read_text
from twinmatch.sessions.messages import schema_of
from twinmatch.sessions.metadata import CANDIDATES, CONTINUES, parameters_record
from twinmatch.sessions.recording import FLUSH


@dataclass(frozen=True)
class Silence:
    """When a topic counts as silent: it had a rate, and has missed ten messages of it, and at least 3 s."""

    rhythm: int = 10
    """Messages after which a topic is expected to keep its rate."""
    shortest: float = 3.0
    """Shortest silence, s."""
    intervals: int = 10
    """Silence in mean intervals between messages."""

    def after(self, rate: float) -> float:
        """Time without a message after which a topic of this rate (1/s) is silent, s."""
        return max(self.shortest, self.intervals / rate)


_SILENCE: Final = Silence()


@dataclass
class Arrivals:
    """Arrivals of one topic; times in seconds of a clock that does not jump."""

    count: int = 0
    """Messages so far."""
    first: float = 0.0
    """When the first came, s."""
    last: float = 0.0
    """When the newest came, s."""
    lost: int = 0
    """Messages that the middleware lost."""

    def push(self, now: float) -> None:
        """Count a message."""
        if self.count == 0:
            self.first = now
        self.count += 1
        self.last = now

    @property
    def rate(self) -> float:
        """Mean rate from the first to the newest message, 1/s; 0 before the second."""
        span = self.last - self.first
        return (self.count - 1) / span if span > 0 else 0.0

    def silent(self, now: float) -> bool:
        """Whether a topic with a known rate has gone silent."""
        if self.count < _SILENCE.rhythm or self.rate == 0:
            return False
        return now - self.last > _SILENCE.after(self.rate)

    def text(self) -> str:
        """Rate and count as text."""
        lost = f", {self.lost} lost" if self.lost else ""
        return f"{self.rate:.1f} Hz, {self.count} messages{lost}"


class NodeSettings:
    """Asks every node until it has answered, and again after a restart of the node.

    A killed node stays known for some seconds. If another node of its name starts meanwhile, only the missing
    answer shows it.
    """

    PATIENCE: Final = 3.0
    """Wall seconds after which a node that has not answered is asked again."""
    MAX_NAMES: Final = 1000
    """Most parameters of a node that are asked for."""

    def __init__(self, node: TwinmatchNode, tell: Tell) -> None:
        """`tell` is called with the name and the values of each record, in the executor's thread."""
        self._node = node
        self._tell = tell
        self._own_name = node.get_fully_qualified_name()
        self._namespace = node.get_namespace().rstrip("/") + "/"
        self._clients: dict[str, list[Any]] = {}
        # when each node was asked that has not answered, wall s
        self._asked: dict[str, float] = {}
        self._known_nodes: set[str] = set()
        self._answered: set[str] = set()  # since the last call

    def ask(self) -> None:
        """Ask new nodes; call it periodically."""
        nodes = {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
        }
        of_rig = {name for name in nodes if self._is_of_rig(name)}
        for name in self._answered | (self._clients.keys() - of_rig):
            self._forget(name)
        self._answered.clear()
        self._known_nodes &= of_rig
        wall_now = time.monotonic()
        for name in of_rig - self._known_nodes:
            if name in self._asked and wall_now - self._asked[name] > self.PATIENCE:
                self._forget(name)
            if name not in self._asked:
                self._ask(name, wall_now)

    def _is_of_rig(self, name: str) -> bool:
        """Whether a node is another one in this namespace, and is not hidden."""
        return (
            name.startswith(self._namespace)
            and name != self._own_name
            and "/_" not in name
        )

    def _ask(self, name: str, now: float) -> None:
        """Ask a node for its parameters, once its services are there."""
        if name not in self._clients:
            self._clients[name] = [
                self._node.create_client(ListParameters, f"{name}/list_parameters"),
                self._node.create_client(GetParameters, f"{name}/get_parameters"),
            ]
        clients = self._clients[name]
        if not all(client.service_is_ready() for client in clients):
            return
        self._asked[name] = now
        listing, getting = clients

        def get(future: Any) -> None:
            listed = future.result()
            names = (
                [] if listed is None else list(listed.result.names)[: self.MAX_NAMES]
            )
            answer = getting.call_async(GetParameters.Request(names=names))
            answer.add_done_callback(lambda done: self._take(name, names, done))

        listing.call_async(ListParameters.Request()).add_done_callback(get)

    def _take(self, name: str, names: list[str], future: Any) -> None:
        answer = future.result()
        parameters: dict[str, Any] = {}
        if answer is not None and self._node.entrance.passes(
            f"{name}/get_parameters", answer
        ):
            for parameter, value in zip(names, answer.values, strict=False):
                parameters[parameter] = _json_value(parameter_value_to_python(value))
        texts = {
            parameter: json.dumps(value) for parameter, value in parameters.items()
        }
        self._tell(parameters_record(name), texts)
        path = parameters.get("candidates")
        if isinstance(path, str) and path:
            self._tell(CANDIDATES, {"text": _read(path)})
        self._answered.add(name)
        self._known_nodes.add(name)

    def _forget(self, name: str) -> None:
        self._asked.pop(name, None)
        for client in self._clients.pop(name, []):
            self._node.destroy_client(client)


def _json_value(value: Any) -> Any:
    """A value of a parameter as JSON takes it: arrays are lists."""
    return (
        list(value) if hasattr(value, "tolist") or isinstance(value, tuple) else value
    )


def _read(path: str) -> str:
    try:
        return read_text(Path(path))
    except DocumentError:
        return ""  # unknown: then the session records no candidates


Job = Callable[[], None]


class RecorderNode(TwinmatchNode):
    """Subscribes to the topics it finds and leaves writing to one thread.

    The recording is flushed to disk every 0.4 s, so a killed recorder loses less than half a second;
    `twinmatch repair` repairs its session. On a full disk the recorder ends the process.
    """

    SEARCH: Final = 0.2
    """Interval between two searches for new topics, s."""
    LEAVE: Final = 3.0
    """Time to finish the session at the end, s; part of the runner's `TEARDOWN`."""
    AHEAD: Final = 100
    """Messages queued for the disk above which a virtual plant in step waits."""
    MAX_WAITING: Final = 64_000_000
    """Bytes queued for the disk above which messages are dropped."""

    NAME = "recorder"
    LINGER: ClassVar = 0.3
    PARAMETERS: ClassVar = (
        Setting("folder", "sessions", "Folder for the sessions; created if missing."),
        Setting(
            "name",
            "",
            "Name of the session; empty: rig_ and the date and time of the start.",
        ),
        Setting(
            "continues",
            "",
            "Session of this run that an earlier recorder began; empty: none.",
        ),
        Setting(
            "also",
            ["/diagnostics"],
            "Topics to record outside the namespace, such as /rosout.",
        ),
        Setting(
            "leave_out",
            ["parameter_events"],
            "Prefixes of relative topic names not to record.",
        ),
        *parameters_of(RecordingLimits()),
    )

    worker: Worker[Job] | None = None

    def open(self) -> None:
        """Start the session and the search for topics."""
        values = self.values
        name = values["name"] or time.strftime("rig_%Y-%m-%d_%H-%M-%S")
        limits = given_to(RecordingLimits(), values)
        distro = os.environ.get("ROS_DISTRO", "unknown")
        self._recording = Recording(
            Path(values["folder"]) / name, limits, ros_distro=distro
        )
        self._following = Following(self, raw=True)
        self._kinds: dict[str, str] = {}
        self._unknown: set[str] = set()
        self._arrivals: dict[str, Arrivals] = {}
        self._bytes_taken = 0  # by the worker's queue
        self._bytes_written = 0
        self._dropped = 0  # messages
        self._finished = threading.Event()
        self.worker = worker = Worker(self._do, self.health, backlog=5000)
        self.beside.append(worker)
        self._put = worker.put
        if values["continues"]:
            self._record(CONTINUES, {"session": values["continues"]})
        if self.step is not None:
            self.step.wait_for(lambda: worker.depth > self.AHEAD)
        self._settings = NodeSettings(self, self._record)
        names = [
            self.resolve_topic_name(n)
            for n in ("plant/sample", "twin/match", "twin/model_score")
        ]
        self._past = past = RecorderPast(names, self._keep)
        self._judged_topics = names
        self._doubts = Doubts(self, self._record)
        CatchingUp(
            self,
            past.stream,
            ready=lambda _: all(name in self._following for name in names),
            waiting=lambda: worker.depth,
            patience=past.PATIENCE,
        )
        self.wall_timer(self.SEARCH, self._on_search)
        self.wall_timer(FLUSH, partial(worker.put, self._recording.flush))
        self.get_logger().info(f"recording into {self._recording.folder}")
        self.health.say("recording")
        self.report_on(topics=self._report_topics)

    def report(self) -> Report:
        """Messages, topics and bytes waiting."""
        if self.worker is not None:
            self.worker.watch()
        self.health.set("session", self._recording.folder)
        self.health.set("messages", self._recording.messages)
        self.health.set("topics", len(self._following))
        self.health.set("bytes waiting", self._bytes_taken - self._bytes_written)
        return super().report()

    def close(self) -> bool:
        """Write what is queued and finish the session."""
        if self.worker is None:
            return True
        self.report_now()
        if self.failure is None:
            self._doubts.look(math.inf)
            self._past.finish()
            self.worker.put(self._finish_session)
            if not self._finished.wait(self.LEAVE) and self.failure is None:
                print(
                    "recorder: ended before everything was written; run twinmatch repair on the session",
                    file=sys.stderr,
                )
        return self.worker.close(0.5)

    def _do(self, job: Job) -> None:
        """Run one job in the worker; skipped after a disk error."""
        if self.failed is not None:
            return
        try:
            job()
        except SessionError as error:
            self.failed = error
            raise

    def _finish_session(self) -> None:
        self._recording.close()
        self._finished.set()

    def _on_search(self) -> None:
        if self.get_clock().now().nanoseconds == 0:
            return  # the clock of this run has not started
        namespace = self.get_namespace()
        for name, kinds in self.get_topic_names_and_types():
            if wanted(name, namespace, self.values["also"], self.values["leave_out"]):
                self._subscribe(name, kinds)
        self._doubts.look(time.monotonic())
        self._settings.ask()

    def _subscribe(self, name: str, kinds: list[str]) -> None:
        publishers = None if name in self._unknown else self._following.news(name)
        if not publishers:
            return
        kind = self._kinds.setdefault(name, publishers[0].topic_type)
        if name not in self._following:
            try:
                topic = Topic(
                    name,
                    kind,
                    schema_of(kind),
                    str(publishers[0].topic_type_hash),
                    offered(publishers),
                )
            except SessionError as error:
                self._unknown.add(name)
                self.health.flag(name, Level.ERROR, f"{name} is not recorded: {error}")
                return
            self._arrivals[name] = Arrivals()
            self._put(partial(self._recording.add_topic, topic))
        if len(kinds) > 1:
            text = (
                f"{name} is published as {' and '.join(kinds)}; only {kind} is recorded"
            )
            self.health.flag(name, Level.WARN, text)
        lost = SubscriptionEventCallbacks(
            message_lost=partial(self._on_lost, name), use_default_callbacks=False
        )
        take = partial(self._on_message, name)
        reader = self._following.subscribe(
            name, kind, publishers, take, event_callbacks=lost
        )
        if name in self._judged_topics:
            self._doubts.watch(name, reader)

    def _on_message(self, name: str, data: bytes) -> None:
        arrived = time.monotonic()
        self._arrivals[name].push(arrived)
        if name == self._judged_topics[0]:
            self._doubts.sample(decode_sample(data).index, arrived)
        ros_now = self.get_clock().now().nanoseconds
        if self._past.take(name, data, ros_now):
            self._keep(name, data, ros_now)

    def _keep(self, name: str, data: bytes, log_time: int) -> None:
        if self._bytes_taken - self._bytes_written > self.MAX_WAITING:
            self._dropped += 1
            text = f"{self._dropped} messages were dropped: the disk is too slow"
            self.health.flag("dropped", Level.ERROR, text)
            return
        self._bytes_taken += len(data)
        self._put(partial(self._write, name, data, log_time))

    def _on_lost(self, name: str, event: Any) -> None:
        self._arrivals[name].lost += event.total_count_change
        self.health.flag("lost", Level.WARN, f"the middleware lost messages of {name}")

    def _write(self, name: str, data: bytes, log_time: int) -> None:
        self._recording.write(name, data, log_time)
        self._bytes_written += len(data)

    def _record(self, name: str, values: Mapping[str, str]) -> None:
        self._put(partial(self._recording.add_record, name, values))

    def _report_topics(self) -> Report:
        wall_now = time.monotonic()
        arrivals = dict(self._arrivals)
        silent = [
            name for name, of_topic in arrivals.items() if of_topic.silent(wall_now)
        ]
        values = {name: of_topic.text() for name, of_topic in arrivals.items()}
        if silent:
            return Report(Level.WARN, f"silent: {', '.join(silent)}", values)
        return Report(Level.OK, f"{len(arrivals)} topics", values)
