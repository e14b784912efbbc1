"""The PWM board behind a serial port.

The board trips when it receives no command within its deadline (`Banner.deadline_ms`, one second), so the
user of a `PwmLink` repeats the current command several times per second, changed or not. This is intended: a
program that hangs or crashes stops doing so, and the output goes off.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import NoReturn

from twinmatch.links.pwm_errors import (
    PwmLatchedError,
    PwmLinkError,
    PwmPortLostError,
    PwmRangeError,
    PwmRejectedError,
    PwmResetError,
    PwmVersionError,
)
from twinmatch.links.pwm_exchange import Exchange
from twinmatch.links.pwm_messages import (
    PROTOCOL,
    PWM_LIMIT,
    Banner,
    Code,
    Flags,
    Refusal,
    Reply,
    Status,
    Verb,
)
from twinmatch.links.pwm_port import LinkSettings

__all__ = ["AMPERES_PER_COUNT", "Applied", "PwmLink"]

AMPERES_PER_COUNT = 5.0 / 1024 / 0.525
"""The converter has 1024 counts in 5 V; the driver gives 0.525 V for each ampere."""


@dataclass(frozen=True, slots=True)
class Applied:
    """The state of the output after a request."""

    pwm: int
    """Command on the pins, −255 to 255."""
    current: float
    """Magnitude of the driver's current, A, averaged over the PWM's on and off times."""
    flags: Flags
    device_time: float
    """Seconds on the board's own clock; it counts from its start and wraps after 49.7 days."""


class PwmLink:
    """Commands the PWM board at `port`, one request at a time; thread-safe.

    As a context manager it opens on entry, and sets zero and closes on exit. After opening, the board's
    output is off and latched: call `clear()` once, then `command()`.
    """

    def __init__(self, port: str, settings: LinkSettings | None = None) -> None:
        self.port = port
        self.settings = settings or LinkSettings()
        self.restarts = 0
        """Number of detected restarts of the board."""
        self._lock = threading.RLock()
        self._exchange: Exchange | None = None
        self.banner: Banner | None = None
        """The board's banner at the last opening."""
        self._known_restarts: int | None = None
        self._cleared = False

    def __enter__(self) -> PwmLink:
        """Open the port."""
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Set zero and close the port."""
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the port is held."""
        return self._exchange is not None and self._exchange.is_open

    def open(self) -> Banner:
        """Open the port exclusively and start a session with the board; its output goes to zero.

        Raises:
            PwmPortMissingError, PwmPortBusyError: the port cannot be opened.
            PwmVersionError: the board has another protocol version; the port is closed again.
            PwmLinkError: the board does not answer; the port is closed again.
        """
        with self._lock:
            self._drop()
            self._exchange = Exchange(self.port, self.settings)
            self._cleared = False
            try:
                banner = self._greet()
            except PwmLinkError:
                self._drop()
                raise
            if self._known_restarts not in (None, banner.restarts):
                self.restarts += 1
            self.banner, self._known_restarts = banner, banner.restarts
            return banner

    def reopen(
        self,
        patience: float = 10.0,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> Banner:
        """Open the port again, with retries for `patience` seconds and growing pauses.

        Raises:
            PwmVersionError: at once, since waiting does not help.
            PwmLinkError: the error of the last attempt.
        """
        start, pause = clock(), self.settings.first_pause
        while True:
            try:
                return self.open()
            except PwmVersionError:
                raise
            except PwmLinkError:
                if clock() - start + pause > patience:
                    raise
            sleep(pause)
            pause = min(2 * pause, self.settings.longest_pause)

    def command(self, pwm: float) -> Applied:
        """Set the output to `pwm`, −255 to 255, rounded to a whole number; positive heats.

        Raises:
            PwmRangeError: not finite or out of range; nothing was sent.
            PwmLatchedError: the board has tripped; clear() it once the cause is known.
            PwmResetError: the board restarted since it was cleared.
            PwmLinkError: any other failure of the link; see `pwm_errors`.
        """
        if not (math.isfinite(pwm) and abs(pwm) <= PWM_LIMIT):
            msg = f"PWM link: the command is {pwm}; give a number from -{PWM_LIMIT:g} to {PWM_LIMIT:g}"
            raise PwmRangeError(msg)
        with self._lock:
            reply = self._ask(Verb.SET, round(pwm))
            latched = isinstance(reply, Refusal) and reply.code is Code.LATCHED
            status = self._status(Verb.QUERY) if latched else self._expect_status(reply)
            if status.flags & Flags.TRIPPED:
                self._tripped(status.flags)
            return _applied(status)

    def query(self) -> Applied:
        """Query the state of the output; does not satisfy the board's deadline.

        Raises:
            PwmResetError: the board restarted since it was cleared.
            PwmLinkError: any other failure of the link; see `pwm_errors`.
        """
        with self._lock:
            status = self._status(Verb.QUERY)
            self._notice_reset(status.flags)
            return _applied(status)

    def clear(self) -> Applied:
        """Clear a trip of the board; its output is zero until the next command.

        Raises:
            PwmLinkError: the link failed; see `pwm_errors`.
        """
        with self._lock:
            status = self._status(Verb.CLEAR)
            self._cleared = True
            return _applied(status)

    def close(self) -> None:
        """Set the output to zero, if the board still answers, and release the port. Never raises."""
        with self._lock:
            if self.is_open:
                with contextlib.suppress(PwmLinkError):
                    self._ask(Verb.SET, 0)
            self._drop()

    def _greet(self) -> Banner:
        reply = self._ask(Verb.HELLO)
        if isinstance(reply, Refusal):
            raise self._refused(reply)
        if not isinstance(reply, Banner) or reply.protocol != PROTOCOL:
            msg = (
                f"PWM link: the board at {self.port} answers {reply}, which is not protocol version "
                f"{PROTOCOL}; load the firmware of this version"
            )
            raise PwmVersionError(msg)
        return reply

    def _status(self, verb: Verb) -> Status:
        return self._expect_status(self._ask(verb))

    def _expect_status(self, reply: Reply) -> Status:
        if not isinstance(reply, Status):
            raise self._refused(reply)
        return reply

    def _ask(self, verb: Verb, pwm: int = 0) -> Reply:
        if self._exchange is None:
            msg = f"PWM link: {self.port} is not open; open() or reopen() it"
            raise PwmPortLostError(msg)
        return self._exchange.ask(verb, pwm)

    def _refused(self, reply: Reply) -> PwmRejectedError:
        code = reply.code if isinstance(reply, Refusal) else Code.UNKNOWN
        what = f"PWM link: the board at {self.port} refused with {code.value}"
        return PwmRejectedError(f"{what}; do host and firmware match?", code)

    def _tripped(self, flags: Flags) -> NoReturn:
        self._notice_reset(flags)
        causes = {
            Flags.DEADLINE: "it received no command in time",
            Flags.DRIVER: "the motor driver reported a fault (short circuit, over-temperature, supply)",
            Flags.RESET: "it has just started",
        }
        cause = " and ".join(text for flag, text in causes.items() if flags & flag)
        msg = f"PWM link: the board at {self.port} is off because {cause}; find the cause, then clear() it"
        raise PwmLatchedError(msg, Code.LATCHED, flags)

    def _notice_reset(self, flags: Flags) -> None:
        if flags & Flags.RESET and self._cleared:
            self._cleared = False
            self._known_restarts = None  # this restart is counted
            self.restarts += 1
            msg = f"PWM link: the board at {self.port} restarted and is off; find the cause, then clear() it"
            raise PwmResetError(msg)

    def _drop(self) -> None:
        if self._exchange is not None:
            self._exchange.close()
        self._exchange = None


def _applied(status: Status) -> Applied:
    return Applied(status.applied, status.adc * AMPERES_PER_COUNT, status.flags, status.time_ms / 1000)
