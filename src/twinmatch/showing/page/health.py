"""The nodes of the graph and the health they report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from twinmatch.settings import Rule

OK, WARN, ERROR, STALE = range(4)
"""Levels of REP 107, as on /diagnostics."""


class _Silence(Rule):
    """Times of silence of a node, which reports every second, s."""

    patience: float = 4.0
    """From then on it counts as silent."""
    forget: float = 60.0
    """From then on it is forgotten."""


_SILENT: Final = _Silence()


MAX_NODES = 64
"""Most names kept; one graph does not have more nodes."""

_DIGITS = re.compile(r"[\d.,]+")
_SILENCE = re.compile(r"no sample for \d+ s(?:; )?")
"""What a node reports while it waits for samples; after the end of a replay that is as it should be."""


@dataclass(frozen=True)
class NodeReport:
    """A node's last report."""

    level: int
    message: str
    at: float
    """When it was received, in seconds of the receiver's clock."""


@dataclass(frozen=True)
class PlayerState:
    """State of a player: how far its session has been played."""

    name: str
    """Of the node, without its namespace."""
    paused: bool
    rate: float
    """Recorded seconds per second; 0: as fast as possible."""
    position: str
    """For example `12.0 s of 300.0 s`."""


def kind_of(error: str) -> str:
    """An error without its numbers: the same error with other numbers is of the same kind."""
    return _DIGITS.sub("", error)


@dataclass
class NodeReports:
    """The nodes that report on /diagnostics."""

    reports: dict[str, NodeReport] = field(default_factory=dict)
    player: PlayerState | None = None
    ended: PlayerState | None = None
    """The player that has reached the end of its session, until another session is seen."""
    ended_at: float = 0.0
    """When that report was received, or the newest sample since, in seconds of the receiver's clock."""
    _errors: dict[str, str] = field(default_factory=dict)
    """The error each node reports now, without its figures."""

    def push(
        self, name: str, level: int, message: str, values: Mapping[str, str], now: float
    ) -> str | None:
        """Take a report; returns `error` or `recovered` if the node's state changed, else None.

        An error in which only figures change is the same error.
        """
        if name not in self.reports and len(self.reports) >= MAX_NODES:
            return None
        self.reports[name] = NodeReport(level, message, now)
        if {"rate", "paused", "position"} <= values.keys():
            with suppress(ValueError):  # not a player of twinmatch
                played = (
                    values["paused"] == "True",
                    float(values["rate"]),
                    values["position"],
                )
                self._take_player(
                    PlayerState(name, *played), now, over=values.get("ended") == "True"
                )
        if level < ERROR:
            return None if self._errors.pop(name, None) is None else "recovered"
        kind = kind_of(message)
        if self._errors.get(name) == kind:
            return None
        self._errors[name] = kind
        return "error"

    def expire(self, now: float) -> None:
        """Forget nodes that have long been silent, unless a replay has ended.

        A player that falls silent counts as gone.
        """
        if self.ended is not None:
            return
        gone = [
            name
            for name, report in self.reports.items()
            if now - report.at > _SILENT.forget
        ]
        for name in gone:
            del self.reports[name]
            self._errors.pop(name, None)
        if self.player is not None and self.silent(self.player.name, now):
            place, _, whole = self.player.position.partition(" of ")
            # Its last report may have been lost: it had ended if nothing was left to play.
            self._take_player(self.player, now, over=place == whole)
            self.player = None

    def begin(self, now: float) -> None:
        """Note a sample, which ends the state "replay ended" unless it belongs to that replay.

        A page that is behind takes the last samples of a replay after the report of its end, without a pause
        between them, however long it needs for all of them.
        """
        if now - self.ended_at > _SILENT.patience:
            self.ended = None
        self.ended_at = now

    def at_rest(self, name: str) -> bool:
        """Whether a node is idle because the replay has ended; one that reports an error is not."""
        return self.ended is not None and self.reports[name].level < ERROR

    def message(self, name: str) -> str:
        """The last message of a node; once a replay has ended, without the missing samples."""
        message = self.reports[name].message
        return _SILENCE.sub("", message) if self.at_rest(name) else message

    def level(self, name: str, now: float) -> int:
        """A node's level of REP 107; a silent node is stale, unless a replay has ended."""
        if self.ended is None and self.silent(name, now):
            return STALE
        return min(self.reports[name].level, STALE)

    def _take_player(self, player: PlayerState, now: float, *, over: bool) -> None:
        """Keep a player as the one that plays, or, if its session is `over`, as the one that has ended."""
        if not over:
            self.player = player
            self.ended = None
        elif self.ended is None:
            self.player = None
            self.ended = player
            self.ended_at = now

    def silent(self, name: str, now: float) -> bool:
        """Whether a node has not reported for some seconds."""
        report = self.reports.get(name)
        return report is None or now - report.at > _SILENT.patience
