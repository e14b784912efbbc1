"""What may happen to a plant with several signals, made from its file: a row for every drive, sensor and
role, and way to begin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from twinmatch.dynamics import Model
from twinmatch.health.faults import Fault

Named = tuple[Fault, int]
"""A fault, and of which free parameter, drive or output; `DRIFT`: something acts as this drive does."""

RARE: Final = 2.5
"""Price of what comes evenly over minutes, nats."""
UNKNOWN: Final = 2.0
"""Price of what acts as a drive does, and is none."""


@dataclass(frozen=True)
class ChangeRow:
    """One way in which one number may change; sizes in the number's unit, times in s of a plant as fast as
    the rig."""

    cause: Named
    number: str
    """A parameter; or share, push, offset or fading, with the place of its drive or output."""
    shift: float = 0.0
    """Expected size, of a logarithm relative to the number …"""
    spread: float = 0.0
    """… and its standard deviation."""
    least: float = 0.0
    """Smaller ones are not reported."""
    slowly: float = 0.0
    """Time in which a ramp covers its spread; 0: a jump."""
    lasting: float = 0.0
    """Time for which half of it keeps coming; then it ceases."""
    price: float = 0.0
    """Nats, beyond that of the cause and the onset."""
    wanders: float = 0.25
    """By how much its size may wander within 30 s, as a share: no change has exactly the shape of its row."""


def rows_of(model: Model) -> list[ChangeRow]:
    """All of one plant."""
    found: list[ChangeRow] = []
    for place, name in enumerate(model.structure.free):
        declared = model.declared[name]
        if declared.role == "losses":
            cause = Fault.LOSSES_CHANGED, place
            found += [ChangeRow(cause, name, *size, 0.4) for size in ((2.0, 2.0), (-0.7, 0.2))]
        elif declared.role == "room":
            cause = (Fault.ROOM_CHANGED, place)
            spread = 0.8 * declared.scale
            least = 0.3 * declared.scale
            found.append(ChangeRow(cause, name, 0.0, spread, least))
            found.append(ChangeRow(cause, name, 0.0, spread, least, 1800.0, price=RARE))
    for j, drive in enumerate(model.plant.drives.values()):
        cause = (Fault.DRIVE_WEAK, j)
        share = f"share {j}"
        push = 0.15 * (drive.limits[1] - drive.limits[0])
        found.append(ChangeRow((Fault.DRIVE_LOST, j), share, -1.0, 0.03, 0.5, wanders=0.05))
        found += [ChangeRow(cause, share, shift, 0.2, 0.1) for shift in (-0.35, 0.3)]
        found.append(ChangeRow(cause, share, 0.0, 0.3, 0.1, 300.0, price=RARE))
        found.append(ChangeRow((Fault.DRIFT, j), f"push {j}", 0.0, push, 0.1 * push, price=UNKNOWN))
    for i, output in enumerate(model.plant.outputs.values()):
        cause = (Fault.SENSOR_DRIFT, i)
        offset = f"offset {i}"
        noise = output.noise
        found.append(ChangeRow(cause, offset, 0.0, 30.0 * noise, 8.0 * noise, wanders=0.1))
        found.append(ChangeRow(cause, offset, 0.0, 30.0 * noise, 8.0 * noise, 300.0, price=RARE))
        cause = Fault.DISTURBANCE, i
        for sizes in ((0.0, 3.0 * noise, 0.5 * noise), (0.0, 12.0 * noise, 0.5 * noise)):
            found.append(ChangeRow(cause, f"fading {i}", *sizes, lasting=30.0))
    return found
