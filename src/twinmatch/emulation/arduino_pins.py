"""What an emulated PWM board shows to an emulated plant, whoever plays the board."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from twinmatch.errors import TwinmatchError

__all__ = ["ArduinoError", "Board", "Drive"]


class ArduinoError(TwinmatchError):
    """An emulated board that cannot be made or does not answer."""


class Drive(NamedTuple):
    """What the driver's pins do."""

    time: float
    """Seconds of the board's time since it was made; restarts of the firmware do not set it back."""
    pwm: float
    """Averaged drive, −255 to 255; positive heats. Zero while the driver is off."""
    enabled: bool
    """Whether the driver is on. On with zero PWM it shorts the plate, off it lets it coast."""


class Board(Protocol):
    """An emulated Arduino at the end of a pseudo-terminal.

    It stands still until it is told to `advance` by some time (lockstep) or to `run` by itself.
    """

    port: str
    """Path of the serial port; it vanishes and comes back with the cable."""

    def advance(self, seconds: float) -> Drive:
        """Let time pass, to the millisecond, and give the drive at the end."""

    def run(self, speed: float = 1.0) -> None:
        """Let time pass by itself, `speed` times as fast as the wall clock, but never by leaps."""

    def pause(self) -> None:
        """Stand still again."""

    def drive(self) -> Drive:
        """The drive now."""

    def set_current(self, amperes: float) -> None:
        """Say what current the driver's feedback pin shows, A, averaged over the PWM."""

    def set_fault(self, fault: bool) -> None:
        """Pull the driver's fault flag, or let go of it."""

    def unplug(self) -> None:
        """Pull the USB cable, the board still having its power."""

    def plug(self) -> None:
        """Put the USB cable back."""

    def hang(self) -> None:
        """Let the firmware run astray with interrupts off; only the watchdog can help it."""

    def close(self) -> None:
        """End the board."""
