"""Whether a process has just stood still, and how long it must wait before anybody hears it again.

DDS forgets a participant that has sent nothing for its lease, 5 s here. A process that was stopped longer
(SIGSTOP, a swap storm) continues where it was, but what it publishes first reaches nobody, because its
readers have to discover it again. A verdict that was being computed when the process stopped would be lost.
"""

from __future__ import annotations

import threading
import time

__all__ = ["Standstill"]

BEAT = 0.25
"""Wall seconds between two signs of life."""
LONG = 4.0
"""Wall seconds without one after which others may have forgotten this process; less than the lease."""
REDISCOVERY = 2.0
"""Wall seconds until all others have found it again: it announces itself every 0.5 s."""


class Standstill:
    """Notices from a heartbeat of its own that the process stood still."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: float | None = None
        self._until = 0.0
        self._ended = threading.Event()

    def beat(self, now: float) -> None:
        """Take a sign of life at `now`, in s of a clock that continues while the process stands still."""
        with self._lock:
            if self._last is not None and now - self._last > LONG:
                self._until = now + REDISCOVERY
            self._last = now

    def remaining(self, now: float) -> float:
        """Seconds still to wait before publishing. A call is a sign of life: it may be the first since."""
        self.beat(now)
        return max(0.0, self._until - now)

    def wait(self) -> None:
        """Wait until what is published is received again; returns at once unless the process stood still."""
        while not self._ended.is_set() and (left := self.remaining(time.monotonic())) > 0.0:
            self._ended.wait(left)

    def start(self) -> None:
        """Begin to beat, in a thread of its own, until `end`."""
        self.beat(time.monotonic())
        threading.Thread(target=self._run, name="standstill", daemon=True).start()

    def end(self) -> None:
        """Stop beating and waiting."""
        self._ended.set()

    def _run(self) -> None:
        while not self._ended.wait(BEAT):
            self.beat(time.monotonic())
