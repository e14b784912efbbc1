"""The interface between an emulated PWM board and an emulated plant."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from twinmatch.errors import TwinmatchError

__all__ = ["ArduinoError", "Board", "PinDrive"]


class ArduinoError(TwinmatchError):
    """An emulated board cannot be created or does not answer."""


class PinDrive(NamedTuple):
    """State of the driver's pins."""

    time: float
    """Board time since construction, s; restarts of the firmware do not reset it."""
    pwm: float
    """Averaged drive, −255 to 255; positive heats. Zero while the driver is off."""
    enabled: bool
    """Whether the driver is on. On with zero PWM it shorts the plate; off it leaves the circuit open."""


class Board(Protocol):
    """An emulated Arduino at the end of a pseudo-terminal.

    Its time stands still until `advance` (lockstep) or `run` is called.
    """

    port: str
    """Path of the serial port; it vanishes and returns with the cable."""

    def advance(self, seconds: float) -> PinDrive:
        """Advance by this time, rounded to ms, and return the drive at the end."""

    def run(self, speed: float = 1.0) -> None:
        """Run `speed` times as fast as the wall clock, without jumps."""

    def pause(self) -> None:
        """Stop running."""

    def drive(self) -> PinDrive:
        """The drive now."""

    def set_current(self, amperes: float) -> None:
        """Set the current on the driver's feedback pin, A, averaged over the PWM."""

    def set_fault(self, fault: bool) -> None:
        """Set or release the driver's fault flag."""

    def unplug(self) -> None:
        """Unplug the USB cable; the board keeps its power."""

    def plug(self) -> None:
        """Plug the USB cable in again."""

    def hang(self) -> None:
        """Let the firmware hang with interrupts off; only the watchdog ends that."""

    def close(self) -> None:
        """End the board."""
