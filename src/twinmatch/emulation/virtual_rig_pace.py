"""Keeps plant time to a multiple of the wall clock, never ahead of it."""

from __future__ import annotations

import math
import time
from collections import deque

__all__ = ["RigPace"]

_MOST_LATE = 0.2
"""Most plant time caught up after a delay, s, when it runs faster than the wall clock. Longer delays of a
busy machine are lost: catching up in one jump would look like a silent host to the board, with its deadline
of one second. At real time nothing is lost, because a real plant does not wait either."""
_LEAST = 0.005
"""Wall time always caught up, s: the latency of waking up."""
_RECENT = 2.0
"""Wall time over which the achieved speed is averaged, s."""


class RigPace:
    """Computes how long to wait before plant time may advance."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._real = speed <= 1
        self._start = self._wall = time.monotonic()
        self._plant = 0.0
        self._marks: deque[tuple[float, float]] = deque([(self._start, 0.0)])

    def wait(self, plant: float) -> float:
        """Wall time, s, until plant time `plant` (s since the start) is due; 0 if it already is."""
        now = time.monotonic()
        self._mark(now, plant)
        due = self._wall + (plant - self._plant) / self.speed
        late = math.inf if self._real else max(_LEAST, _MOST_LATE / self.speed)
        if now - due > late:
            self._wall, self._plant = now - late, plant
        return max(0.0, due - now)

    def limit(self, speed: float, plant: float) -> None:
        """Continue at another speed from plant time `plant`, s."""
        if speed != self.speed:
            self.speed, self._wall, self._plant = speed, time.monotonic(), plant

    def achieved(self) -> float:
        """Recent plant time per wall time."""
        (first_wall, first), (last_wall, last) = self._marks[0], self._marks[-1]
        return (last - first) / (last_wall - first_wall) if last_wall > first_wall else 0.0

    def overall(self, plant: float) -> tuple[float, float]:
        """Wall time since the start, s, and plant time per wall time over all of it."""
        wall = time.monotonic() - self._start
        return wall, plant / wall

    def _mark(self, now: float, plant: float) -> None:
        if now - self._marks[-1][0] > _RECENT / 20:
            self._marks.append((now, plant))
            while now - self._marks[0][0] > _RECENT:
                self._marks.popleft()
