"""What may happen to a plant, made from its file: a row for every drive, sensor and role, and way to
begin."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from twinmatch.dynamics import Model
from twinmatch.health import Fault


class Kind(Enum):
    """What has changed."""

    LOSSES = Fault.LOSSES_CHANGED
    ROOM = Fault.ROOM_CHANGED
    DRIVE = Fault.DRIVE_WEAK
    LOST = Fault.DRIVE_LOST
    SENSOR = Fault.SENSOR_DRIFT
    FROZEN = Fault.SENSOR_FROZEN
    PASSING = Fault.DISTURBANCE
    OTHER = Fault.DRIFT
    """Something acts as a drive does."""


Cause = tuple[Kind, int]
"""A kind, and of which parameter, drive or output."""

RARE: Final = 2.5
"""Price of what comes evenly over minutes, nats."""
UNKNOWN: Final = 2.0
"""Price of what acts as a drive does, and is none."""


@dataclass(frozen=True)
class Row:
    """One way in which one number may change; sizes in the number's unit, times in s of a plant as fast as
    the rig."""

    cause: Cause
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
    """Time for which half of it keeps coming."""
    price: float = 0.0
    """Nats, beyond that of the cause and the onset."""
    wanders: float = 0.25
    """By how much its size may wander within 30 s, as a share: no change has exactly the shape of its row."""


def rows_of(model: Model) -> list[Row]:
    """All of one plant."""
    found: list[Row] = []
    plant, free = model.plant, model.structure.free
    for place, name in enumerate(free):
        declared = model.declared[name]
        if declared.role == "losses":
            cause = (Kind.LOSSES, place)
            found += [Row(cause, name, shift, spread, 0.4) for shift, spread in ((2.0, 2.0), (-0.7, 0.2))]
        elif declared.role == "room":
            room = Row((Kind.ROOM, place), name, 0.0, 0.8 * declared.scale, 0.3 * declared.scale)
            found += [room, Row(room.cause, name, 0.0, room.spread, room.least, 1800.0, price=RARE)]
    for j, drive in enumerate(plant.drives.values()):
        cause, share, push = (Kind.DRIVE, j), f"share {j}", 0.15 * (drive.limits[1] - drive.limits[0])
        found.append(Row((Kind.LOST, j), share, -1.0, 0.03, 0.5, wanders=0.05))
        found += [Row(cause, share, shift, 0.2, 0.1) for shift in (-0.35, 0.3)]
        found.append(Row(cause, share, 0.0, 0.3, 0.1, 300.0, price=RARE))
        found.append(Row((Kind.OTHER, j), f"push {j}", 0.0, push, 0.1 * push, price=UNKNOWN))
    for i, output in enumerate(plant.outputs.values()):
        cause, offset, noise = (Kind.SENSOR, i), f"offset {i}", output.noise
        found.append(Row(cause, offset, 0.0, 30.0 * noise, 8.0 * noise, wanders=0.1))
        found.append(Row(cause, offset, 0.0, 30.0 * noise, 8.0 * noise, 300.0, price=RARE))
        for spread in (3.0, 12.0):
            found.append(
                Row((Kind.PASSING, i), f"fading {i}", 0.0, spread * noise, 0.5 * noise, lasting=30.0)
            )
    return found
