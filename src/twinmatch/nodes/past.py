"""When something was, on the ROS clock, if it is known how long ago it was on the wall's."""

from __future__ import annotations

__all__ = ["RosPast"]

FASTEST = 1000.0
"""Most seconds of simulated time in a wall second; what seems faster is a leap of the clock."""
SMOOTHING = 0.2
"""Share of the newest reading in the clock's pace."""


class RosPast:
    """Follows how fast the ROS clock runs, told its readings; real time has pace 1."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        self._pace = 1.0

    def at(self, taken: int, *, wall: int, ros: int, simulated: bool) -> int:
        """The ROS time of the monotonic time `taken`, read now off both clocks; all in ns."""
        if not simulated:
            return ros - (wall - taken)
        if self._last is not None and wall > self._last[0]:
            pace = (ros - self._last[1]) / (wall - self._last[0])
            if 0.0 <= pace <= FASTEST:
                self._pace += SMOOTHING * (pace - self._pace)
        self._last = (wall, ros)
        return max(0, ros - round((wall - taken) * self._pace))  # a clock that is not set yet says 0
