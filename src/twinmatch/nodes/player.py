"""Plays a session: the plant's topics as they were recorded, byte for byte, and the clock they lived by.

`~/pause` (std_srvs/SetBool) stands still and goes on; the parameter `rate` may be set at any time.
"""

from __future__ import annotations

import importlib
import sys
import threading
import time
from pathlib import Path
from typing import Any, ClassVar

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.diagnostics import Level, Report
from twinmatch.nodes.keeper import Keeper
from twinmatch.nodes.node import READERS, TwinmatchNode, count_readers, missing_readers
from twinmatch.nodes.pace import Pace
from twinmatch.nodes.parameters import Parameter, Values
from twinmatch.nodes.runner import run
from twinmatch.sessions import Message, Qos, Topic, read_session

__all__ = ["Player", "PlayerError", "main"]

DEPTH = 1000
"""Messages kept for readers that have not taken them yet, per topic."""
BATCH = DEPTH // 4
"""Messages after which a player without pace waits until its readers have them all."""
TICK = 0.1
"""Longest wait before the clock is published again, s."""
SAMPLE = "plant/sample"
MADE_ANEW = ("plant/description",)
"""Of the plant's topics those that a twin publishes."""


class PlayerError(TwinmatchError):
    """A session cannot be played here."""


class Player(TwinmatchNode):
    """Publishes the plant topics of a session and /clock, then ends.

    The topics are relative: what was recorded in the namespace of one rig plays in that of another.
    What a twin had published is not played; a twin that listens makes it anew.
    """

    NAME = "player"
    PARAMETERS: ClassVar = (
        Parameter("session", "", "Folder or .mcap file of the session; has to be given."),
        Parameter("topic", "", "Topic of the samples, if the session has several rigs."),
        Parameter("topics", ["plant/", "thermal/"], "How the names of the played topics begin."),
        Parameter(
            "rate",
            1.0,
            "Recorded seconds per second; 0: as fast as readers keep up.",
            "",
            0.0,
            1000.0,
            changeable=True,
        ),
        Parameter("paused", False, "Begin paused; the service ~/pause goes on."),
        Parameter("clock", True, "Publish /clock."),
        Parameter("wait_for", 1, "Readers of plant/sample to wait for before the first message.", "", 0, 100),
        READERS,
        Parameter(
            "wait_timeout", 10.0, "Longest wait for them and for the last to be taken.", "s", 0.1, 3600.0
        ),
    )

    def __init__(self) -> None:
        """Read the parameters."""
        super().__init__()
        self._change = threading.Condition()
        self._paused: bool = self.values["paused"]
        self._ending = False
        self._failure: Exception | None = None
        self._played = 0
        self._over = False
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)

    def open(self) -> None:
        """Read the session and start to wait for readers.

        Raises:
            TwinmatchError: the session cannot be read, or it has messages of types that are not installed.
        """
        if not self.values["session"]:
            raise PlayerError("player: no session; give --ros-args -p session:=path/to/session")
        self._session = read_session(Path(self.values["session"]), self.values["topic"] or None)
        self._prefix = self._session.topic.removesuffix(SAMPLE)
        self._publishers_of = {
            topic.name: self.create_publisher(
                message_class(topic), self._relative(topic.name), qos_profile(topic.qos)
            )
            for topic in self._session.topics
            if self._relative(topic.name).startswith(tuple(self.values["topics"]))
            and self._relative(topic.name) not in MADE_ANEW
        }
        if self._session.topic not in self._publishers_of:
            msg = f"player: topics {self.values['topics']} leave out {self._relative(self._session.topic)}"
            raise PlayerError(msg)
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if self.values["clock"] else None
        self._pace = Pace(self.values["rate"], self._session.start / 1e9)
        self.create_service(SetBool, "~/pause", self._on_pause)
        for note in self._session.notes:
            self.get_logger().warning(note)
        self.health.say("waiting for readers")
        self.report_on()
        self._thread.start()

    @property
    def failure(self) -> Exception | None:
        """What ended the playing before its time."""
        return self._failure

    def report(self) -> Report:
        """Where the recording stands."""
        self.health.set("messages", self._played)
        self.health.set("ended", self._over)
        with self._change:
            self.health.set("rate", self._pace.rate)
            self.health.set("paused", self._paused)
            position = self._pace.position(time.monotonic()) - self._session.start / 1e9
        self.health.set("position", f"{position:.1f} s of {self._session.duration:.1f} s")
        return super().report()

    def close(self) -> bool:
        """Stop playing."""
        with self._change:
            self._ending = True
            self._change.notify_all()
        if self._thread.ident is not None:
            self._thread.join(2.0)
        return not self._thread.is_alive()

    def _relative(self, name: str) -> str:
        return name.removeprefix(self._prefix)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._change:
            self._paused = request.data
            if request.data:
                self._pace.pause(time.monotonic())
            self._change.notify_all()
        self.health.say("paused" if request.data else "playing")
        self.report_now()
        response.success = True
        response.message = "paused" if request.data else "playing"
        return response

    def change(self, values: Values) -> None:
        """Adopt another rate, as by `ros2 param set /player rate 20`."""
        with self._change:
            self._pace.change(values["rate"], time.monotonic())
            self._change.notify_all()
        self.report_now()

    def _run(self) -> None:
        try:
            if self._wait_for_readers() and self._play():
                self._finish()
        except Exception as error:  # handed to the main thread
            self._failure = error

    def _wait_for_readers(self) -> bool:
        publisher = self._publishers_of[self._session.topic]
        wanted, timeout = self.values["wait_for"], self.values["wait_timeout"]
        deadline = time.monotonic() + timeout
        while count_readers(self, publisher.topic_name) < wanted or self._missing(publisher):
            if self._ending:
                return False
            if time.monotonic() > deadline:
                self._complain_of(self._missing(publisher), publisher.topic_name)
                found = count_readers(self, publisher.topic_name)
                msg = (
                    f"player: {found} of {wanted} readers of {publisher.topic_name} came within "
                    f"{timeout:g} s; start them first, or lower wait_for"
                )
                raise PlayerError(msg)
            time.sleep(0.02)
        self.health.say("paused" if self._paused else "playing")
        return True

    def _missing(self, publisher: Any) -> list[str]:
        return missing_readers(self, publisher.topic_name, self.values["readers"])

    def _complain_of(self, missing: list[str], topic: str) -> None:
        if missing:
            timeout = self.values["wait_timeout"]
            msg = f"player: {', '.join(missing)} did not come to read {topic} within {timeout:g} s"
            raise PlayerError(msg)

    def _play(self) -> bool:
        """Publish everything; whether the end was reached."""
        for message in self._session.messages(self._publishers_of):
            if not self._wait_until_due(message.log_time):
                return False
            self._publish_clock(message.log_time)
            self._publish(message)
            if self._pace.rate == 0 and self._played % BATCH == 0 and not self._wait_for_taking():
                return False
        return True

    def _wait_until_due(self, log_time: int) -> bool:
        recorded = log_time / 1e9
        with self._change:
            while not self._ending:
                now = time.monotonic()
                if not self._paused:
                    self._pace.resume(now)
                wait = self._pace.wait(recorded, now)
                if wait == 0:
                    self._pace.reach(recorded, now)
                    return True
                self._publish_clock(min(log_time, round(self._pace.position(now) * 1e9)))
                self._change.wait(TICK if wait is None else min(wait, TICK))
        return False

    def _publish(self, message: Message) -> None:
        self._publishers_of[message.topic.name].publish(message.data)
        self._played += 1

    def _publish_clock(self, at: int) -> None:
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=Time(nanoseconds=at).to_msg()))

    def _wait_for_taking(self, deadline: float | None = None) -> bool:
        """Wait until the readers have what was published; whether they have.

        A reader of ours keeps all it was sent and is not sent more than it has room for, so this holds a
        player back to the pace of the slowest of them.
        """
        publishers = list(self._publishers_of.values())
        if deadline is not None and self._clock_publisher is not None:
            publishers.append(self._clock_publisher)
        for publisher in publishers:
            if publisher.qos_profile.reliability != ReliabilityPolicy.RELIABLE:
                continue
            while not publisher.wait_for_all_acked(Duration(seconds=0.5)):
                if self._ending or (deadline is not None and time.monotonic() > deadline):
                    return False
        return True

    def _finish(self) -> None:
        if self._wait_for_taking(time.monotonic() + self.values["wait_timeout"]):
            self.health.say(f"ended: all {self._played} messages were taken")
        else:
            self.health.complain("end", Level.WARN, "ended: some readers did not take the last messages")
        self._over = True
        self.report_now()
        self.exit_code = 0


def qos_profile(qos: Qos) -> QoSProfile:
    """The recorded quality of service; with more room, so that a reader may be slow for a while."""
    transient = qos.durability == "transient_local"
    reliable = qos.reliability == "reliable"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth if transient else max(qos.depth, DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
    )


def message_class(topic: Topic) -> Any:
    """The class of a recorded type.

    Raises:
        PlayerError: the type is not installed.
    """
    package, _, name = topic.type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        msg = f"player: {topic.name} has the type {topic.type}, which is not installed here"
        raise PlayerError(msg) from None


def main() -> None:
    """Console script."""
    sys.exit(run([Player, Keeper]))


if __name__ == "__main__":
    main()
