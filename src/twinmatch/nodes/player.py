"""Plays a session: the plant's topics as they were recorded, byte for byte, and their clock.

`~/pause` (std_srvs/SetBool) pauses and continues; the parameter `rate` may be set at any time.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any, ClassVar

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from twinmatch.errors import TwinmatchError
from twinmatch.links import Background
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.node import Readers, TwinmatchNode
from twinmatch.nodes.topics import DEPTH, MessageTypeError, message_class, profile_of
from twinmatch.parameters.declared import READERS, Setting, Values
from twinmatch.printing import one_line
from twinmatch.sessions import Message, Qos, Topic, read_session


class Pace:
    """Maps recorded time onto the player's time; all times in seconds.

    The time is passed in and no clock is read, so it can be tested without waiting.
    """

    def __init__(self, rate: float, start: float) -> None:
        """Start paused at the first recorded time."""
        self.rate = rate
        """Recorded seconds per second; 0: as fast as possible."""
        self._recorded = start  # recorded time reached at `_since`
        self._since: float | None = None  # the caller's time then; None while paused

    @property
    def paused(self) -> bool:
        """Whether playback is paused; it is until the first `resume`."""
        return self._since is None

    def resume(self, now: float) -> None:
        """Continue from the current position."""
        if self._since is None:
            self._since = now

    def pause(self, now: float) -> None:
        """Pause at the current position."""
        self._recorded = self.position(now)
        self._since = None

    def change(self, rate: float, now: float) -> None:
        """Continue at another rate from the current position."""
        self._recorded = self.position(now)
        self._since = None if self._since is None else now
        self.rate = rate

    def reach(self, recorded: float, now: float) -> None:
        """Note that a message of this recorded time was played; at rate 0 this is the only progress."""
        if self.rate == 0:
            self._recorded = max(self._recorded, recorded)
            self._since = None if self._since is None else now

    def position(self, now: float) -> float:
        """Recorded time that has been reached."""
        if self._since is None:
            return self._recorded
        return self._recorded + (now - self._since) * self.rate

    def wait(self, recorded: float, now: float) -> float | None:
        """Seconds until a message of this recorded time is due; None while paused."""
        if self._since is None:
            return None
        if self.rate == 0:
            return 0.0
        return max(0.0, (recorded - self.position(now)) / self.rate)


BATCH = DEPTH // 4
"""At rate 0, messages after which the player waits until its readers have received all of them."""
TICK = 0.1
"""Longest wait before the clock is published again, s."""
_RATE = "Recorded seconds per second; 0: as fast as readers receive."
_TIMEOUT = "Longest wait for them, and for delivery at the end."
SAMPLE = "plant/sample"
FROM_TWIN = ("plant/description", "plant/estimate")
"""Plant topics that a twin publishes, and the player therefore does not."""


class PlayerError(TwinmatchError):
    """A session cannot be played here."""


class Player(TwinmatchNode):
    """Publishes the plant topics of a session and /clock, then ends.

    Topic names are relative: a recording from the namespace of one rig can be played in that of another.
    The recorded topics of a twin are not played; a running twin publishes its own.
    """

    NAME = "player"
    PARAMETERS: ClassVar = (
        Setting("session", "", "Folder or .mcap file of the session; required."),
        Setting("topic", "", "Topic of the samples, if the session has several rigs."),
        Setting("topics", ["plant/", "thermal/"], "Prefixes of the topics to play."),
        Setting("rate", 1.0, _RATE, "", 0.0, 1000.0, changeable=True),
        Setting("paused", False, "Start paused; the service ~/pause continues."),
        Setting("clock", True, "Publish /clock."),
        Setting(
            "wait_for",
            1,
            "Readers of plant/sample to wait for before the first message.",
            "",
            0,
            100,
        ),
        READERS,
        Setting("wait_timeout", 10.0, _TIMEOUT, "s", 0.1, 3600.0),
    )

    def __init__(self, context: Context | None = None) -> None:
        """Read the parameters."""
        super().__init__(context)
        self._change = threading.Condition()
        self._paused: bool = self.values["paused"]
        self._played = 0
        self._over = False
        self._thread = Background("player", self._run)
        self.beside.append(self._thread)

    def open(self) -> None:
        """Read the session and start to wait for readers."""
        if not self.values["session"]:
            raise PlayerError(
                "player: the session is missing; give --ros-args -p session:=path/to/session"
            )
        self._session = read_session(
            Path(self.values["session"]), self.values["topic"] or None
        )
        self._prefix = self._session.topic.removesuffix(SAMPLE)
        chosen = tuple(self.values["topics"])
        self._publishers_of = {}
        for topic in self._session.topics:
            name = self._relative(topic.name)
            if name.startswith(chosen) and name not in FROM_TWIN:
                self._publishers_of[topic.name] = self.create_publisher(
                    class_of(topic), name, playing_profile(topic.qos)
                )
        if self._session.topic not in self._publishers_of:
            missing = self._relative(self._session.topic)
            raise PlayerError(
                f"player: topics {self.values['topics']} leave out {missing}; add it"
            )
        self._clock_publisher = (
            self.create_publisher(Clock, "/clock", 10) if self.values["clock"] else None
        )
        self._pace = Pace(self.values["rate"], self._session.start / 1e9)
        self.create_service(SetBool, "~/pause", self._on_pause)
        for note in self._session.notes:
            self.get_logger().warning(one_line(note))
        self.health.say("waiting for readers")
        self.report_on()
        self._thread.start()

    def report(self) -> Report:
        """Position and rate of playback."""
        self.health.set("messages", self._played)
        self.health.set("ended", self._over)
        with self._change:
            self.health.set("rate", self._pace.rate)
            self.health.set("paused", self._paused)
            position = self._pace.position(time.monotonic()) - self._session.start / 1e9
        self.health.set(
            "position", f"{position:.1f} s of {self._session.duration:.1f} s"
        )
        return super().report()

    def close(self) -> bool:
        """Stop playing."""
        with self._change:
            self._thread.ending.set()
            self._change.notify_all()
        return super().close()

    def _relative(self, name: str) -> str:
        return name.removeprefix(self._prefix)

    def _on_pause(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
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
        if self._wait_for_readers() and self._play():
            self._finish()

    def _wait_for_readers(self) -> bool:
        timeout = self.values["wait_timeout"]
        number = self.values["wait_for"]
        readers = Readers(
            self, self._publishers_of[self._session.topic].topic_name, timeout, number
        )
        while lacking := readers.lacking:
            if readers.late:
                msg = f"player: {lacking} after {timeout:g} s; start them first, or lower wait_for"
                raise PlayerError(msg)
            if self._thread.ending.wait(0.02):
                return False
        self.health.say("paused" if self._paused else "playing")
        return True

    def _play(self) -> bool:
        """Publish everything; returns whether the end was reached."""
        for message in self._session.messages(self._publishers_of):
            if not self._wait_until_due(message.log_time):
                return False
            self._publish_clock(message.log_time)
            self._publish(message)
            if (
                self._pace.rate == 0
                and self._played % BATCH == 0
                and not self._wait_for_delivery()
            ):
                return False
        return True

    def _wait_until_due(self, log_time: int) -> bool:
        recorded = log_time / 1e9
        with self._change:
            while not self._thread.ending.is_set():
                wall_now = time.monotonic()
                if not self._paused:
                    self._pace.resume(wall_now)
                wait = self._pace.wait(recorded, wall_now)
                if wait == 0:
                    self._pace.reach(recorded, wall_now)
                    return True
                self._publish_clock(
                    min(log_time, round(self._pace.position(wall_now) * 1e9))
                )
                self._change.wait(TICK if wait is None else min(wait, TICK))
        return False

    def _publish(self, message: Message) -> None:
        self._publishers_of[message.topic.name].publish(message.data)
        self._played += 1

    def _publish_clock(self, recorded: int) -> None:
        if self._clock_publisher is not None:
            self._clock_publisher.publish(
                Clock(clock=Time(nanoseconds=recorded).to_msg())
            )

    def _wait_for_delivery(self, deadline: float | None = None) -> bool:
        """Wait until the readers have received what was published; returns whether they have.

        A reader has received a message once it is in its queue. That of our readers has no limit: a slow one
        takes its messages after the player has ended.
        """
        publishers = list(self._publishers_of.values())
        if deadline is not None and self._clock_publisher is not None:
            publishers.append(self._clock_publisher)
        for publisher in publishers:
            if publisher.qos_profile.reliability != ReliabilityPolicy.RELIABLE:
                continue
            while not publisher.wait_for_all_acked(Duration(seconds=0.5)):
                if self._thread.ending.is_set() or (
                    deadline is not None and time.monotonic() > deadline
                ):
                    return False
        return True

    def _finish(self) -> None:
        if self._wait_for_delivery(time.monotonic() + self.values["wait_timeout"]):
            self.health.say(f"ended: all {self._played} messages were delivered")
        else:
            self.health.flag(
                "end", Level.WARN, "ended: the last messages did not reach all readers"
            )
        self._over = True
        self.report_now()
        # the page shows this as the end
        self._diagnostics.wait_for_all_acked(Duration(seconds=1.0))
        self.exit_code = 0


def playing_profile(qos: Qos) -> QoSProfile:
    """The recorded quality of service, with a deeper queue, so that a reader may be slow for a while."""
    return profile_of(
        qos, qos.depth if qos.durability == "transient_local" else max(qos.depth, DEPTH)
    )


def class_of(topic: Topic) -> Any:
    """The class of a recorded topic's messages.

    Raises:
        PlayerError: the type is not installed.
    """
    try:
        return message_class(topic.type)
    except MessageTypeError as error:
        raise PlayerError(f"player: {topic.name}: {error}") from None
