"""Decide when the output must go to zero.

State machines without clocks, wires or threads: the caller passes the time. `OutputGuard` decides what may
reach the driver. It is fed by `SafetyClock`, a time that only runs forward, and judges what heats by what it
does: `Runaway` checks that the plate follows the drive, `HeatBudget` that no more drive passes than the
reading explains, `DriveObserver` that the sensor reads what the drive must have done; its `Ceiling` limits
drive that takes the plant beyond set-point and reading. `Accusations` acts on what a trusted twin says, and
`StandIns` lets its estimate stand in for a sensor where an operator has allowed it. `LawTrial` watches a law
that an operator wants to try, and says when the law before is to drive again; `nominal_eigenvalue` is what
can be said of that law without a twin. `Turn` lets one experiment or one law on trial move the plant at a
time.
"""

from twinmatch.safety.accusations import ACCUSED, Accusations
from twinmatch.safety.budget import BudgetLimits, HeatBudget
from twinmatch.safety.clock import ClockLimits, SafetyClock
from twinmatch.safety.guard import (
    FaultKind,
    GuardFault,
    GuardLimits,
    OutputGuard,
    is_limit,
)
from twinmatch.safety.nominal import nominal_eigenvalue
from twinmatch.safety.observer import DriveObserver, ObserverLimits
from twinmatch.safety.runaway import Runaway, RunawayLimits
from twinmatch.safety.stand_in import StandIn, StandIns, StandInState
from twinmatch.safety.trial import (
    LawReport,
    LawTrial,
    TrialBands,
    TrialError,
    TrialPhase,
)
from twinmatch.safety.turn import Mover, Turn

__all__ = [
    "ACCUSED",
    "Accusations",
    "BudgetLimits",
    "ClockLimits",
    "DriveObserver",
    "FaultKind",
    "GuardFault",
    "GuardLimits",
    "HeatBudget",
    "LawReport",
    "LawTrial",
    "Mover",
    "ObserverLimits",
    "OutputGuard",
    "Runaway",
    "RunawayLimits",
    "SafetyClock",
    "StandIn",
    "StandInState",
    "StandIns",
    "TrialBands",
    "TrialError",
    "TrialPhase",
    "Turn",
    "is_limit",
    "nominal_eigenvalue",
]
