"""A stand-in for the Arduino: the firmware's behaviour in Python behind a pseudo-terminal.

It needs only Python, and identifies itself: its banner names the firmware `standin-…`. Where the AVR
simulator is installed, `arduino_virtual` runs the real firmware image instead.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pty
import tempfile
import threading
import time
import tty
from pathlib import Path
from types import TracebackType

from twinmatch.emulation.arduino_model import FIRMWARE, ArduinoModel
from twinmatch.emulation.arduino_pins import ArduinoError, PinDrive

__all__ = ["StandInArduino"]

_log = logging.getLogger(__name__)

_AWAY_MS = 20  # time that a restarting board is off the bus
_LATE = 0.020  # s of board time caught up at most after the machine was busy; the rest is lost


class StandInArduino:
    """A `Board` in Python. Its port appears at `port`, by default a temporary path."""

    def __init__(self, port: str | Path | None = None) -> None:
        self._folder = None if port else tempfile.TemporaryDirectory(prefix="twinmatch-arduino-")
        self.port = str(port or Path(self._folder.name if self._folder else "") / "ttyACM0")
        self.model = ArduinoModel()
        self._elapsed_ms = 0
        self._away_ms = 0
        self._lock = threading.RLock()
        self._running = threading.Event()
        self._thread: threading.Thread | None = None
        self._master: int | None = None
        self.plug()
        _log.info("%s is a stand-in for the Arduino (%s); no firmware runs behind it", self.port, FIRMWARE)

    def __enter__(self) -> StandInArduino:
        """Nothing to do: the board exists since construction."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the board."""
        self.close()

    def advance(self, seconds: float) -> PinDrive:
        """Advance by this time, rounded to ms, and return the drive at the end.

        Raises:
            ArduinoError: it is running, or is closed.
        """
        if self._thread is not None:
            raise ArduinoError(f"stand-in at {self.port}: it is running; pause() it before advance()")
        for _ in range(round(seconds * 1000)):
            self._millisecond()
        return self.drive()

    def run(self, speed: float = 1.0) -> None:
        """Run `speed` times as fast as the wall clock.

        Raises:
            ArduinoError: the speed is not positive.
        """
        if not speed > 0:
            raise ArduinoError(f"stand-in at {self.port}: speed is {speed}; it must be positive")
        self.pause()
        self._running.set()
        self._thread = threading.Thread(
            target=self._pace, args=(speed,), name="stand-in Arduino", daemon=True
        )
        self._thread.start()

    def pause(self) -> None:
        """Stop running."""
        self._running.clear()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def drive(self) -> PinDrive:
        """The drive now."""
        with self._lock:
            return PinDrive(self._elapsed_ms / 1000, float(self.model.level), self.model.enabled)

    def set_current(self, amperes: float) -> None:
        """Show a current on the feedback pin, A."""
        with self._lock:
            self.model.set_current(amperes)

    def set_fault(self, fault: bool) -> None:
        """Set or release the driver's fault flag."""
        with self._lock:
            self.model.fault = fault

    def hang(self) -> None:
        """Let the firmware hang; the watchdog will restart it."""
        with self._lock:
            self.model.hang()

    def unplug(self) -> None:
        """Remove the port."""
        with self._lock:
            self._away_ms = 0
            if self._master is not None:
                Path(self.port).unlink(missing_ok=True)
                os.close(self._master)
            self._master = None

    def plug(self) -> None:
        """Create the port, or restore it.

        Raises:
            ArduinoError: the path cannot be created.
        """
        with self._lock:
            if self._master is not None:
                return
            master, slave = pty.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            try:
                Path(self.port).symlink_to(os.ttyname(slave))
            except OSError as error:
                os.close(master)
                msg = f"stand-in: the port cannot be created at {self.port} ({error}); choose another path"
                raise ArduinoError(msg) from error
            finally:
                os.close(slave)
            self._master = master

    def close(self) -> None:
        """End the board; its port disappears."""
        self.pause()
        self.unplug()
        if self._folder is not None:
            self._folder.cleanup()

    def _millisecond(self) -> None:
        with self._lock:
            restarts = self.model.restarts
            reply = self.model.tick(self._read())
            self._elapsed_ms += 1
            self._away_ms = max(0, self._away_ms - 1)
            if self.model.restarts != restarts and self._master is not None:
                self.unplug()
                self._away_ms = _AWAY_MS
            elif self._away_ms == 1:
                self.plug()
            elif reply and self._master is not None:
                with contextlib.suppress(OSError):  # a host that does not read loses its replies
                    os.write(self._master, reply)

    def _read(self) -> bytes:
        if self._master is None:
            return b""
        try:
            return os.read(self._master, 256)
        except OSError:  # nothing there, or no host
            return b""

    def _pace(self, speed: float) -> None:
        due = time.monotonic()
        while self._running.is_set():
            now = time.monotonic()
            due = max(due, now - _LATE / speed - 0.005)
            while due <= now:
                self._millisecond()
                due += 0.001 / speed
            time.sleep(0.001)
