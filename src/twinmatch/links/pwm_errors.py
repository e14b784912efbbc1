"""What can go wrong between us and the PWM board, one class per remedy.

PwmLinkError                  a set-point could not be placed; nothing may be assumed about the output
├── PwmRangeError             a number the caller gave is out of range; nothing was sent
├── PwmPortMissingError       no such port, or no right to it: is the board plugged in
├── PwmPortBusyError          another program holds the port
├── PwmPortLostError          the port went away or was never opened: cable, board reset; reopen()
├── PwmTimeoutError           the port stands, but no answer came in time
├── PwmCorruptReplyError      answers came, but damaged, or not fitting the question
├── PwmStaleReplyError        only answers to earlier questions came
├── PwmRejectedError          the board refused: .code says why
│   └── PwmLatchedError       it has tripped and waits for clear(): .flags say what tripped it
├── PwmResetError             the board started anew in mid-session; clear() if that is no fault
└── PwmVersionError           the board speaks another version of the protocol

Every set-point is absolute, so sending one again is safe after any of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twinmatch.errors import TwinmatchError

if TYPE_CHECKING:
    from twinmatch.links.pwm_messages import Code, Flags

__all__ = [
    "PwmCorruptReplyError",
    "PwmLatchedError",
    "PwmLinkError",
    "PwmPortBusyError",
    "PwmPortLostError",
    "PwmPortMissingError",
    "PwmRangeError",
    "PwmRejectedError",
    "PwmResetError",
    "PwmStaleReplyError",
    "PwmTimeoutError",
    "PwmVersionError",
]


class PwmLinkError(TwinmatchError):
    """The PWM board could not be commanded."""


class PwmRangeError(PwmLinkError):
    """A set-point that is not finite or beyond ±255, or a setting out of its range."""


class PwmPortMissingError(PwmLinkError):
    """The serial port does not exist or may not be opened."""


class PwmPortBusyError(PwmLinkError):
    """The serial port is held by another program."""


class PwmPortLostError(PwmLinkError, ConnectionError):
    """The serial port is closed or vanished while open."""


class PwmTimeoutError(PwmLinkError, TimeoutError):
    """No answer in time."""


class PwmCorruptReplyError(PwmLinkError):
    """An answer whose check sum or content is wrong."""


class PwmStaleReplyError(PwmLinkError):
    """Answers came, but none to the question asked."""


class PwmRejectedError(PwmLinkError):
    """The board refused a request."""

    def __init__(self, message: str, code: Code) -> None:
        super().__init__(message)
        self.code = code


class PwmLatchedError(PwmRejectedError):
    """The board has tripped: output off until it is cleared."""

    def __init__(self, message: str, code: Code, flags: Flags) -> None:
        super().__init__(message, code)
        self.flags = flags


class PwmResetError(PwmLinkError):
    """The board restarted since it was cleared."""


class PwmVersionError(PwmLinkError):
    """The board speaks another version of the protocol."""
