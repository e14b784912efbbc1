"""Health of the plant: which fault it has and since when, judged from the samples; takes no action itself.

`Monitor` takes one sample after the other and says whether the plant is healthy. It keeps an energy
balance (`Balance`): the movement since the sample before that the plant's own equations expect from the
drive and from the surroundings, against the measured one. A drive without effect and a frozen sensor leave
different traces in that balance, so each can be named; an implausible reading has been refused before
(`Refusals`) and is reported. In addition the plant is
tracked with its unmeasured states (`ChangeDetector`): changed losses, a changed room temperature, a weak
drive and a sensor offset each explain the readings in their own way. The monitor is synchronous and uses
neither a clock nor random numbers: the same samples give the same judgement. Emergency shut-down is left to
`twinmatch.safety`.
"""

from __future__ import annotations

from twinmatch.health.balance import Balance, Movement
from twinmatch.health.faults import (
    SLOW,
    Alarm,
    EstimatedReading,
    Fault,
    Health,
    HealthState,
    Lie,
)
from twinmatch.health.monitor import Monitor
from twinmatch.health.refusals import Refusals
from twinmatch.health.settings import HealthError, HealthSettings

__all__ = [
    "SLOW",
    "Alarm",
    "Balance",
    "EstimatedReading",
    "Fault",
    "Health",
    "HealthError",
    "HealthSettings",
    "HealthState",
    "Lie",
    "Monitor",
    "Movement",
    "Refusals",
]
