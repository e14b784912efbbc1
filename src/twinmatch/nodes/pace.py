"""When a recorded message is due, for a player that can be paused."""

from __future__ import annotations

__all__ = ["Pace"]


class Pace:
    """Maps recorded time onto the player's time; all times in seconds.

    The time is passed in and no clock is read, so it can be tested without waiting.
    """

    def __init__(self, rate: float, start: float) -> None:
        """`rate` is recorded seconds per second (0: as fast as possible), `start` the first recorded time."""
        self._rate = rate
        self._recorded = start  # recorded time reached at `_since`
        self._since: float | None = None  # the listener's time then; None while paused

    @property
    def paused(self) -> bool:
        """Whether playback is paused; it is until the first `resume`."""
        return self._since is None

    def resume(self, now: float) -> None:
        """Continue from the current position."""
        if self._since is None:
            self._since = now

    def pause(self, now: float) -> None:
        """Pause at the current position."""
        self._recorded = self.position(now)
        self._since = None

    @property
    def rate(self) -> float:
        """Recorded seconds per second; 0: as fast as possible."""
        return self._rate

    def change(self, rate: float, now: float) -> None:
        """Continue at another rate from the current position."""
        self._recorded = self.position(now)
        self._since = None if self._since is None else now
        self._rate = rate

    def reach(self, recorded: float, now: float) -> None:
        """Note that a message of this recorded time was played; at rate 0 this is the only progress."""
        if self._rate == 0:
            self._recorded = max(self._recorded, recorded)
            self._since = None if self._since is None else now

    def position(self, now: float) -> float:
        """Recorded time that has been reached."""
        if self._since is None:
            return self._recorded
        return self._recorded + (now - self._since) * self._rate

    def wait(self, recorded: float, now: float) -> float | None:
        """Seconds until a message of this recorded time is due; None while paused."""
        if self._since is None:
            return None
        if self._rate == 0:
            return 0.0
        return max(0.0, (recorded - self.position(now)) / self._rate)
