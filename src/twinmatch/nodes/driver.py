"""Threads with exclusive access to the hardware that drives a plant.

However such a thread ends, its last command is zero. If it cannot send it, the board does so by itself after
its deadline, and for a kit the process that holds its port.
"""

from __future__ import annotations

import contextlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from twinmatch.errors import TwinmatchError
from twinmatch.links.kit_link import KitAbsentError, KitError, KitLink, KitSilentError
from twinmatch.links.pwm_link import (
    PwmLatchedError,
    PwmLink,
    PwmLinkError,
    PwmResetError,
    PwmVersionError,
)
from twinmatch.links.pwm_protocol import Banner, Flags
from twinmatch.nodes.node import Level, NodeHealth
from twinmatch.nodes.output_gate import Decision, OutputGate
from twinmatch.nodes.step import FOREVER, InStep
from twinmatch.safety import FaultKind

IDLE = 0.25
"""Interval between two queries to a board that is not driven, wall s."""
LONGEST = 0.3
"""Longest time between two commands to a kit, wall s: well within the deadline of the process at its port."""

Link = TypeVar("Link", PwmLink, KitLink)
Tell = Callable[[Any, int], None]
"""Called with each report of the hardware (None: unknown) and the sample whose command it applies."""


@dataclass(frozen=True)
class DriverPace:
    """Pace of a driver's thread."""

    repeat: float = 0.1
    """Interval at which a command is repeated, s of the plant's clock."""
    poll: float = 0.025
    """Longest sleep between two readings of that clock, wall s."""
    first_pause: float = 0.1
    """Pause before the first attempt to restore a lost link, s; doubled after each attempt."""
    longest_pause: float = 2.0
    """Longest such pause, s."""


class DriverThread(ABC, Generic[Link]):
    """Applies what the gate passes, and nothing else, until it is closed or fails; then releases the link."""

    NAME: ClassVar[str]
    CLOSING: ClassVar[float]
    """Default time in which the thread has to end, s."""
    ERRORS: ClassVar[type[TwinmatchError]]
    """Errors of the link."""

    connected = False
    """Whether the hardware answered last."""
    step: InStep | None = None
    """Told which commands are applied, if the plant waits for them."""

    def __init__(
        self, link: Link, gate: OutputGate, tell: Tell, health: NodeHealth, pace: DriverPace | None = None
    ) -> None:
        """`tell` is called in the thread, which `start` starts."""
        self.failure: Exception | None = None
        """The error that ended the thread, if any."""
        self.link: Link = link
        self._gate, self._tell, self._health, self._pace = gate, tell, health, pace or DriverPace()
        self._ending, self._clear_wanted = threading.Event(), threading.Event()
        self._known = False  # whether the hardware has answered before
        self._driving = False  # whether the last command had passed the gate
        self._sent_at = 0.0
        self._attempts = 0
        self._thread = threading.Thread(target=self._run, name=self.NAME, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def clear(self) -> None:
        """Clear the fault latched by the hardware, before anything else is sent."""
        self._clear_wanted.set()

    def close(self, timeout: float | None = None) -> bool:
        """Set zero, release the port, end the thread; whether it ended within the timeout (s; CLOSING)."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join(self.CLOSING if timeout is None else timeout)
        return not self._thread.is_alive()

    @abstractmethod
    def _connect(self) -> None:
        """Open the link."""

    @abstractmethod
    def _serve(self, decision: Decision) -> None:
        """Apply a decision of the gate, or wait for the next one."""

    @abstractmethod
    def _zero(self) -> None:
        """Set zero."""

    @abstractmethod
    def _refusal(self, error: Any) -> FaultKind | None:
        """The fault of hardware that is there but refuses; None if the link is lost.

        Raises:
            TwinmatchError: the error itself, if waiting does not help.
        """

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                commanded = self._gate.commanded
                self._turn()
                if self.step is not None:
                    self.step.applied(commanded if self.connected else FOREVER)
        except Exception as error:  # handed to the main thread, which ends the process with it
            self.failure = error
        finally:
            self.connected = False
            if self.link.is_open:
                with contextlib.suppress(Exception):  # the port must be released whatever happens
                    self._zero()
            self.link.close()

    def _turn(self) -> None:
        try:
            if not self.link.is_open:
                self._connect()
                self._known, self._attempts = True, 0
                self._health.count("connections")
                self._health.withdraw("link")
            if self._clear_wanted.is_set():
                self.link.clear()
                self._clear_wanted.clear()
            self._serve(self._gate.decide())
        except self.ERRORS as error:
            kind = self._refusal(error)
            if kind is None:
                self._lost(error)
            else:
                self._driving = False
                self._gate.trip(kind, str(error))

    def _lost(self, error: TwinmatchError) -> None:
        """Close a lost link, and wait before the next attempt to restore it."""
        if self._driving:
            self._gate.trip(FaultKind.LINK, str(error))
        self._driving = self.connected = False
        self._health.count(type(error).__name__)
        self._health.flag("link", Level.ERROR, str(error))
        self.link.close()
        self._tell(None, 0)
        pause = self._pace.first_pause * 2.0 ** min(self._attempts, 30)
        self._ending.wait(min(pause, self._pace.longest_pause))
        self._attempts += 1


class PwmDriver(DriverThread[PwmLink]):
    """The one thread that talks to the PWM board.

    Several times a second it sends the command that the gate passes, which keeps the board's watchdog
    satisfied. When the gate closes, it sends zero once and then only queries: after its deadline the board
    switches the output off by itself.
    """

    NAME = "pwm driver"
    CLOSING = 3.0
    ERRORS = PwmLinkError

    _sent = 0.0
    _asked_at = 0.0

    def _refusal(self, error: PwmLinkError) -> FaultKind | None:
        if isinstance(error, PwmVersionError):
            raise error
        if isinstance(error, PwmLatchedError) and error.flags & Flags.DRIVER:
            return FaultKind.DRIVER
        return FaultKind.BOARD if isinstance(error, PwmLatchedError | PwmResetError) else None

    def _connect(self) -> None:
        banner = self.link.open()
        self._check_pace(banner)
        flags = self.link.query().flags
        if flags & Flags.DRIVER:
            tripped = "the board has tripped because the motor driver reported a fault"
            self._gate.trip(FaultKind.DRIVER, tripped)
        elif not self._known:
            self.link.clear()
        elif flags & Flags.RESET:
            self._gate.trip(FaultKind.BOARD, "the PWM board restarted; find the cause")
        self.connected = True
        self._health.set("firmware", banner.firmware)

    def _zero(self) -> None:
        self._tell(self.link.command(0.0), 0)

    def _check_pace(self, banner: Banner) -> None:
        deadline, link = banner.deadline_ms / 1000, self.link.settings
        self._health.set("board deadline", f"{deadline:g} s")
        longest = link.timeout * (link.retries + 1) + self._pace.repeat
        if longest >= deadline:
            message = (
                f"an answer may take {longest:g} s, but the board's deadline is {deadline:g} s; "
                "lower timeout, retries or repeat"
            )
            self._health.flag("pace", Level.WARN, message)

    def _serve(self, decision: Decision) -> None:
        if decision.armed:
            due = decision.time - self._sent_at >= self._pace.repeat
            if due or not self._driving or decision.input != self._sent:
                self._drive(decision)
                return
        elif self._driving:
            self._driving = False
            self._tell(self.link.command(0.0), decision.sample)
            return
        elif time.monotonic() - self._asked_at >= IDLE:
            self._asked_at = time.monotonic()
            self._tell(self.link.query(), decision.sample)
            return
        self._gate.wait(self._pace.poll)

    def _drive(self, decision: Decision) -> None:
        if not self._driving:
            self._wake()
            decision = self._gate.decide()  # clearing takes time, in which the gate may have closed
            if not decision.armed:
                return
        self._driving = True
        self._sent, self._sent_at = decision.input, decision.time
        applied = self.link.command(decision.input)
        self._tell(applied, decision.sample)
        if applied.pwm != round(decision.input):
            message = (
                f"the board applies {applied.pwm}, but {round(decision.input)} was sent; is another program "
                "using it?"
            )
            self._gate.trip(FaultKind.BOARD, message)

    def _wake(self) -> None:
        """Clear a board that tripped on its deadline, which was intended; nothing else.

        Raises:
            PwmLatchedError: the board tripped for another reason.
        """
        flags = self.link.query().flags
        if flags & (Flags.DRIVER | Flags.RESET):
            self.link.command(0.0)  # refused, with the reason
        elif flags & Flags.TRIPPED:
            self.link.clear()


class KitDriver(DriverThread[KitLink]):
    """The one thread that talks to a Temperature Control Lab.

    Several times a second it sets the command that the gate passes, or zero, and forwards the kit's readings.
    """

    NAME = "kit driver"
    CLOSING = 5.0
    ERRORS = KitError

    other = 0.0
    """Power of the second heater while commands pass, %."""
    _sent = (0.0, 0.0)
    _said_at = 0.0

    def _refusal(self, error: KitError) -> FaultKind | None:
        if isinstance(error, KitAbsentError) and not self._known:
            raise error  # a kit that was never there is not waited for
        return FaultKind.BOARD if isinstance(error, KitSilentError) else None

    def _connect(self) -> None:
        self.link.open()
        self._health.set("port", self.link.port)
        self._health.set("firmware", self.link.firmware)

    def _zero(self) -> None:
        self._tell(self.link.drive(0.0, 0.0), 0)

    def _serve(self, decision: Decision) -> None:
        wanted = (decision.input, self.other) if decision.armed else (0.0, 0.0)
        # By the wall clock too: a slow or stopped plant clock must not look like the end of this process.
        due = decision.time - self._sent_at >= self._pace.repeat or not self.connected
        if due or wanted != self._sent or time.monotonic() - self._said_at >= LONGEST:
            reading = self.link.drive(*wanted)
            self._sent, self._sent_at, self._said_at = wanted, decision.time, time.monotonic()
            self._driving, self.connected = wanted != (0.0, 0.0), True
            self._tell(reading, decision.sample)
        self._gate.wait(self._pace.poll)
