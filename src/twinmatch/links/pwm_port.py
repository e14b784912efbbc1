"""The serial port of a PWM link: opening it, and the errors it raises."""

from __future__ import annotations

import errno
import math
import termios
from dataclasses import dataclass

import serial

from twinmatch.links.pwm_errors import PwmPortBusyError, PwmPortMissingError, PwmRangeError

__all__ = ["BAUD_RATE", "WIRE_ERRORS", "LinkSettings", "open_port"]

BAUD_RATE = 115_200
"""Not configurable: USB ignores it, except for 1200, which starts the boot loader of a Leonardo."""

WIRE_ERRORS = (OSError, termios.error)
"""Errors raised by pyserial when a port vanishes; its own SerialException is an OSError."""


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Timeouts and retries of a link.

    Raises:
        PwmRangeError: a time is not positive, or `retries` is negative.
    """

    timeout: float = 0.2
    """Longest wait for a reply, s. With all retries it must stay below the board's deadline."""
    retries: int = 2
    """Retries of an unanswered request."""
    first_pause: float = 0.1
    """Pause before the second attempt to reopen a lost port, s; doubled each time."""
    longest_pause: float = 2.0
    """Longest pause between two such attempts, s."""

    def __post_init__(self) -> None:
        for name in ("timeout", "first_pause", "longest_pause"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                msg = f"PWM link: {name} is {value} s; it must be positive"
                raise PwmRangeError(msg)
        if self.retries < 0:
            msg = f"PWM link: retries is {self.retries}; it must be 0 or more"
            raise PwmRangeError(msg)


def open_port(port: str, timeout: float) -> serial.Serial:
    """Open a port exclusively, with an empty input buffer.

    pyserial raises DTR and RTS, and tolerates ports without them, such as pseudo-terminals.

    Raises:
        PwmPortBusyError: another program holds it.
        PwmPortMissingError: it cannot be opened.
    """
    try:
        wire = serial.Serial(port, BAUD_RATE, timeout=timeout, write_timeout=timeout, exclusive=True)
        wire.reset_input_buffer()
    except (*WIRE_ERRORS, ValueError) as error:
        if _is_busy(error):
            msg = f"PWM link: another program holds {port}; end it first"
            raise PwmPortBusyError(msg) from error
        msg = f"PWM link: {port} cannot be opened ({error}); check the cable and your access to the port"
        raise PwmPortMissingError(msg) from error
    return wire


def _is_busy(error: Exception) -> bool:
    return getattr(error, "errno", None) in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(error)
