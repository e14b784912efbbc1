"""What may be asked for on the page; the node does it, and `DashboardState.tell` says what became of it."""

from __future__ import annotations

from typing import Protocol

__all__ = ["RATES", "Actions"]

RATES = (1.0, 10.0, 50.0, 200.0, 0.0)
"""Speeds on the page, recorded seconds per second; 0: as fast as it goes."""


class Actions(Protocol):
    """May be called from any thread and returns at once."""

    @property
    def control(self) -> bool:
        """Whether set-point, stop and clearing a fault may be asked for."""

    def pause(self, paused: bool) -> None:
        """Let the player of a session stand still, or go on."""

    def rate(self, rate: float) -> None:
        """Let it play so many recorded seconds per second; 0: as fast as it goes."""

    def what_if(self, level: float, hold: float | None) -> None:
        """Ask what comes if the set-point goes to a level, and back after a time (s; None: it stays)."""

    def set_point(self, level: float) -> None:
        """Ask the controller for a set-point."""

    def clear_fault(self) -> None:
        """Let the output be driven again after a fault."""

    def stop(self) -> None:
        """Hold the output at zero."""
