"""The control loop: set-point over time, and one PID step per tick, without clock or ROS.

`Profile` is the set-point as a function of time. `Loop` takes readings and the time, and makes one `Sample`
per tick. Where it cannot (no fresh reading, a missed tick) it makes none, so the index of the next sample
shows how many are missing.
"""

from twinmatch.control.errors import ControlError
from twinmatch.control.loop import Loop
from twinmatch.control.profile import Profile

__all__ = ["ControlError", "Loop", "Profile"]
