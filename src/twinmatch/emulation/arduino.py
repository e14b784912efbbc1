"""The PWM board as the rest of an emulated rig sees it, and a stand-in for it in Python.

The stand-in follows `firmware/twinmatch_leonardo` rule by rule, behind a pseudo-terminal; the same test
scenarios run against both. It needs only Python, and identifies itself: its banner names the firmware
`standin-…`. Where the AVR simulator is installed, `arduino_virtual` runs the real firmware image instead.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pty
import select
import tempfile
import threading
import time
import tty
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

from twinmatch.errors import TwinmatchError
from twinmatch.links.pwm_link import AMPERES_PER_COUNT
from twinmatch.links.pwm_protocol import (
    PROTOCOL,
    PWM_LIMIT,
    SEQUENCES,
    Banner,
    BoardStatus,
    Code,
    Damage,
    Flags,
    FrameReader,
    Refusal,
    Reply,
    Request,
    Verb,
    is_newer,
    parse_request,
    seal,
)
from twinmatch.settings import Rule

_log = logging.getLogger(__name__)
_Own = TypeVar("_Own", bound="EmulatedBoard")

FIRMWARE = "standin-1.1.0"
"""Firmware name in the banner, which cannot be mistaken for the real firmware."""

DEADLINE_MS = 1000
HOLD_PWM = 220
"""Largest magnitude of the PWM that may stay for ever; the budget counts what is above it."""
FULL_DRIVE_SECONDS = 480
"""Time at full drive that spends the whole budget, s."""
_WATCHDOG_RESET = 0x08  # WDRF of MCUSR
_POWER_ON = 0x01  # PORF of MCUSR


class BoardTimes(Rule):
    """Times of the firmware and of its board, ms."""

    watchdog: int = 500
    """Time without a sign of life after which the board restarts."""
    reversal: int = 2
    """Time without drive before its direction changes."""
    settle: int = 10
    debounce: int = 5
    away: int = 20
    """Time that a restarting board is off the bus."""


_TIMES: Final = BoardTimes()


class ArduinoError(TwinmatchError):
    """An emulated board cannot be created or does not answer."""


class PinDrive(NamedTuple):
    """State of the driver's pins."""

    time: float
    """Board time since construction, s; restarts of the firmware do not reset it."""
    pwm: float
    """Averaged drive, −255 to 255; positive heats. Zero while the driver is off."""
    enabled: bool
    """Whether the driver is on. On with zero PWM it shorts the plate; off it leaves the circuit open."""


class EmulatedBoard(ABC):
    """An emulated Arduino at the end of a pseudo-terminal; a context manager.

    Its port appears at `port`, by default a temporary path, and vanishes and returns with the cable. Its time
    passes only in `advance`; other methods may be called from another thread.
    """

    def __init__(self, port: str | Path | None = None) -> None:
        self._folder = (
            None if port else tempfile.TemporaryDirectory(prefix="twinmatch-arduino-")
        )
        self.port = str(
            port or Path(self._folder.name if self._folder else "") / "ttyACM0"
        )

    def __enter__(self: _Own) -> _Own:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the board; its port disappears."""
        if self._folder is not None:
            self._folder.cleanup()

    @abstractmethod
    def advance(self, seconds: float) -> PinDrive:
        """Advance by this time, rounded to ms, and return the drive at the end."""


class SerialPort:
    """The device's end of a serial line: a pseudo-terminal that appears at a path when it is plugged in."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._master: int | None = None

    @property
    def plugged(self) -> bool:
        """Whether the port exists."""
        return self._master is not None

    def plug(self) -> None:
        """Create the port.

        Raises:
            ArduinoError: the path cannot be created.
        """
        if self._master is not None:
            return
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        try:
            self.path.symlink_to(os.ttyname(slave))
        except OSError as error:
            os.close(master)
            msg = f"emulated board: the port cannot be created at {self.path} ({error}); choose another path"
            raise ArduinoError(msg) from error
        finally:
            os.close(slave)
        self._master = master

    def unplug(self) -> None:
        """Remove the port."""
        if self._master is not None:
            self.path.unlink(missing_ok=True)
            os.close(self._master)
        self._master = None

    def read(self, most: int) -> bytes:
        """What the host has sent; empty if there is nothing, or no host."""
        if self._master is None:
            return b""
        try:
            return os.read(self._master, most)
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Put bytes on the line; a host that does not read loses them."""
        if self._master is not None:
            with contextlib.suppress(OSError):
                os.write(self._master, data)

    def wait(self, seconds: float) -> None:
        """Wait at most this time for the host to send something."""
        if self._master is not None:
            line = select.poll()
            line.register(self._master, select.POLLIN)
            ready = line.poll(1000.0 * seconds)
            if not ready or ready[0][1] & select.POLLIN:
                return
        # without a host the line is hung up, which ends every poll at once
        time.sleep(seconds)


class ArduinoModel:
    """The board between its serial line and the driver's pins."""

    def __init__(self) -> None:
        self.counts = 0
        """Reading of the current feedback, 0 to 1023."""
        self.fault = False
        """Whether the driver pulls its fault flag."""
        self.restarts = 0
        """Starts since power-up."""
        self.level = 0
        """PWM on the pins, −255 to 255."""
        self._time_ms = 0
        self._spent = 0  # of the budget, PWM·ms; a restart keeps it
        self._whole = (round(PWM_LIMIT) - HOLD_PWM) * 1000 * FULL_DRIVE_SECONDS
        self._reader = FrameReader()
        self._boot(_POWER_ON)

    @property
    def enabled(self) -> bool:
        """Whether the driver is on."""
        return bool(self._flags & Flags.ENABLED)

    def hang(self) -> None:
        """Stop everything except the watchdog."""
        self._hung_ms = 1

    def tick(self, data: bytes = b"") -> bytes:
        """Advance by one millisecond: takes received bytes, returns the bytes to send."""
        if self._hung_ms:
            return self._tick_hung()
        self._time_ms = (self._time_ms + 1) % 2**32
        self._watch_host()
        self._watch_driver()
        self._watch_budget()
        self._input += self._reader.feed(data)
        out = self._finish_turn() if self._turn else []
        while self._input and not self._turn:
            out += self._answer(self._input.pop(0))
        return b"".join(seal(str(reply)) for reply in out)

    def _boot(self, cause: int) -> None:
        self._cause = cause
        self._flags = Flags.TRIPPED | Flags.RESET
        self.level = self._time_ms = self._remaining = self._settle = self._low = (
            self._hung_ms
        ) = 0
        self._heat = True
        self._last: int | None = None
        self._reader = FrameReader()
        self._input: list[bytes | Damage] = []
        self._turn: tuple[int, Request] | None = None

    def _tick_hung(self) -> bytes:
        self._hung_ms += 1
        if self._hung_ms > _TIMES.watchdog:
            self.restarts = (self.restarts + 1) % SEQUENCES
            self._boot(_WATCHDOG_RESET)
        return b""

    def _watch_host(self) -> None:
        if self._remaining:
            self._remaining -= 1
            if not self._remaining:
                self._latch(Flags.DEADLINE)

    def _watch_driver(self) -> None:
        if not self.enabled:
            return
        if self._settle:
            self._settle -= 1
        else:
            self._low = self._low + 1 if self.fault else 0
            if self._low >= _TIMES.debounce:
                self._latch(Flags.DRIVER)

    def _watch_budget(self) -> None:
        self._spent = max(0, self._spent + abs(self.level) - HOLD_PWM)
        if self._spent > self._whole:
            self._latch(Flags.BUDGET)

    def _latch(self, reason: Flags) -> None:
        self._disable()
        self._flags |= Flags.TRIPPED | reason

    def _disable(self) -> None:
        self.level = 0
        self._flags &= ~Flags.ENABLED

    def _answer(self, event: bytes | Damage) -> list[Reply]:
        if isinstance(event, Damage):
            return [Refusal(None, Code(event.value))]
        request = parse_request(event)
        if isinstance(request, Refusal):
            return [request]
        if request.verb is Verb.SET:
            return self._set(request)
        if request.verb is Verb.HELLO:
            return [self._greet(request)]
        return [
            self._clear(request)
            if request.verb is Verb.CLEAR
            else self._status(request)
        ]

    def _greet(self, request: Request) -> Banner:
        self._disable()
        self._remaining = 0
        self._last = request.sequence
        return Banner(
            request.sequence,
            FIRMWARE,
            PROTOCOL,
            self._cause,
            DEADLINE_MS,
            self.restarts,
        )

    def _set(self, request: Request) -> list[Reply]:
        if self._flags & Flags.TRIPPED:
            return [Refusal(request.sequence, Code.LATCHED)]
        if not self._is_new(request):
            return [self._status(request, Flags.DUPLICATE)]
        if request.pwm and (request.pwm > 0) != self._heat:
            self.level = 0
            self._turn = _TIMES.reversal, request
            return []
        return [self._apply(request)]

    def _finish_turn(self) -> list[Reply]:
        assert self._turn is not None  # noqa: S101
        milliseconds, request = self._turn
        if milliseconds > 1:
            self._turn = milliseconds - 1, request
            return []
        self._turn = None
        self._heat = request.pwm > 0
        return [self._apply(request)]

    def _apply(self, request: Request) -> Reply:
        if self._flags & Flags.TRIPPED:  # during the turn
            return Refusal(request.sequence, Code.LATCHED)
        self._remaining = DEADLINE_MS
        if not self.enabled:
            self._settle = _TIMES.settle
            self._low = 0
            self._flags |= Flags.ENABLED
        self.level = request.pwm
        return self._status(request)

    def _clear(self, request: Request) -> BoardStatus:
        if not self._is_new(request):
            return self._status(request, Flags.DUPLICATE)
        self._disable()
        self._remaining = 0
        unrested = self._flags & Flags.BUDGET and self._spent > self._whole / 2
        self._flags = Flags.TRIPPED | Flags.BUDGET if unrested else Flags.NONE
        return self._status(request)

    def _is_new(self, request: Request) -> bool:
        if self._last is not None and not is_newer(request.sequence, self._last):
            return False
        self._last = request.sequence
        return True

    def _status(self, request: Request, extra: Flags = Flags.NONE) -> BoardStatus:
        return BoardStatus(
            request.sequence,
            self._time_ms,
            self.level,
            self.counts,
            self._flags | extra,
        )


class StandInArduino(EmulatedBoard):
    """A board in Python."""

    def __init__(self, port: str | Path | None = None) -> None:
        super().__init__(port)
        self.model = ArduinoModel()
        self.line = SerialPort(self.port)
        """The serial line to its host."""
        self._elapsed_ms = 0
        self._away_ms = 0
        self._lock = threading.RLock()
        self.plug()
        _log.info(
            "%s is a stand-in for the Arduino (%s); no firmware runs behind it",
            self.port,
            FIRMWARE,
        )

    def advance(self, seconds: float) -> PinDrive:
        """Advance by this time, rounded to ms, and return the drive at the end."""
        received = True
        for _ in range(round(seconds * 1000)):
            # What a host sends during this call, which takes no time, is read at the next one.
            received = self._millisecond(read=received)
        return self.drive()

    def drive(self) -> PinDrive:
        """The drive now."""
        with self._lock:
            return PinDrive(
                self._elapsed_ms / 1000, float(self.model.level), self.model.enabled
            )

    def set_current(self, amperes: float) -> None:
        """Show a current on the driver's feedback pin, A, averaged over the PWM."""
        self.model.counts = min(1023, max(0, round(amperes / AMPERES_PER_COUNT)))

    def set_fault(self, fault: bool) -> None:
        """Set or release the driver's fault flag."""
        self.model.fault = fault

    def hang(self) -> None:
        """Let the firmware hang with interrupts off; only the watchdog ends that."""
        with self._lock:
            self.model.hang()

    def unplug(self) -> None:
        """Unplug the USB cable; the board keeps its power."""
        with self._lock:
            self._away_ms = 0
            self.line.unplug()

    def plug(self) -> None:
        """Plug the USB cable in."""
        with self._lock:
            self.line.plug()

    def close(self) -> None:
        """End the board."""
        self.unplug()
        super().close()

    def _millisecond(self, *, read: bool = True) -> bool:
        """Advance by one millisecond; returns whether anything was received in it."""
        with self._lock:
            restarts = self.model.restarts
            data = self.line.read(256) if read else b""
            reply = self.model.tick(data)
            self._elapsed_ms += 1
            self._away_ms = max(0, self._away_ms - 1)
            if self.model.restarts != restarts and self.line.plugged:
                self.unplug()
                self._away_ms = _TIMES.away
            elif self._away_ms == 1:
                self.plug()
            elif reply:
                self.line.write(reply)
            return bool(data)
