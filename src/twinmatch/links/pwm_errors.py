"""Errors of the link to the PWM board, one class per remedy.

PwmLinkError                  a command could not be delivered; the state of the output is unknown
├── PwmRangeError             an argument is out of range; nothing was sent
├── PwmPortMissingError       no such port, or no permission: is the board plugged in
├── PwmPortBusyError          another program holds the port
├── PwmPortLostError          the port vanished or was never opened: cable, board reset; reopen()
├── PwmTimeoutError           the port is open, but no answer arrived in time
├── PwmCorruptReplyError      answers arrived, but damaged, or not matching the request
├── PwmStaleReplyError        only answers to earlier requests arrived
├── PwmRejectedError          the board refused: .code is the reason
│   └── PwmLatchedError       it has tripped and waits for clear(): .flags show the cause
├── PwmResetError             the board restarted in mid-session; clear() if that was expected
└── PwmVersionError           the board has another version of the protocol

Every command is absolute, so it is safe to send it again after any of them.
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
    """A command is not finite or outside ±255, or a setting is out of range."""


class PwmPortMissingError(PwmLinkError):
    """The serial port does not exist or may not be opened."""


class PwmPortBusyError(PwmLinkError):
    """The serial port is held by another program."""


class PwmPortLostError(PwmLinkError, ConnectionError):
    """The serial port is closed or vanished."""


class PwmTimeoutError(PwmLinkError, TimeoutError):
    """No answer in time."""


class PwmCorruptReplyError(PwmLinkError):
    """An answer has a wrong checksum or invalid content."""


class PwmStaleReplyError(PwmLinkError):
    """Answers arrived, but none to this request."""


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
    """The board has another version of the protocol."""
