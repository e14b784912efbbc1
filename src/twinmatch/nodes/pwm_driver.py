"""The one thread that talks to the PWM board.

Several times a second it sends the command that the gate passes, which keeps the board's watchdog satisfied.
When the gate closes, it sends zero once and then only queries: after its deadline the board switches the
output off by itself. However the thread ends, its last command is zero.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from twinmatch.links.pwm_link import (
    Applied,
    PwmLatchedError,
    PwmLink,
    PwmLinkError,
    PwmResetError,
    PwmVersionError,
)
from twinmatch.links.pwm_protocol import Banner, Flags
from twinmatch.nodes.driver_thread import DriverThread
from twinmatch.nodes.node import Health, Level
from twinmatch.nodes.output_gate import Decision, OutputGate
from twinmatch.safety import FaultKind

__all__ = ["DriverSettings", "PwmDriver"]

Tell = Callable[[Applied | None, int], None]

IDLE = 0.25
"""Interval between two queries to a board that is not driven, wall s."""


@dataclass(frozen=True)
class DriverSettings:
    """Pace of the thread."""

    repeat: float = 0.1
    """Interval at which a command is repeated, s of the plant's clock."""
    poll: float = 0.025
    """Longest sleep between two readings of that clock, wall s."""
    first_pause: float = 0.1
    """Pause before the first attempt to reopen a lost port, s; doubled after each attempt."""
    longest_pause: float = 2.0
    """Longest such pause, s."""


class PwmDriver(DriverThread):
    """Sends to the board what the gate passes, and nothing else."""

    NAME = "pwm driver"
    CLOSING = 3.0

    def __init__(
        self,
        link: PwmLink,
        gate: OutputGate,
        tell: Tell,
        health: Health,
        settings: DriverSettings | None = None,
    ) -> None:
        """`tell` is called with each report of the board (None: unknown) and the sample it belongs to."""
        self._settings = settings or DriverSettings()
        super().__init__(gate, self._settings.first_pause, self._settings.longest_pause)
        self.connected = False
        self._link = link
        self._tell = tell
        self._health = health
        self._known = False  # whether the board has been cleared before
        self._driving = False  # whether the last command had passed the gate
        self._sent = 0.0
        self._sent_at = 0.0
        self._asked_at = 0.0

    def _turn(self) -> None:
        try:
            if not self._link.is_open:
                self._connect()
            self._serve()
        except PwmVersionError:
            raise  # waiting does not help
        except PwmLatchedError as error:
            self._driving = False
            kind = FaultKind.DRIVER if error.flags & Flags.DRIVER else FaultKind.BOARD
            self._gate.trip(kind, str(error))
        except PwmResetError as error:
            self._driving = False
            self._gate.trip(FaultKind.BOARD, str(error))
        except PwmLinkError as error:
            self._lost(error)

    def _connect(self) -> None:
        banner = self._link.open()
        self._check_pace(banner)
        flags = self._link.query().flags
        if flags & Flags.DRIVER:
            self._gate.trip(
                FaultKind.DRIVER, "the board has tripped because the motor driver reported a fault"
            )
        elif not self._known:
            self._link.clear()
        elif flags & Flags.RESET:
            self._gate.trip(FaultKind.BOARD, "the PWM board restarted; find the cause")
        self._known = self.connected = True
        self._attempts = 0
        self._health.count("connections")
        self._health.set("firmware", banner.firmware)
        self._health.withdraw("link")

    def _check_pace(self, banner: Banner) -> None:
        deadline, link = banner.deadline_ms / 1000, self._link.settings
        self._health.set("board deadline", f"{deadline:g} s")
        longest = link.timeout * (link.retries + 1) + self._settings.repeat
        if longest >= deadline:
            message = (
                f"an answer may take {longest:g} s, but the board's deadline is {deadline:g} s; "
                "lower timeout, retries or repeat"
            )
            self._health.flag("pace", Level.WARN, message)

    def _serve(self) -> None:
        if self._clear_wanted.is_set():
            self._link.clear()
            self._clear_wanted.clear()
        decision = self._gate.decide()
        if decision.armed:
            due = decision.time - self._sent_at >= self._settings.repeat
            if due or not self._driving or decision.input != self._sent:
                self._drive(decision)
                return
        elif self._driving:
            self._driving = False
            self._tell(self._link.command(0.0), decision.sample)
            return
        elif time.monotonic() - self._asked_at >= IDLE:
            self._asked_at = time.monotonic()
            self._tell(self._link.query(), decision.sample)
            return
        self._gate.wait(self._settings.poll)

    def _drive(self, decision: Decision) -> None:
        if not self._driving:
            self._wake()
            decision = self._gate.decide()  # clearing takes time, in which the gate may have closed
            if not decision.armed:
                return
        self._driving = True
        self._sent, self._sent_at = decision.input, decision.time
        applied = self._link.command(decision.input)
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
        flags = self._link.query().flags
        if flags & (Flags.DRIVER | Flags.RESET):
            self._link.command(0.0)  # refused, with the reason
        elif flags & Flags.TRIPPED:
            self._link.clear()

    def _lost(self, error: PwmLinkError) -> None:
        if self._driving:
            self._gate.trip(FaultKind.LINK, str(error))
        self._driving = self.connected = False
        self._health.count(type(error).__name__)
        self._health.flag("link", Level.ERROR, str(error))
        self._link.close()
        self._tell(None, 0)
        self._pause()

    def _release(self) -> None:
        self.connected = False
        if self._link.is_open:
            with contextlib.suppress(Exception):  # the port must be released whatever happens
                self._tell(self._link.command(0.0), 0)
        self._link.close()
