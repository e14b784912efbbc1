"""Which nodes there are, and how they say they are."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["ERROR", "PATIENCE", "Player", "Roster", "Standing"]

OK, WARN, ERROR, STALE = range(4)
"""Levels of REP 107, as on /diagnostics."""
PATIENCE = 4.0
"""Seconds without a report after which a node counts as silent; they report every second."""
FORGET = 60.0
"""Seconds after which a silent node is forgotten."""
MOST = 64
"""Names that are kept; more would not be nodes of one graph."""

_DIGITS = re.compile(r"[\d.,]+")
_SILENCE = re.compile(r"no sample for \d+ s(?:; )?")
"""What a node reports while it waits for samples; after the end of a replay that is as it should be."""


@dataclass(frozen=True)
class Standing:
    """What a node said last."""

    level: int
    message: str
    at: float
    """When, in seconds of the listener's clock."""


@dataclass(frozen=True)
class Player:
    """Where a session that is played stands."""

    name: str
    """Of the node, without its namespace."""
    paused: bool
    rate: float
    """Recorded seconds per second; 0: as fast as it goes."""
    position: str
    """Such as `12.0 s of 300.0 s`."""


@dataclass
class Roster:
    """The nodes that report on /diagnostics."""

    standing: dict[str, Standing] = field(default_factory=dict)
    player: Player | None = None
    ended: Player | None = None
    """Who has played a session to its end, until something else is heard."""
    ended_at: float = 0.0
    _told: dict[str, str] = field(default_factory=dict)

    def push(self, name: str, level: int, message: str, values: Mapping[str, str], now: float) -> str | None:
        """Take a report; returns `error` or `well` if it is another than before, else None.

        An error whose figures alone change is the same error.
        """
        if name not in self.standing and len(self.standing) >= MOST:
            return None
        self.standing[name] = Standing(level, message, now)
        if {"rate", "paused", "position"} <= values.keys():
            self._hear_player(_player(name, values), now, over=values.get("ended") == "True")
        if level < ERROR:
            return None if self._told.pop(name, None) is None else "well"
        kind = _DIGITS.sub("", message)
        if self._told.get(name) == kind:
            return None
        self._told[name] = kind
        return "error"

    def look(self, now: float) -> None:
        """Forget who has been silent for long, unless all fell silent at a session's end.

        A player that fell silent has gone.
        """
        if self.ended is not None:
            return
        for name in [n for n, s in self.standing.items() if now - s.at > FORGET]:
            del self.standing[name]
            self._told.pop(name, None)
        if self.player is not None and self.silent(self.player.name, now):
            self._hear_player(self.player, now, over=_at_its_end(self.player))
            self.player = None

    def begin(self, now: float) -> None:
        """Take note that a sample has come: what had ended is past, unless it was still on its way."""
        if self.ended is not None and now - self.ended_at > PATIENCE:
            self.ended = None

    def at_rest(self, name: str) -> bool:
        """Whether a node has nothing more to do since the replay ended: only an error may be its own."""
        return self.ended is not None and self.standing[name].level < ERROR

    def message(self, name: str) -> str:
        """The last message of a node; once a replay has ended, without the missing samples."""
        said = self.standing[name].message
        return _SILENCE.sub("", said) if self.at_rest(name) else said

    def level(self, name: str, now: float) -> int:
        """How a node is, in the levels of REP 107; one that is silent is stale, unless a replay has ended."""
        if self.ended is None and self.silent(name, now):
            return STALE
        return min(self.standing[name].level, STALE)

    def _hear_player(self, player: Player | None, now: float, *, over: bool) -> None:
        if not over:
            self.player, self.ended = player, None
        elif self.ended is None:
            self.player, self.ended, self.ended_at = None, player, now

    def silent(self, name: str, now: float) -> bool:
        """Whether a node has not reported for longer than it should."""
        found = self.standing.get(name)
        return found is None or now - found.at > PATIENCE


def _at_its_end(player: Player) -> bool:
    """Whether nothing was left to play; the last word of a player may get lost."""
    place, _, whole = player.position.partition(" of ")
    return place == whole


def _player(name: str, values: Mapping[str, str]) -> Player | None:
    try:
        rate = float(values["rate"])
    except ValueError:  # not one of ours
        return None
    return Player(name, values["paused"] == "True", rate, values["position"])
