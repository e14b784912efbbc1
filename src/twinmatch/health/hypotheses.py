"""What may happen to a plant with several signals, made from its file.

Every drive, every sensor and every parameter with a role has a row for each way in which it may change: at
once, slowly, or for a while.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from twinmatch.dynamics import Model
from twinmatch.health.faults import EVERY, Fault

PlacedFault = tuple[Fault, int]
"""A fault, and the place of the free parameter, drive or output that it concerns; of a `DRIFT`, the place of
the drive that something unknown acts like; `EVERY` for all drives at once."""

RARE: Final = 2.5
"""Price of what comes evenly over minutes, nats."""
LESS: Final = 0.15
"""Least share by which a drive does less than before: the share of a movement by which equations are wrong."""
MORE: Final = 0.4
"""Least share by which a drive does more than before: below, what the equations say of the exchange between
two loops is as likely to be wrong."""
CREEP: Final = 10.0
"""Expected size (1 σ) of what creeps within five minutes, in noises of the sensor: a degree of a kit, which is a
hundred times faster than sensors age."""
CREEPS: Final = 6.0
"""Price of a sensor whose reading creeps away within minutes, nats: sensors age over days, and a jump is a
loose contact; what creeps within minutes is nearly always the plant."""
GROWS: Final = 5.0
"""Price of a supply that gives more than before, nats: a supply sags; where it rises by a tenth, all heaters do by a
fifth."""
CROSSES: Final = 0.2
"""Share of what the other drives do that may cross in another way than the equations say, 1 σ: half of what
crosses in a kit whose heaters differ by a factor of two."""
MIXED: Final = 0.25
"""By how much a change wanders that is mixed with what the equations lack, as a share: the effect of one of several
drives, as a fifth of what the others do may cross in another way, and a reading that creeps."""
UNKNOWN: Final = 2.0
"""Price of something unknown that acts as a drive does, nats."""


class Explanation(NamedTuple):
    """What one or several rows stand for."""

    cause: PlacedFault
    crosses: bool
    """Whether it is nobody's fault: what acts like the drive comes from the other drives."""


@dataclass(frozen=True)
class ChangeRow:
    """One way in which one number may change; sizes in the number's unit, or as shares of what it was; times
    in s of a plant as fast as the rig."""

    cause: PlacedFault
    number: str
    """A parameter; or share, push, offset or fading, with the place of its drive or output."""
    shift: float = 0.0
    """Expected size."""
    spread: float = 0.0
    """Standard deviation of the size."""
    least: float = 0.0
    """Smallest size that is reported."""
    slowly: float = 0.0
    """Time in which a ramp covers its spread; 0: a jump."""
    lasting: float = 0.0
    """Time within which half of the change still arrives after its onset; 0: all of it at the onset."""
    price: float = 0.0
    """Nats that this row costs beyond those of its cause and its onset."""
    wanders: float = 0.1
    """By how much its size may wander about the one that lasts, as a share (1 σ): no change has exactly the shape of
    its row. It returns within 30 s."""
    is_relative: bool = False
    """Whether sizes are shares of what the number was, because it is tracked by its logarithm. To first order
    what a change does to the plant is in proportion to that share."""
    also: tuple[str, ...] = ()
    """Other numbers that change by the same."""
    is_end: bool = False
    """Whether it is the end of a change that was named; sizes are shares of the way back to what was before."""
    follows: tuple[float, ...] = ()
    """By how much the number follows each drive from its usual value, for a size of one; empty if it stays
    as it has changed."""

    @property
    def crosses(self) -> bool:
        """Whether it is what the equations lack of the exchange between the loops, which is nobody's fault."""
        return bool(self.follows)

    @property
    def is_of_plant(self) -> bool:
        """Whether it changes the plant, and not a sensor."""
        return self.cause[0] is not Fault.SENSOR_DRIFT

    @property
    def explanation(self) -> Explanation:
        """What it stands for."""
        return Explanation(self.cause, self.crosses)

    def cost_of_impossible(self, shift: float, error: float, believed: float) -> float:
        """What it costs a change of this size, ± `error`, that nothing acts less than not at all, nats; `believed`
        is the value of the number before it.

        With a prior that ends there, the evidence of a change is less by the part of its distribution that lies
        beyond, beside the part of the prior that does.
        """
        if self.is_end:
            return 0.0
        if self.is_relative:
            least = -1.0
        elif self.number.startswith("share"):
            least = -1.0 - believed
        else:
            return 0.0
        expected = least if self.cause[0] is Fault.DRIVE_LOST else self.shift
        before = _log_of_part_above(least, expected, self.spread)
        return max(before - _log_of_part_above(least, shift, error), 0.0)

    def remaining(self, shift: float, later: float) -> float:
        """What is left of a change after a later one of the same number."""
        if self.is_relative:
            return (1.0 + shift) * (1.0 + later) - 1.0
        return shift + later


def _log_of_part_above(least: float, mean: float, deviation: float) -> float:
    """Logarithm of the part of a normal distribution that lies above a value."""
    below = (least - mean) / deviation
    return math.log(max(0.5 * math.erfc(below / math.sqrt(2.0)), 1e-300))


def rows_of(model: Model) -> list[ChangeRow]:
    """The rows of one plant."""
    rows: list[ChangeRow] = []
    for place, name in enumerate(model.structure.free):
        declared = model.declared[name]
        if declared.role == "losses":
            rows += _rows_of_losses(place, name)
        elif declared.role == "room":
            rows += _rows_of_room(place, name, declared.scale)
    for j, drive in enumerate(model.plant.drives.values()):
        rows += _rows_of_drive(j, drive.limits[1] - drive.limits[0])
    if len(model.plant.drives) > 1:
        rows += _rows_of_supply(len(model.plant.drives))
        rows += _rows_of_crossing(model)
    for i, output in enumerate(model.plant.outputs.values()):
        rows += _rows_of_sensor(i, output.noise)
    return rows


def _rows_of_losses(place: int, name: str) -> Iterator[ChangeRow]:
    """Losses have become much larger, or half as large; by a factor of 1.5 at least."""
    cause = (Fault.LOSSES_CHANGED, place)
    larger = ChangeRow(cause, name, shift=2.0, spread=2.0, least=0.5, is_relative=True)
    yield larger
    yield replace(larger, shift=-0.5, spread=0.2, least=1.0 / 3.0)


def _rows_of_room(place: int, name: str, scale: float) -> Iterator[ChangeRow]:
    """The room has changed at once, or evenly over half an hour."""
    cause = (Fault.ROOM_CHANGED, place)
    spread = 0.8 * scale
    least = 0.3 * scale
    yield ChangeRow(cause, name, spread=spread, least=least)
    yield ChangeRow(cause, name, spread=spread, least=least, slowly=1800.0)


def _rows_of_drive(j: int, reach: float) -> Iterator[ChangeRow]:
    """The j-th drive is lost, does less or more, at once or slowly; or something else acts as it does.

    `reach` is the width of its range.
    """
    share = f"share {j}"
    yield ChangeRow((Fault.DRIVE_LOST, j), share, shift=-1.0, spread=0.03, least=0.5)
    weak = ChangeRow(
        (Fault.DRIVE_WEAK, j),
        share,
        shift=-0.35,
        spread=0.2,
        least=LESS,
        wanders=MIXED,
    )
    yield weak
    yield replace(weak, shift=0.3)
    yield replace(weak, shift=0.0, spread=0.3, slowly=300.0, price=RARE)
    push = 0.15 * reach
    least = 0.05 * reach
    yield ChangeRow(
        (Fault.DRIFT, j), f"push {j}", spread=push, least=least, price=UNKNOWN
    )


def _rows_of_supply(drives: int) -> Iterator[ChangeRow]:
    """What all drives share, such as their supply, is lost, or does less or more."""
    also = tuple(f"share {j}" for j in range(1, drives))
    yield ChangeRow(
        (Fault.DRIVE_LOST, EVERY),
        "share 0",
        also=also,
        shift=-1.0,
        spread=0.03,
        least=0.5,
    )
    weak = ChangeRow(
        (Fault.DRIVE_WEAK, EVERY),
        "share 0",
        also=also,
        shift=-0.35,
        spread=0.2,
        least=LESS,
    )
    yield weak
    yield replace(weak, shift=0.3, least=MORE, price=GROWS)


def _rows_of_crossing(model: Model) -> Iterator[ChangeRow]:
    """What the other drives do arrives where the j-th one acts, in another way than the equations say."""
    limits = [drive.limits for drive in model.plant.drives.values()]
    reaches = [high - low for low, high in limits]
    for j, reach in enumerate(reaches):
        follows = [reach / other for other in reaches]
        follows[j] = 0.0
        yield ChangeRow(
            (Fault.DRIFT, j),
            f"push {j}",
            spread=CROSSES,
            wanders=MIXED,
            follows=tuple(follows),
        )


def _rows_of_sensor(i: int, noise: float) -> Iterator[ChangeRow]:
    """The i-th reading has shifted, at once or slowly; or something that passes has moved its output."""
    drift = (Fault.SENSOR_DRIFT, i)
    offset = f"offset {i}"
    yield ChangeRow(drift, offset, spread=30.0 * noise, least=8.0 * noise)
    yield ChangeRow(
        drift,
        offset,
        spread=CREEP * noise,
        least=8.0 * noise,
        slowly=300.0,
        price=CREEPS,
        wanders=MIXED,
    )
    for spread in (3.0 * noise, 12.0 * noise):
        yield ChangeRow(
            (Fault.DISTURBANCE, i),
            f"fading {i}",
            spread=spread,
            least=noise,
            lasting=30.0,
        )
