"""When the output has to go to zero.

State machines without clocks, wires or threads: the caller tells them the time. `OutputGuard` decides
what may reach the driver, `Runaway` watches that the plate goes where it is pushed, and `SafetyClock` makes
time that only runs forward out of a clock that may not.
"""

from __future__ import annotations

from twinmatch.safety.clock import ClockLimits, SafetyClock
from twinmatch.safety.errors import SafetyError
from twinmatch.safety.guard import Fault, FaultKind, GuardLimits, OutputGuard
from twinmatch.safety.runaway import Runaway, RunawayLimits

__all__ = [
    "ClockLimits",
    "Fault",
    "FaultKind",
    "GuardLimits",
    "OutputGuard",
    "Runaway",
    "RunawayLimits",
    "SafetyClock",
    "SafetyError",
]
