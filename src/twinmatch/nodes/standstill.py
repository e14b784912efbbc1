"""Detect that the process was suspended, and hold back publishing until its readers have rediscovered it.

DDS forgets a participant that has sent nothing for its lease, 5 s here. A process that was suspended longer
(SIGSTOP, a swap storm) continues where it was, but its first messages reach no reader, because readers have
to discover it again. A verdict that was being computed when the process was suspended would be lost.
"""

from __future__ import annotations

import threading
import time

BEAT = 0.25
"""Period of the heartbeat, wall s."""
LONG = 4.0
"""Time without a heartbeat after which others may have dropped this process, wall s; less than the lease."""
REDISCOVERY = 2.0
"""Time until all others have rediscovered it, wall s: it announces itself every 0.5 s."""


class Standstill:
    """Detects a suspension of the process from gaps in its own heartbeat."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: float | None = None
        self._until = 0.0
        self._ended = threading.Event()

    def beat(self, now: float) -> None:
        """Take a heartbeat at `now`, in s of a clock that continues while the process is suspended."""
        with self._lock:
            if self._last is not None and now - self._last > LONG:
                self._until = now + REDISCOVERY
            self._last = now

    def remaining(self, now: float) -> float:
        """Time to wait before publishing, s. The call counts as a heartbeat: it may be the first since."""
        self.beat(now)
        return max(0.0, self._until - now)

    def wait(self) -> None:
        """Wait until readers are connected again; returns at once unless the process was suspended."""
        while not self._ended.is_set() and (left := self.remaining(time.monotonic())) > 0.0:
            self._ended.wait(left)

    def start(self) -> None:
        """Start the heartbeat in its own thread, until `end`."""
        self.beat(time.monotonic())
        threading.Thread(target=self._run, name="standstill", daemon=True).start()

    def end(self) -> None:
        """End the heartbeat and any wait."""
        self._ended.set()

    def _run(self) -> None:
        while not self._ended.wait(BEAT):
            self.beat(time.monotonic())
