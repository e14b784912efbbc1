"""What may have changed of a plant that is followed, and what is said of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from twinmatch.dynamics.tracker import Tracker

__all__ = ["Change", "Hypothesis", "Kind", "hypotheses"]


class Kind(Enum):
    """What a change is a change of."""

    LOSSES = "losses"
    ROOM = "room"
    DRIVE = "drive"
    SENSOR = "sensor"
    OTHER = "other"
    """Something pushes the output, and none of those."""


_LOSSES: Final = ((math.log(1 / 6), 0.8), (math.log(3.0), 0.6))
"""A fan that fails, a lid that opens: logarithm of the factor, and its spread."""
_ROOM: Final = 0.8
"""Spread of another room, in the scale of the parameter."""
_SHARE: Final = 0.3
_OFFSET: Final = 30.0
"""Spread of an offset of the reading, in noises."""
_PUSH: Final = 1.0
"""Spread of a push, in noises per sample."""
_SLOWLY: Final = 300.0
"""Time in which a slow change makes its spread, s."""
_ROOMS: Final = 1800.0
"""The same of a room, s: a fan that fails warms the sink in minutes, but no weather does the room."""
_RARE: Final = 2.5
"""Nats that a change which comes evenly over minutes costs beforehand: fans fail at once, and are far more
often what fails; what a sink then does looks much the same."""
_LEAST: Final = {Kind.LOSSES: 0.4, Kind.ROOM: 0.3, Kind.DRIVE: 0.08, Kind.SENSOR: 10.0, Kind.OTHER: 0.3}
"""Changes smaller than this, in the same units, nobody wants to hear of."""


@dataclass(frozen=True)
class Hypothesis:
    """One number of a belief has moved."""

    kind: Kind
    index: int
    """Of the number."""
    shift: float
    """By about so much …"""
    spread: float
    """… give or take this."""
    least: float
    """Shift from which on it is worth telling."""
    parameter: str = ""
    """Its name, if it is a parameter."""
    price: float = 0.0
    """Nats that it costs beforehand, because it is rarer than others."""
    slowly: float = 0.0
    """Time in which it would make its spread if it goes on evenly, s; 0: it came about at once."""


@dataclass(frozen=True)
class Change:
    """What the samples say has changed."""

    hypothesis: Hypothesis
    gain: float
    """By how much better it explains the readings since than no change does, in nats."""
    lead: float
    """The same against the best of all other kinds."""
    first: int
    """Sample at which it began."""
    before: float
    """What the number was before, as a belief has it."""
    value: float
    """What it is now."""
    begun: bool
    """Whether it began then; False if it may as well have been so all along."""
    rivals: tuple[Kind, ...] = ()
    """The other kinds, best first …"""
    gains: tuple[float, ...] = ()
    """… and what each gains."""

    @property
    def shift(self) -> float:
        """By how much the number has moved."""
        return self.value - self.before


def hypotheses(tracker: Tracker, noise: float, period: float) -> Sequence[Hypothesis]:
    """Of one plant: those its file gives a role to, and those of every plant."""
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
    found += [replace(h, slowly=_ROOMS, price=_RARE) for h in found if h.kind is Kind.ROOM]
    for kind, index, unit, spread in (
        (Kind.DRIVE, tracker.share, 1.0, _SHARE),
        (Kind.SENSOR, tracker.offset, noise, _OFFSET),
        (Kind.OTHER, tracker.push, noise / period, _PUSH),
    ):
        sudden = Hypothesis(kind, index, 0.0, spread * unit, _LEAST[kind] * unit)
        found += [sudden] if kind is Kind.OTHER else [sudden, replace(sudden, slowly=_SLOWLY, price=_RARE)]
    return found
