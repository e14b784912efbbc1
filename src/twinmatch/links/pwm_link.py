"""The PWM board behind a serial port.

The board trips when it receives no command within its deadline (`Banner.deadline_ms`, one second), so the
user of a `PwmLink` repeats the current command several times per second, changed or not. This is intended: a
program that hangs or crashes stops doing so, and the output goes off. Every command is absolute, so it is
safe to send it again after any error.
"""

from __future__ import annotations

import contextlib
import errno
import math
import secrets
import termios
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NoReturn

import serial

from twinmatch.errors import TwinmatchError
from twinmatch.links.pwm_protocol import (
    PROTOCOL,
    PWM_LIMIT,
    SEQUENCES,
    Banner,
    BoardStatus,
    Code,
    Conversation,
    Flags,
    Refusal,
    Reply,
    Verb,
)
from twinmatch.settings import setting


class PwmLinkError(TwinmatchError):
    """A command could not be delivered; the state of the output is unknown."""


class PwmRangeError(PwmLinkError):
    """A command or a setting is out of range; nothing was sent."""


class PwmPortMissingError(PwmLinkError):
    """No such port, or no permission: is the board plugged in?"""


class PwmPortBusyError(PwmLinkError):
    """The serial port is held by another program."""


class PwmPortLostError(PwmLinkError, ConnectionError):
    """The port vanished or was never opened: cable, board reset; reopen() it."""


class PwmTimeoutError(PwmLinkError, TimeoutError):
    """The port is open, but no answer arrived in time."""


class PwmCorruptReplyError(PwmLinkError):
    """Answers arrived, but damaged, or not matching the request."""


class PwmStaleReplyError(PwmLinkError):
    """Only answers to earlier requests arrived."""


class PwmRejectedError(PwmLinkError):
    """The board refused a request: `code` is the reason."""

    def __init__(self, message: str, code: Code) -> None:
        super().__init__(message)
        self.code = code


class PwmLatchedError(PwmRejectedError):
    """The board has tripped and waits for clear(): `flags` show the cause."""

    def __init__(self, message: str, code: Code, flags: Flags) -> None:
        super().__init__(message, code)
        self.flags = flags


class PwmResetError(PwmLinkError):
    """The board restarted since it was cleared; clear() it if that was expected."""


class PwmVersionError(PwmLinkError):
    """The board has another version of the protocol."""


BAUD_RATE = 115_200
"""Not configurable: USB ignores it, except for 1200, which starts the boot loader of a Leonardo."""

WIRE_ERRORS = (OSError, termios.error)
"""Errors raised by pyserial when a port vanishes; its own SerialException is an OSError."""


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Timeout and retries of a link.

    Raises:
        PwmRangeError: the timeout is not positive, or `retries` is negative.
    """

    timeout: float = setting(
        0.2,
        "Longest wait for an answer of the board, by the wall clock.",
        "s",
        0.01,
        2.0,
    )  # with all retries it must stay below the board's deadline
    retries: int = setting(2, "Retries of an unanswered request.", "", 0, 10)

    def __post_init__(self) -> None:
        if not 0 < self.timeout < math.inf:
            raise PwmRangeError(
                f"PWM link: timeout is {self.timeout} s; it must be positive"
            )
        if self.retries < 0:
            raise PwmRangeError(
                f"PWM link: retries is {self.retries}; it must be 0 or more"
            )


def open_port(port: str, timeout: float) -> serial.Serial:
    """Open a port exclusively, with an empty input buffer.

    pyserial raises DTR and RTS, and tolerates ports without them, such as pseudo-terminals.

    Raises:
        PwmPortBusyError: another program holds it.
        PwmPortMissingError: it cannot be opened.
    """
    try:
        wire = serial.Serial(
            port, BAUD_RATE, timeout=timeout, write_timeout=timeout, exclusive=True
        )
        wire.reset_input_buffer()
    except (*WIRE_ERRORS, ValueError) as error:
        busy = getattr(error, "errno", None) in (errno.EBUSY, errno.EAGAIN)
        if busy or "exclusively lock" in str(error):
            raise PwmPortBusyError(
                f"PWM link: another program holds {port}; end it first"
            ) from error
        msg = f"PWM link: {port} cannot be opened ({error}); check the cable and your access to the port"
        raise PwmPortMissingError(msg) from error
    return wire


class Patience:
    """The time left for a reply: by the wall clock, and by that of a virtual plant in step, which may wait.

    `plant_time` lets a moment of plant time pass for the board to reply, and returns it, s (None: no longer
    in step).
    """

    _SHORT: Final = 0.005
    """Wait for a reply of a board in step, s."""

    def __init__(
        self, timeout: float, plant_time: Callable[[], float | None] | None = None
    ) -> None:
        self._plant_time = plant_time or (lambda: None)
        self._end = time.monotonic() + timeout
        self._plant_end = (self._plant_time() or 0.0) + timeout

    def left(self) -> float:
        """How long to wait before the next call, s; none if not positive."""
        plant_now = self._plant_time()
        if plant_now is not None and plant_now < self._plant_end:
            return self._SHORT
        return self._end - time.monotonic()


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

    _FIRST_PAUSE: Final = 0.1
    _MAX_PAUSE: Final = 2.0
    """Pauses between attempts to reopen a lost port, s; each is twice the one before."""

    def __init__(self, port: str, settings: LinkSettings | None = None) -> None:
        self.port = port
        self.settings = settings or LinkSettings()
        self.plant_time: Callable[[], float | None] | None = None
        """Called while a reply is awaited from a virtual board in step; see `Patience`."""
        self.restarts = 0
        """Number of detected restarts of the board."""
        self._lock = threading.RLock()
        self._wire: serial.Serial | None = None
        self._talk = Conversation()
        self.banner: Banner | None = None
        """The board's banner at the last opening."""
        self._known_restarts: int | None = None
        self._cleared = False

    def __enter__(self) -> PwmLink:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the port is held."""
        return self._wire is not None

    def open(self) -> Banner:
        """Open the port exclusively and start a session with the board; its output goes to zero.

        Raises:
            PwmPortMissingError, PwmPortBusyError: the port cannot be opened.
            PwmVersionError: the board has another protocol version; the port is closed again.
            PwmLinkError: the board does not answer; the port is closed again.
        """
        with self._lock:
            self._drop()
            self._wire = open_port(self.port, self.settings.timeout)
            # A random number, so that late replies to an earlier session are not taken for ours.
            self._talk = Conversation(secrets.randbelow(SEQUENCES))
            self._cleared = False
            try:
                banner = self._greet()
            except PwmLinkError:
                self._drop()
                raise
            if self._known_restarts not in (None, banner.restarts):
                self.restarts += 1
            self.banner = banner
            self._known_restarts = banner.restarts
            return banner

    def reopen(self, patience: float = 10.0) -> Banner:
        """Open the port again, with retries for `patience` seconds and growing pauses.

        Raises:
            PwmVersionError: at once, since waiting does not help.
            PwmLinkError: the error of the last attempt.
        """
        start = time.monotonic()
        pause = self._FIRST_PAUSE
        while True:
            try:
                return self.open()
            except PwmVersionError:
                raise
            except PwmLinkError:
                if time.monotonic() - start + pause > patience:
                    raise
            time.sleep(pause)
            pause = min(2 * pause, self._MAX_PAUSE)

    def command(self, pwm: float) -> Applied:
        """Set the output to `pwm`, −255 to 255, rounded to a whole number; positive heats.

        Raises:
            PwmRangeError: not finite or out of range; nothing was sent.
            PwmLatchedError: the board has tripped; clear() it once the cause is known.
            PwmResetError: the board restarted since it was cleared.
            PwmLinkError: any other failure of the link; see `pwm_errors`.
        """
        if not abs(pwm) <= PWM_LIMIT:  # also if it is not a number
            msg = f"PWM link: the command is {pwm}; give a number from -{PWM_LIMIT:g} to {PWM_LIMIT:g}"
            raise PwmRangeError(msg)
        with self._lock:
            reply = self._ask(Verb.SET, round(pwm))
            latched = isinstance(reply, Refusal) and reply.code is Code.LATCHED
            status = self._status(self._ask(Verb.QUERY) if latched else reply)
            if status.flags & Flags.TRIPPED:
                self._raise_trip(status.flags)
            return _applied(status)

    def query(self) -> Applied:
        """Query the state of the output; does not satisfy the board's deadline.

        Raises:
            PwmResetError: the board restarted since it was cleared.
            PwmLinkError: any other failure of the link; see `pwm_errors`.
        """
        with self._lock:
            status = self._status(self._ask(Verb.QUERY))
            self._notice_reset(status.flags)
            return _applied(status)

    def clear(self) -> Applied:
        """Clear a trip of the board; its output is zero until the next command.

        A trip on high drive stays until half of the board's budget is back, which takes 38 s of rest.

        Raises:
            PwmLinkError: the link failed; see `pwm_errors`.
        """
        with self._lock:
            status = self._status(self._ask(Verb.CLEAR))
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
            raise self._rejection(reply)
        if not isinstance(reply, Banner) or reply.protocol != PROTOCOL:
            raise PwmVersionError(
                f"PWM link: the board at {self.port} answers {reply}, which is not protocol version "
                f"{PROTOCOL}; load the firmware of this version"
            )
        return reply

    def _status(self, reply: Reply) -> BoardStatus:
        if not isinstance(reply, BoardStatus):
            raise self._rejection(reply)
        return reply

    def _ask(self, verb: Verb, pwm: int = 0) -> Reply:
        """Send a request and return its reply, with retries under the same sequence number."""
        if self._wire is None:
            raise PwmPortLostError(
                f"PWM link: {self.port} is not open; open() or reopen() it"
            )
        line = self._talk.ask(verb, pwm)
        for attempt in range(self.settings.retries + 1):
            if attempt:
                line = self._talk.repeat()
            reply = self._attempt(self._wire, line)
            if reply is not None:
                return reply
        raise self._no_answer(verb)

    def _attempt(self, wire: serial.Serial, line: bytes) -> Reply | None:
        """Send a line and wait for its reply; None if none arrived in time or it was damaged."""
        try:
            wire.write(line)
            patience = Patience(self.settings.timeout, self.plant_time)
            while (seconds_left := patience.left()) > 0 and not self._talk.spoiled:
                wire.timeout = seconds_left
                reply = self._talk.hear(wire.read(max(1, wire.in_waiting)))
                if reply is not None:
                    return reply
        except serial.SerialTimeoutException:
            return None  # the board accepts no bytes: equivalent to no answer
        except WIRE_ERRORS as error:
            self._drop()
            msg = f"PWM link: {self.port} was lost ({error}); check the cable, then reopen()"
            raise PwmPortLostError(msg) from error
        return None

    def _no_answer(self, verb: Verb) -> PwmLinkError:
        talk = self._talk
        tries = self.settings.retries + 1
        failure = f"PWM link: {self.port} gave {verb.name.lower()} no answer in {tries} attempts"
        if talk.refused_line is not None:
            code = talk.refused_line.code
            why = f"requests arrive damaged ({code.value}); check the cable"
            return PwmRejectedError(f"{failure}: {why}", code)
        if talk.damaged:
            return PwmCorruptReplyError(
                f"{failure}: {talk.damaged} arrived damaged; check the cable"
            )
        if talk.stale:
            return PwmStaleReplyError(
                f"{failure}: {talk.stale} replies were to earlier requests; is the machine overloaded?"
            )
        wait = f"{self.settings.timeout:g} s"
        return PwmTimeoutError(
            f"{failure} of {wait}; is this the right port, and is the board running?"
        )

    def _rejection(self, reply: Reply) -> PwmRejectedError:
        code = reply.code if isinstance(reply, Refusal) else Code.UNKNOWN
        failure = f"PWM link: the board at {self.port} refused with {code.value}"
        return PwmRejectedError(f"{failure}; do host and firmware match?", code)

    def _raise_trip(self, flags: Flags) -> NoReturn:
        self._notice_reset(flags)
        causes = {
            Flags.DEADLINE: "it received no command in time",
            Flags.DRIVER: "the motor driver reported a fault (short circuit, over-temperature, supply)",
            Flags.BUDGET: "it drove high for longer than a plant needs (check sensor and drive, let it cool)",
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
        if self._wire is not None:
            with contextlib.suppress(*WIRE_ERRORS):
                self._wire.close()
        self._wire = None


def _applied(status: BoardStatus) -> Applied:
    return Applied(
        status.applied,
        status.adc * AMPERES_PER_COUNT,
        status.flags,
        status.time_ms / 1000,
    )
