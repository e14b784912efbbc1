"""Hypotheses about what has changed in a tracked plant, and the change that is reported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from twinmatch.dynamics.tracker import Tracker

__all__ = ["Change", "Hypothesis", "Kind", "hypotheses"]


class Kind(Enum):
    """What has changed."""

    LOSSES = "losses"
    ROOM = "room"
    DRIVE = "drive"
    SENSOR = "sensor"
    OTHER = "other"
    """Something else pushes the output."""


_LOSSES: Final = ((math.log(1 / 6), 0.8), (math.log(3.0), 0.6))
"""A fan that fails, a lid that opens: logarithm of the factor, and its spread."""
_ROOM: Final = 0.8
"""Spread of a change of the room, in the scale of the parameter."""
_SHARE: Final = 0.3
_OFFSET: Final = 30.0
"""Spread of an offset of the reading, in standard deviations of its noise."""
_PUSH: Final = 1.0
"""Spread of a push, in standard deviations of the noise per sample."""
_SLOW_TIME: Final = 300.0
"""Time in which a slow change covers its spread, s."""
_ROOM_TIME: Final = 1800.0
"""The same for the room, s: a failed fan warms the sink in minutes; the room never changes so fast."""
_RARE: Final = 2.5
"""Prior cost of a change that grows evenly over minutes, nats: fans fail at once and fail far more often, and
the sink's response to that looks much the same."""
_LEAST: Final = {Kind.LOSSES: 0.4, Kind.ROOM: 0.3, Kind.DRIVE: 0.08, Kind.SENSOR: 10.0, Kind.OTHER: 0.3}
"""Changes smaller than this, in the same units, are not reported."""


@dataclass(frozen=True)
class Hypothesis:
    """One number of a belief has changed."""

    kind: Kind
    index: int
    """Index of that number in the belief."""
    shift: float
    """Expected size of the change …"""
    spread: float
    """… and its standard deviation."""
    least: float
    """Smallest shift worth reporting."""
    parameter: str = ""
    """Its name, if it is a parameter."""
    price: float = 0.0
    """Prior cost, nats: higher for changes that are rarer than others."""
    slowly: float = 0.0
    """Time in which an even change covers its spread, s; 0: a sudden change."""


@dataclass(frozen=True)
class Change:
    """The change that explains the samples best."""

    hypothesis: Hypothesis
    gain: float
    """How much better it explains the readings since than no change does, in nats."""
    lead: float
    """The same compared with the best of all other kinds."""
    first: int
    """Sample at which it began."""
    before: float
    """Value of the number before, in the belief's units."""
    value: float
    """Its value now."""
    begun: bool
    """Whether it began at `first`; False if it may have been there from the start."""
    rivals: tuple[Kind, ...] = ()
    """The other kinds, best first …"""
    gains: tuple[float, ...] = ()
    """… and what each gains."""

    @property
    def shift(self) -> float:
        """By how much the number has changed."""
        return self.value - self.before


def hypotheses(tracker: Tracker, noise: float, period: float) -> Sequence[Hypothesis]:
    """The hypotheses for one plant: for parameters with a role in its file, and those of every plant."""
    found: list[Hypothesis] = []
    for name in tracker.free:
        declared = tracker.parameters.model.declared[name]
        logged = bool(tracker.logged[tracker.free.index(name)])
        if declared.role == Kind.LOSSES.value and logged:
            least = _LEAST[Kind.LOSSES]
            found += [Hypothesis(Kind.LOSSES, tracker.at[name], s, w, least, name) for s, w in _LOSSES]
        if declared.role == Kind.ROOM.value:
            scale = 0.05 if logged else declared.scale
            least = _LEAST[Kind.ROOM] * scale
            found.append(Hypothesis(Kind.ROOM, tracker.at[name], 0.0, _ROOM * scale, least, name))
    found += [replace(h, slowly=_ROOM_TIME, price=_RARE) for h in found if h.kind is Kind.ROOM]
    for kind, index, unit, spread in (
        (Kind.DRIVE, tracker.share, 1.0, _SHARE),
        (Kind.SENSOR, tracker.offset, noise, _OFFSET),
        (Kind.OTHER, tracker.push, noise / period, _PUSH),
    ):
        sudden = Hypothesis(kind, index, 0.0, spread * unit, _LEAST[kind] * unit)
        found += [sudden] if kind is Kind.OTHER else [sudden, replace(sudden, slowly=_SLOW_TIME, price=_RARE)]
    return found
