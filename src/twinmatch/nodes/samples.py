"""Base classes of the twin's nodes: the stream of samples, its health, the worker behind it."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Final

from rclpy.publisher import Publisher

from twinmatch.links import Background
from twinmatch.nodes.health import Level, NodeHealth, Report
from twinmatch.nodes.node import TwinmatchNode, Worker
from twinmatch.nodes.past import CatchingUp, Stream
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.parameters.declared import Setting
from twinmatch.parameters.twin import settings_from, understood
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings
from twinmatch_msgs.msg import LoopSample
from twinmatch_msgs.srv import Past


class SampleWatch:
    """Checks the samples' indices and arrival, and reports gaps and silence."""

    def __init__(
        self, health: NodeHealth, period: float, patience: int = 5, remember: int = 60
    ) -> None:
        """Report silence after `patience` periods (s each), and a gap for `remember` samples."""
        self._health = health
        self._silence = patience * period
        self._remember = remember
        self.last: int | None = None
        """Index of the newest sample."""
        self._arrived = 0.0
        self._since_gap = 0
        health.say("waiting for samples")

    def push(self, index: int, now: float) -> None:
        """Check a sample that arrived at `now` (s)."""
        if self.last is None:
            self._health.say("working")
        elif index != self.last + 1:
            between = f"samples {self.last + 1} to {index - 1} are missing"
            message = (
                between
                if index > self.last
                else f"sample {index} came after sample {self.last}"
            )
            self._health.count("gaps")
            self._health.flag(
                "gap", Level.ERROR, f"{message}; behind a long gap windows start over"
            )
            self._since_gap = 0
        self._since_gap += 1
        if self._since_gap > self._remember:
            self._health.withdraw("gap")
        self.last = index
        self._arrived = now
        self._health.set("sample", index)

    def check(self, now: float) -> None:
        """Report silence if no sample has arrived for too long; withdraw it once they arrive again."""
        silent = now - self._arrived
        down = self.last is not None and silent > self._silence
        self._health.flag_if(
            down, "silence", Level.WARN, f"no sample for {silent:.0f} s"
        )


class Standstill(Background):
    """Detects a suspension of the process from gaps in its own heartbeat, and lets publishing wait after it.

    DDS forgets a participant that has sent nothing for its lease, 5 s here. A process that was suspended
    longer (SIGSTOP, a swap storm) continues where it was, but its first messages reach no reader, because
    readers have to discover it again. A verdict that was being computed at that moment would be lost.
    """

    BEAT = 0.25
    """Period of the heartbeat, wall s."""
    LONG = 4.0
    """Time without a heartbeat after which others may have dropped this process, wall s: below the lease."""
    REDISCOVERY = 2.0
    """Time until all others have rediscovered it, wall s: it announces itself every 0.5 s."""

    def __init__(self) -> None:
        """The heartbeat has its own thread, from `start` to `close`."""
        super().__init__("standstill", self._watch)
        self._lock = threading.Lock()
        self._last: float | None = None
        self._until = 0.0

    def beat(self, now: float) -> None:
        """Take a heartbeat at `now`, in s of a clock that continues while the process is suspended."""
        with self._lock:
            if self._last is not None and now - self._last > self.LONG:
                self._until = now + self.REDISCOVERY
            self._last = now

    def remaining(self, now: float) -> float:
        """Time to wait before publishing, s. The call counts as a heartbeat: it may be the first since."""
        self.beat(now)
        return max(0.0, self._until - now)

    def wait(self) -> None:
        """Wait until readers are connected again; returns at once unless the process was suspended."""
        while (
            not self.ending.is_set()
            and (delay := self.remaining(time.monotonic())) > 0.0
        ):
            self.ending.wait(delay)

    def _watch(self) -> None:
        self.beat(time.monotonic())
        while not self.ending.wait(self.BEAT):
            self.beat(time.monotonic())


class TwinNode(TwinmatchNode):
    """A node of the twin: its settings, and a worker for long computations."""

    AHEAD: Final = 5
    """Queued messages above which a virtual plant in step waits."""

    FIXED = "a replay must give the recorded verdicts"

    @classmethod
    def table_for(
        cls, overrides: Mapping[str, Any]
    ) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The parameters of the selected plant and structure."""
        return understood(cls.NAME, overrides)

    def read_parameters(self) -> None:
        """Create the settings of the twin."""
        self.settings: TwinSettings = settings_from(self.values)
        self.entrance.plant = self.settings.plant

    def open(self) -> None:
        """Start the worker."""
        self._standstill = Standstill()
        self._standstill.start()
        self.worker: Worker[Any] = Worker(self.work, self.health)
        self.beside += [self._standstill, self.worker]  # a wait for readers ends first
        if self.step is not None:
            self.step.wait_for(lambda: self.worker.depth > self.AHEAD)
        self.report_on()

    @abstractmethod
    def work(self, received: Any) -> None:
        """Work on one message that was received and queued; called in the worker's thread."""

    def put(self, received: Any) -> None:
        """Queue a received message for the worker."""
        self.worker.put(received)

    def publish(self, publisher: Publisher, message: Any) -> None:
        """Publish from the worker's thread; after a suspension, once the readers are connected again."""
        self._standstill.wait()
        publisher.publish(message)

    def report(self) -> Report:
        """The queue."""
        self.worker.watch()
        return super().report()


class SampleNode(TwinNode):
    """A node that processes every sample in its worker.

    After a late start, a restart or a pause it fetches what it missed, and reaches the same state as if it
    had run all the time. `learn` receives the results that the node's predecessor published.
    """

    MAX_QUEUED: Final = 100_000
    """Most samples in memory; those that arrive meanwhile are fetched from the keeper later."""
    SETTLE: Final = 1.0
    """Time in which readers discover a new node, wall s; they may miss what it publishes earlier."""
    MAX_SETTLE: Final = 3.0
    """Longest wait for readers that are known but not connected, wall s."""

    def read_parameters(self) -> None:
        """Create the settings, and the check of the samples."""
        super().read_parameters()
        self._watch = SampleWatch(self.health, self.settings.period)

    def open(self) -> None:
        """Start the worker and subscribe to `plant/sample`."""
        super().open()
        self._stream = Stream(self._on_next, self.learn)
        self._connected = False
        self._catching_up = CatchingUp(
            self,
            self._stream,
            ready=self._has_readers,
            waiting=lambda: self.worker.depth,
        )
        self.create_subscription(
            LoopSample, "plant/sample", self._on_sample, EVERYTHING
        )

    def learn(self, answer: Past.Response) -> None:
        """Take results published before this node started; called before the samples they are about."""

    def report(self) -> Report:
        """Queue, gaps, silence."""
        self._watch.check(time.monotonic())
        return super().report()

    def _has_readers(self, age: float) -> bool:
        """Whether the readers of this node are connected; results for fetched samples follow at once."""
        if not self._connected:
            self._connected = age > self.MAX_SETTLE or (
                age > self.SETTLE and self._all_connected()
            )
        return self._connected

    def _all_connected(self) -> bool:
        return all(
            publisher.get_subscription_count()
            >= self.count_subscribers(publisher.topic_name)
            for publisher in self.publishers
        )

    def _on_sample(self, sample: Sample) -> None:
        if self.worker.depth + self._stream.waiting > self.MAX_QUEUED:
            self.health.count("samples left to be fetched")
            return
        self._stream.push(sample)
        if self._stream.missing is not None:
            self._catching_up.request()

    def _on_next(self, sample: Sample) -> None:
        self._watch.push(sample.index, time.monotonic())
        self.put(sample)
