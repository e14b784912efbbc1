"""What ails the plant, and since when: a judgement from the samples, never a reason to act by itself.

`Monitor` takes one sample after the other and says whether the plant is healthy. It keeps an energy
balance (`Balance`): what the drive and the surroundings should have done to the plant since the sample
before, by the plant's own equations, against what the plant did. A drive without effect, a sensor that
stands still and a reading that no plant can follow leave different traces in that balance, and so each gets
its own name. Beside it the plant is tracked with the states that no sensor shows (`Changes`): other losses,
another room, a drive or a reading that is off explain the readings each in its own way. Synchronous, no
clock, no chance: the same samples, the same judgement. What has to go to zero at once is the business of
`twinmatch.safety`.
"""

from __future__ import annotations

from twinmatch.health.balance import Balance, Movement
from twinmatch.health.monitor import Monitor
from twinmatch.health.record import SLOW, Alarm, Fault, Health, State
from twinmatch.health.settings import HealthError, HealthSettings

__all__ = [
    "SLOW",
    "Alarm",
    "Balance",
    "Fault",
    "Health",
    "HealthError",
    "HealthSettings",
    "Monitor",
    "Movement",
    "State",
]
