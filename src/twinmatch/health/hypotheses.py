"""What may happen to a plant with several signals, made from its file: a row for every drive, sensor and
role, and way to begin."""

from __future__ import annotations

from collections.abc import Iterator
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
    """Expected size, of a logarithm relative to the number."""
    spread: float = 0.0
    """Standard deviation of the size."""
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
    rows: list[ChangeRow] = []
    for place, name in enumerate(model.structure.free):
        declared = model.declared[name]
        if declared.role == "losses":
            rows += _rows_of_losses(place, name)
        elif declared.role == "room":
            rows += _rows_of_room(place, name, declared.scale)
    for j, drive in enumerate(model.plant.drives.values()):
        rows += _rows_of_drive(j, drive.limits[1] - drive.limits[0])
    for i, output in enumerate(model.plant.outputs.values()):
        rows += _rows_of_sensor(i, output.noise)
    return rows


def _rows_of_losses(place: int, name: str) -> Iterator[ChangeRow]:
    """They have become much larger, or half as large: shift and spread of their logarithm."""
    for shift, spread in ((2.0, 2.0), (-0.7, 0.2)):
        yield ChangeRow((Fault.LOSSES_CHANGED, place), name, shift, spread, 0.4)


def _rows_of_room(place: int, name: str, scale: float) -> Iterator[ChangeRow]:
    """It has changed at once, or evenly over half an hour."""
    cause = (Fault.ROOM_CHANGED, place)
    spread = 0.8 * scale
    least = 0.3 * scale
    yield ChangeRow(cause, name, 0.0, spread, least)
    yield ChangeRow(cause, name, 0.0, spread, least, 1800.0, price=RARE)


def _rows_of_drive(j: int, reach: float) -> Iterator[ChangeRow]:
    """The j-th drive is lost, does less or more, at once or slowly; or something else acts as it does.

    `reach` is the width of its range.
    """
    share = f"share {j}"
    yield ChangeRow((Fault.DRIVE_LOST, j), share, -1.0, 0.03, 0.5, wanders=0.05)
    for shift in (-0.35, 0.3):
        yield ChangeRow((Fault.DRIVE_WEAK, j), share, shift, 0.2, 0.1)
    yield ChangeRow((Fault.DRIVE_WEAK, j), share, 0.0, 0.3, 0.1, 300.0, price=RARE)
    push = 0.15 * reach
    yield ChangeRow((Fault.DRIFT, j), f"push {j}", 0.0, push, 0.1 * push, price=UNKNOWN)


def _rows_of_sensor(i: int, noise: float) -> Iterator[ChangeRow]:
    """The i-th reading has shifted, at once or slowly; or something that passes has moved its output."""
    drift = (Fault.SENSOR_DRIFT, i)
    offset = f"offset {i}"
    yield ChangeRow(drift, offset, 0.0, 30.0 * noise, 8.0 * noise, wanders=0.1)
    yield ChangeRow(drift, offset, 0.0, 30.0 * noise, 8.0 * noise, 300.0, price=RARE)
    for spread in (3.0 * noise, 12.0 * noise):
        yield ChangeRow((Fault.DISTURBANCE, i), f"fading {i}", 0.0, spread, 0.5 * noise, lasting=30.0)
