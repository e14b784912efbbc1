"""Convert a past time of the wall clock to the ROS clock."""

from __future__ import annotations

__all__ = ["RosPast"]

FASTEST = 1000.0
"""Highest speed of simulated time, s per wall s; anything faster is a jump of the clock."""
SMOOTHING = 0.2
"""Weight of the newest reading in the estimate of the clock's speed."""


class RosPast:
    """Estimates the speed of the ROS clock from its readings; real time has speed 1."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        self._pace = 1.0

    def at(self, taken: int, *, wall: int, ros: int, simulated: bool) -> int:
        """The ROS time of the monotonic time `taken`, given current readings of both clocks; all in ns."""
        if not simulated:
            return ros - (wall - taken)
        if self._last is not None and wall > self._last[0]:
            pace = (ros - self._last[1]) / (wall - self._last[0])
            if 0.0 <= pace <= FASTEST:
                self._pace += SMOOTHING * (pace - self._pace)
        self._last = (wall, ros)
        return max(0, ros - round((wall - taken) * self._pace))  # a clock that is not set yet reads 0
