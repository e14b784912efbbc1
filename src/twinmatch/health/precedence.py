"""Precedence of faults: which ones replace a fault that is already reported."""

from __future__ import annotations

from typing import Final

from twinmatch.health.record import SLOW, Fault

__all__ = ["GRAVER", "UNFOLLOWED"]

_SUDDEN: Final = frozenset(Fault) - SLOW
_NAMED: Final = SLOW - {Fault.DRIFT}
GRAVER: Final = {
    Fault.DRIFT: _SUDDEN | _NAMED,
    Fault.DRIVE_WEAK: frozenset({Fault.DRIVE_LOST, Fault.SENSOR_FROZEN, Fault.SENSOR_IMPLAUSIBLE}),
    **{fault: _SUDDEN | (_NAMED - {fault}) for fault in _NAMED},
}
"""For each fault, the graver ones that replace it while it is on."""
UNFOLLOWED: Final = frozenset({
    Fault.DRIVE_LOST, Fault.SENSOR_FROZEN, Fault.SENSOR_LATE, Fault.SENSOR_IMPLAUSIBLE,
})  # fmt: skip
"""Faults during which nothing else can be learned about the plant."""
