"""Keeps a virtual plant in step with this process, when the plant runs faster than real time.

The process tells the virtual rig up to which plant time it may continue. The one that commands the plant lets
it continue to the next tick or repetition of a command, once the command before has been applied; others let
it continue for `LEAD`, once their queues are short. So load, or a process that was suspended, costs time and
nothing else, while one that has ended is not waited for: its connection is gone.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable
from typing import Final

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from twinmatch.emulation.clock import ClockClient, parse_address
from twinmatch.links import Background
from twinmatch.nodes.topics import NEWEST

VARIABLE: Final = "TWINMATCH_IN_STEP"
"""Environment variable with the HOST:PORT of the virtual rig's clock; the launch scripts set it."""
PATIENCE: Final = 45.0
"""Deadlines by the wall clock in a graph in step, s: more than the virtual rig waits for a process."""


class _Task:
    """What is called regularly in plant time; all times in ns."""

    def __init__(self, period: int, call: Callable[[], None]) -> None:
        self.due = 0
        self._period = period
        self._call = call

    def run_if_due(self, now: int) -> None:
        """Do it if it is due; what was missed is not made up for."""
        if now >= self.due:
            self.due = (
                now + self._period
                if self.due == 0
                else now - (now - self.due) % self._period + self._period
            )
            self._call()


class InStep(Background):
    """What this process has done, and the plant time up to which it lets the plant continue; thread-safe.

    All times are plant time in ns. `node` receives /clock.
    """

    LEAD: Final = 2_000_000_000
    """Plant time for which a process that commands nothing lets the plant continue, ns."""
    BREATH: Final = 5_000_000
    """Plant time that passes while the board is waited for, per wait, ns."""
    SOON: Final = 0.002
    """Interval at which unfinished work is checked again, wall s."""
    IDLE: Final = 0.2
    """Interval at which a process without unfinished work is checked again, wall s."""

    def __init__(self, node: Node, address: str) -> None:
        """Connect to the virtual rig at `address`.

        Raises:
            ClockError: the address is invalid.
        """
        super().__init__("in step", self._keep_step)
        self._client = ClockClient(parse_address(address), lambda _: None)
        self._lock = threading.Lock()
        self._news = threading.Event()  # since the last look
        self._now = 0
        self._tasks: list[_Task] = []
        self._driving = False  # whether this process commands the plant
        self._sent = 0  # time of the newest command
        self._applied: float = 0  # time up to which commands are applied
        self._until = 0  # time up to which the plant may continue
        self._busy = False  # whether tasks are running
        self._queues: list[Callable[[], bool]] = []  # whether too much is queued
        node.create_subscription(Clock, "/clock", self._on_clock, NEWEST)
        self._client.start()
        self.start()

    @property
    def now(self) -> int:
        """Plant time, ns; 0 before the first /clock."""
        return self._now

    def every(self, period: float, call: Callable[[], None]) -> None:
        """Call this every `period` s of plant time, in the thread of the executor.

        Not a timer of ROS: two that are due at the same time do not always both fire while /clock stands.
        """
        self._tasks.append(_Task(round(period * 1e9), call))

    def drive(self) -> None:
        """From now on the plant waits for each call of `every`, and for the commands that are sent in it."""
        self._driving = True

    def sent(self, stamp: int) -> None:
        """Note that a command of this time was sent to the node that applies it."""
        self._sent = max(self._sent, stamp)

    def applied(self, stamp: float) -> None:
        """Note that commands up to this time are applied, or cannot be."""
        if stamp != self._applied:
            with self._lock:
                self._applied = stamp
            self._news.set()

    def image(self, stamp: int) -> None:
        """Note that the image of this time was taken."""
        self._client.say("image", stamp)

    def wait_for(self, queued: Callable[[], bool]) -> None:
        """Let the plant wait whenever this returns True: too much is queued."""
        self._queues.append(queued)

    def breathe(self) -> float | None:
        """Let a moment of plant time pass for the board to answer; returns the time, s (None: at the end)."""
        if self.ending.is_set():
            return None
        self._let(self._now + self.BREATH, "breathe")
        return self._now / 1e9

    def close(self, timeout: float | None = None) -> bool:
        """End the connection, so that the plant no longer waits; returns whether its threads ended."""
        self.ending.set()
        self._news.set()
        ended = super().close(timeout)
        return self._client.close() and ended

    def _on_clock(self, message: Clock) -> None:
        plant_now = message.clock.sec * 1_000_000_000 + message.clock.nanosec
        with self._lock:
            if plant_now < self._now:
                # the plant was restarted, or the time before was not its own
                self._until = self._sent = 0
                for task in self._tasks:
                    task.due = 0
            self._busy = True
            self._now = plant_now
        for task in self._tasks:
            task.run_if_due(plant_now)
        with self._lock:
            self._busy = False
        if self._driving or plant_now + self.LEAD - self._until >= self.LEAD // 2:
            self._news.set()

    def _keep_step(self) -> None:
        while not self.ending.is_set():
            self._news.clear()
            settled = self._let_if_done()
            if not self.ending.is_set():
                # it may have been set before the news were cleared
                self._news.wait(self.IDLE if settled else self.SOON)

    def _let_if_done(self) -> bool:
        """Let the plant continue if all work is done; returns whether it is."""
        if not self._now:
            return True  # not even the clock has been received
        with self._lock:
            if self._busy or (self._driving and self._applied < self._sent):
                return False
            until = (
                min(task.due for task in self._tasks)
                if self._driving
                else self._now + self.LEAD
            )
        if any(queued() for queued in self._queues):
            return False
        if self._driving or until - self._until >= self.LEAD // 2:
            self._let(until, "drive")
        return True

    def _let(self, until: int, word_if_driving: str) -> None:
        """Let the plant continue to a time; a process that commands nothing always says `follow`."""
        with self._lock:
            if until > self._until:
                self._until = until
                self._client.say(word_if_driving if self._driving else "follow", until)


FOREVER: Final = math.inf
"""For `applied`, where there is nobody to apply a command."""


def step_of(node: Node) -> InStep | None:
    """The step of this process, if it runs in step; `node` receives /clock.

    Raises:
        ClockError: the address in the environment is invalid.
    """
    address = os.environ.get(VARIABLE)
    return InStep(node, address) if address else None
