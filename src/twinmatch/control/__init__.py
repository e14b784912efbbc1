"""The loop that holds the plate: set-point over time, and one PID step per tick, without clock or ROS.

`Profile` says which set-point is asked for at which time. `Loop` is told temperatures and the time and
makes one `Sample` per tick; where it cannot (no fresh temperature, a tick that came too late) it invents
none, so the index of the next sample shows how many are missing.
"""

from twinmatch.control.errors import ControlError
from twinmatch.control.loop import Loop
from twinmatch.control.profile import Profile

__all__ = ["ControlError", "Loop", "Profile"]
