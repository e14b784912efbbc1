"""The node of a launch script: it starts the other processes, receives what they publish, ends with them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

from diagnostic_msgs.msg import DiagnosticArray

from twinmatch.comparing import Verdict
from twinmatch.ending import end_in_order
from twinmatch.launching.processes import Processes
from twinmatch.nodes.discriminator import SETTLED, VERDICTS, DiscriminatorNode
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.runner import run
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.showing.lines import Lines
from twinmatch.twin import MatchReport
from twinmatch_msgs.msg import Match, ModelScore

if TYPE_CHECKING:
    from twinmatch.showing.terminal import Screen


class Settled:
    """Follows the discriminator's reports on /diagnostics: up to which sample everything is judged."""

    def __init__(self) -> None:
        """Start without a report."""
        self._sample: int | None = None
        self._verdicts = 0

    def take(self, message: DiagnosticArray) -> None:
        """Take a message; reports of other nodes are ignored."""
        for status in message.status:
            if status.name.endswith(f"{DiscriminatorNode.NAME}: health"):
                values = {entry.key: entry.value for entry in status.values}
                self._sample = _count(values.get(SETTLED, ""))
                self._verdicts = _count(values.get(VERDICTS, "")) or 0

    def complete(self, last: int, received: int) -> bool:
        """Whether all is judged up to sample `last`, and `received` verdicts are all that were published."""
        return (
            self._sample is not None
            and self._sample >= last
            and received >= self._verdicts
        )


def _count(text: str) -> int | None:
    """A count as a node reports it; None for any other text."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 19 else None


class Supervised(ABC):
    """The processes of a launch script, and what becomes of what they publish."""

    NAME: ClassVar[str]
    """Name of the node of this process."""
    STOP_ORDER: ClassVar[tuple[str, ...]]
    """Order in which the processes are ended."""

    def __init__(self, view: Screen | Lines) -> None:
        """Start without processes; `view` shows verdicts, and what the processes print."""
        self.view = view
        self.settled = Settled()
        self.processes = Processes(self.show)

    def run(self) -> int:
        """Run until it is over or a signal ends it; returns the exit code."""
        try:
            return run(
                [type("Watch", (Watch,), {"NAME": self.NAME, "supervised": self})],
                [self.NAME],
            )
        finally:
            self.view.close()

    @abstractmethod
    def start(self, node: Watch) -> None:
        """Start the processes; `node` has subscribed to what they will publish."""

    @abstractmethod
    def check(self, node: Watch) -> int | None:
        """Called every `Watch.POLL` seconds; returns the exit code once the run is over."""

    @abstractmethod
    def take_verdict(self, verdict: Verdict) -> None:
        """Take a verdict."""

    def take_match(self, report: MatchReport) -> None:
        """Take a match."""
        self.view.take_match(report)

    def take_health(self, message: DiagnosticArray) -> None:
        """Take a message of /diagnostics."""
        self.settled.take(message)

    def show(self, line: str) -> None:
        """Show a line that a process has printed."""
        self.view.say(line)


class Watch(TwinmatchNode):
    """Starts the processes of `supervised`, passes on what they publish, and ends them."""

    CLOSING: ClassVar = 90
    POLL: ClassVar = 0.1
    """Interval at which the processes are looked at, s."""
    supervised: ClassVar[Supervised]

    def open(self) -> None:
        """Subscribe, then start the processes."""
        run = self.supervised
        for kind, topic, take in (
            (ModelScore, "twin/model_score", run.take_verdict),
            (Match, "twin/match", run.take_match),
        ):
            self.create_subscription(kind, topic, take, EVERYTHING)
        self.create_subscription(DiagnosticArray, "/diagnostics", run.take_health, 100)
        self.report_on()
        run.start(self)
        run.view.open()
        self.create_timer(self.POLL, self._check)

    def close(self) -> bool:
        """End the processes."""
        return end_in_order(
            self.supervised.view.close, super().close, self._end_processes
        )

    def _end_processes(self) -> None:
        run = self.supervised
        for name in run.processes.stop(run.STOP_ORDER):
            run.view.say(f"{name} did not end in time and was killed")

    def _check(self) -> None:
        if self.exit_code is None:
            self.exit_code = self.supervised.check(self)
