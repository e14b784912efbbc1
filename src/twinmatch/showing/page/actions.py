"""Actions that the page offers; the node carries them out and reports with `DashboardState.notify`."""

from __future__ import annotations

from typing import Protocol

__all__ = ["RATES", "Actions"]

RATES = (1.0, 10.0, 50.0, 200.0, 0.0)
"""Speeds on the page, recorded seconds per second; 0: as fast as possible."""


class Actions(Protocol):
    """The actions; each may be called from any thread and returns at once."""

    @property
    def control(self) -> bool:
        """Whether the page may set the set-point, clear faults and stop."""

    def pause(self, paused: bool) -> None:
        """Pause the player of a session, or continue."""

    def rate(self, rate: float) -> None:
        """Set its speed in recorded seconds per second; 0: as fast as possible."""

    def what_if(self, level: float, hold: float | None) -> None:
        """Ask for a forecast with the set-point at a level, and back after a time (s; None: it stays)."""

    def set_point(self, level: float) -> None:
        """Send the controller a set-point."""

    def clear_fault(self) -> None:
        """Allow the output to be driven again after a fault."""

    def stop(self) -> None:
        """Hold the output at zero."""
