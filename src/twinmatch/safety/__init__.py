"""Decide when the output must go to zero.

State machines without clocks, wires or threads: the caller passes the time. `OutputGuard` decides what may
reach the driver, `Runaway` checks that the plate follows the drive, and `SafetyClock` derives a time that
only runs forward from a clock that may not.
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
