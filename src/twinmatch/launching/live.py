"""The twin beside a live rig: start and supervise the processes, and stop them with the heat off first."""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final

from diagnostic_msgs.msg import DiagnosticArray

from twinmatch.comparing import Verdict
from twinmatch.errors import EXIT_USER_ERROR
from twinmatch.launching.plan import LivePlan
from twinmatch.launching.processes import EXIT_NOT_RECORDED, LaunchError
from twinmatch.launching.results import RunResults
from twinmatch.launching.watch import Supervised, Watch
from twinmatch.nodes.health import PLANT_REPORT, Level
from twinmatch.nodes.network import lease
from twinmatch.nodes.signature import VARIABLE as SECRET
from twinmatch.nodes.signature import new_secret
from twinmatch.nodes.step import PATIENCE, VARIABLE, InStep
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.offline.summary import SessionSummary
from twinmatch.parameters.twin import read_settings
from twinmatch.printing import one_line
from twinmatch.sessions.files import EXIT_DISK
from twinmatch.showing.lines import Lines
from twinmatch.showing.page.health import MAX_NODES, kind_of
from twinmatch.showing.view import view_of
from twinmatch.signals import Sample
from twinmatch.twin import Door, TwinSettings
from twinmatch_msgs.msg import LoopSample

if TYPE_CHECKING:
    from twinmatch.showing.terminal import Screen

EXIT_LOST = 3
"""Exit code when a process that cannot be restarted was lost; the output is off then."""

READERS = "twin_simulator discriminator keeper live_watch"
"""Nodes that must receive every sample; the recorder too, if there is one."""

SPAN = 600.0
"""Time in which restarts, and errors that are shown, are counted, wall s."""


@dataclass
class Live:
    """A live run and its results."""

    MAX_WAITING: ClassVar = 100_000
    """Most samples that wait for verdicts; a discriminator that is so far behind is lost."""

    plan: LivePlan
    door: Door = field(default_factory=lambda: Door(TwinSettings()))
    """Settles the samples; before the first one it is replaced by one with the settings of the twin."""
    results: RunResults = field(default_factory=RunResults)
    received: int = 0
    """Number of samples, without stand-ins."""
    newest: Sample | None = None
    """The newest of them."""
    sessions: list[Path] = field(default_factory=list)
    """Folders recorded into; more than one if the recorder had to be restarted."""
    summary: SessionSummary | None = None
    ending: str = "stopped by the operator"

    def take_verdict(self, verdict: Verdict) -> None:
        """Count a verdict, and settle by it."""
        self.results.take_verdict(verdict)
        self.door.learn(verdict)

    def take_sample(self, sample: Sample) -> None:
        """Put a sample on the spool; an index at or before the newest one starts a new spool."""
        if self.newest is not None and not sample.continues(self.newest):
            self.results.restart_samples()
            self.received = 0
            self.door.forget()
        self.received += 1
        self.newest = sample
        self.door.push(sample)
        self.settle(lambda _: self.door.waiting > self.MAX_WAITING)

    def settle(self, judged: Callable[[int], bool]) -> None:
        """Put samples on the spool as the discriminator settled them: once it has `judged` all before them,
        as long as its verdicts may still decide how to."""
        self.results.take_settled(self.door.settled(judged))


def run_live(live: Live) -> int:
    """Run until the profile ends, Ctrl-C, or a loss; returns the exit code.

    Raises:
        TwinmatchError: a file or option cannot be used.
    """
    try:
        return _run_live(live)
    finally:
        live.results.close()


def _run_live(live: Live) -> int:
    if live.plan.virtual is None:
        live.plan.wiring.check(live.plan.port)
    settings = read_settings(live.plan.twin_config)
    if settings.plant.name != live.plan.plant:
        raise LaunchError(
            f"{live.plan.twin_config or 'the twin'} is for plant {settings.plant.name}, "
            f"but this run is of plant {live.plan.plant}; give another --twin-config"
        )
    live.door = Door(settings)
    view = view_of("live", settings.period)
    with lease(PATIENCE if live.plan.in_step else None):
        code = LiveRun(live, view).run()
    for session in filter(Path.exists, live.sessions):
        view.say(f"recorded: {session}")
    live.settle(lambda _: True)
    view.say(
        f"ended: {live.ending}; {live.received} samples, {live.results.tally.verdicts} verdicts"
    )
    live.summary = live.results.summary(settings)
    if live.summary is not None:
        for line in live.results.closing_lines(live.summary):
            view.say(line)
    return code


class Errors:
    """Errors on /diagnostics, each shown once while it stands, even if the figures in it change.

    Of a report that has several, only those are shown that no node has standing: a message that several
    nodes refuse is one error.
    """

    MAX_LINES: Final = 10
    """Most lines about a part of a node within `SPAN`; the page and /diagnostics show the others."""
    MAX_REPEATS: Final = 2
    """Most of these that say the same: one that comes and goes must not hide another."""
    MAX_TEXT: Final = 400
    """Longest error shown, characters."""

    def __init__(self, say: Callable[[str, str], None]) -> None:
        """Show lines, with their style, by `say`."""
        self._say = say
        self._standing: dict[str, frozenset[str]] = {}
        self._shown: dict[str, deque[tuple[float, str]]] = {}
        """Time and kind of the newest lines about each part."""

    def take(self, message: DiagnosticArray) -> None:
        """Take a message."""
        for status in message.status:
            if status.name.endswith(PLANT_REPORT):  # its verdicts are shown
                continue
            if int.from_bytes(status.level, "little") < Level.ERROR:
                if self._standing.pop(status.name, None) is not None:
                    self._show(status.name, "recovered", "green")
                continue
            if status.name not in self._standing and len(self._standing) >= MAX_NODES:
                continue
            texts = {
                kind_of(text): text
                for text in re.split("; (?=refused: )", status.message)
            }
            standing_kinds = frozenset[str]().union(*self._standing.values())
            self._standing[status.name] = frozenset(texts)
            new = [text for kind, text in texts.items() if kind not in standing_kinds]
            if new:
                self._show(status.name, "; ".join(new), "red")

    def _show(self, name: str, text: str, style: str) -> None:
        wall_now = time.monotonic()
        for part, lines in list(self._shown.items()):
            newest, _ = lines[-1]
            if wall_now - newest > SPAN:
                del self._shown[part]
        if name not in self._shown and len(self._shown) >= 2 * MAX_NODES:
            return
        shown = self._shown.setdefault(name, deque(maxlen=self.MAX_LINES))
        recent = [kind for shown_at, kind in shown if wall_now - shown_at < SPAN]
        kind = kind_of(text)[: self.MAX_TEXT]
        if len(recent) == self.MAX_LINES or recent.count(kind) >= self.MAX_REPEATS:
            return
        shown.append((wall_now, kind))
        text = text if len(text) <= self.MAX_TEXT else f"{text[: self.MAX_TEXT]}…"
        self._say(one_line(f"{name[: self.MAX_TEXT]}: {text}"), style)


_SOURCES: Final = {"rig": "profile", "virtual_rig": "virtual rig"}
"""Processes with which a run ends, and what has then ended."""


class LiveRun(Supervised):
    """The processes beside a live rig, and when they end."""

    DISCOVERY: Final = 2.0
    """Time after which no other graph is running that has not been discovered, s: that nobody is there is
    known no sooner."""
    LOOK: Final = 0.05
    """Interval between two looks for one, s."""
    SETTLE: Final = 180.0
    """Longest wait for the verdicts still due when the profile has ended, s."""
    VIRTUAL_RIG_START: Final = 90.0
    """Longest wait for the virtual rig, s; it may have to build firmware and board first."""
    RESTARTS: Final = 12
    """Most restarts of a process within `SPAN`: one that crashes on its input will do so again."""

    NAME = "live_watch"
    STOP_ORDER = ("rig", "sampler", "twin", "recorder", "plant_clock", "virtual_rig")
    """Heat off first; the recorder outlives what it records."""

    def __init__(self, live: Live, view: Screen | Lines) -> None:
        super().__init__(view)
        self.live = live
        self._plan = live.plan
        self._errors = Errors(view.say)
        self._addresses: dict[str, str] = {}
        self._secret = new_secret()
        self._ready = threading.Event()
        self._restarts: dict[str, list[float]] = {}
        self._over: tuple[int, str] | None = None
        self._over_at = 0.0

    def start(self, node: Watch) -> None:
        """Start everything; the rig last, after all subscribers."""
        plan = self._plan
        node.create_subscription(
            LoopSample, "plant/sample", self.live.take_sample, EVERYTHING
        )
        if plan.virtual is not None:
            self.view.say("starting the virtual rig")
            arguments = ["virtual-rig", *plan.virtual.arguments]
            self.processes.start_module("virtual_rig", "twinmatch.cli", *arguments)
        self._refuse_second_graph(node)
        if plan.virtual is not None:
            self.processes.wait_for_line(
                "virtual_rig", self._ready, self.VIRTUAL_RIG_START
            )
            if plan.simulated:
                self._start("plant_clock")
        self._start("twin")
        if plan.session is not None:
            self._start("recorder")
        self._start(plan.driver)
        if plan.in_step:
            node.beside.append(InStep(node, self._addresses["clock"]))

    def check(self, node: Watch) -> int | None:  # noqa: ARG002
        """Restart processes that may be restarted; over once one is lost, or all samples are judged."""
        live = self.live
        live.settle(
            lambda sample: self.settled.complete(sample, live.results.tally.verdicts)
        )
        self.view.advance(live.received)
        if self._over is None:
            self._over = self._lost()
            self._over_at = time.monotonic()
        if self._over is None:
            return None
        code, live.ending = self._over
        judged = live.newest is None or self.settled.complete(
            live.newest.index, live.results.tally.verdicts
        )
        return (
            None
            if code == 0
            and not judged
            and time.monotonic() - self._over_at < self.SETTLE
            else code
        )

    def take_verdict(self, verdict: Verdict) -> None:
        """Count and show it."""
        self.live.take_verdict(verdict)
        self.view.take_verdict(verdict)

    def take_health(self, message: DiagnosticArray) -> None:
        """Show errors."""
        super().take_health(message)
        self._errors.take(message)

    def show(self, line: str) -> None:
        """Note the virtual rig's addresses."""
        if line.startswith("[virtual_rig] ") and not self._ready.is_set():
            key, _, value = line.removeprefix("[virtual_rig] ").partition(": ")
            if key == "ready":
                self._ready.set()
            elif value:
                self._addresses[key] = value
        super().show(line)

    def _refuse_second_graph(self, node: Watch) -> None:
        """Refuse to run beside another controller on the same topics: both would drive the plate."""
        deadline = time.monotonic() + self.DISCOVERY
        while not node.count_publishers("plant/sample"):
            if time.monotonic() > deadline:
                return
            time.sleep(self.LOOK)
        raise LaunchError(
            f"live: {node.resolve_topic_name('plant/sample')} already has a publisher; end that "
            "graph first, or set another ROS_DOMAIN_ID or namespace for this one"
        )

    def _lost(self) -> tuple[int, str] | None:
        """Restart processes that may be restarted; returns exit code and reason when the run is over."""
        for name, code in self.processes.ended.items():
            ending = self._ending(name, code)
            if ending is not None:
                return ending
            if code == EXIT_DISK:
                self.processes.forget(name)
                text = "nothing is recorded any longer; the plant is driven on (--keep-driving)"
                self.view.say(text, "red")
                continue
            wall_now = time.monotonic()
            before = [
                restarted
                for restarted in self._restarts.get(name, [])
                if wall_now - restarted < SPAN
            ]
            if len(before) >= self.RESTARTS:
                reason = f"{name} was lost (code {code}) after {self.RESTARTS} restarts in {SPAN:g} s"
                return EXIT_LOST, reason
            self._restarts[name] = [*before, wall_now]
            self.view.say(f"{name} ended with code {code}; restarting it", "yellow")
            self._start(name)
        return None

    def _ending(self, name: str, code: int) -> tuple[int, str] | None:
        """Exit code and reason if the run is over with a process that has ended with a code."""
        if code == 0 and name in _SOURCES:
            return 0, f"the {_SOURCES[name]} has ended"
        if code == EXIT_USER_ERROR:
            return (
                2,
                f"{name} rejected its configuration or input; see its message above",
            )
        if code == EXIT_DISK and not self._plan.keep_driving:
            return (
                EXIT_NOT_RECORDED,
                f"{name} can no longer write the session; see its message above",
            )
        if name in _SOURCES:
            return EXIT_LOST, f"{name} was lost (code {code}); the output is off"
        return None

    def _start(self, name: str) -> None:
        plan = self._plan
        follows = plan.in_step and name != "plant_clock"
        self.processes.environment = (
            {VARIABLE: self._addresses["clock"]} if follows else {}
        )
        if name in (plan.driver, "twin"):
            # no other process can have a law put on trial
            self.processes.environment[SECRET] = self._secret
        if name == "recorder":
            self.live.sessions.append(self._next_session())
        program = plan.wiring.program if name == plan.driver else name
        self.processes.start_module(
            name, "twinmatch.nodes", program, *self._arguments(name)
        )

    def _arguments(self, name: str) -> list[str]:
        plan = self._plan
        if name == "plant_clock":
            return plan.clock_arguments(self._addresses)
        if name == "twin":
            return plan.twin_arguments()
        if name == "recorder":
            first, *later_sessions = self.live.sessions
            return plan.recorder_arguments(
                self.live.sessions[-1], first.name if later_sessions else ""
            )
        readers = (
            READERS
            if plan.session is None or plan.keep_driving
            else f"{READERS} recorder"
        )
        return [*plan.rig_arguments(self._addresses), *plan.wait_for(readers)]

    def _next_session(self) -> Path:
        first = self._plan.session or Path("session")
        number = len(self.live.sessions)
        return first if number == 0 else first.with_name(f"{first.name}_{number + 1}")
