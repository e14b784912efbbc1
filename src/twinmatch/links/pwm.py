"""The PWM board on a serial line: its public interface.

`PwmLink` is the board. Below it are the frames (`pwm_frame`), the messages (`pwm_messages`), the host side of
the protocol (`pwm_protocol`) and the errors (`pwm_errors`, whose docstring shows their tree).
"""

from __future__ import annotations

from twinmatch.links.pwm_errors import (
    PwmCorruptReplyError,
    PwmLatchedError,
    PwmLinkError,
    PwmPortBusyError,
    PwmPortLostError,
    PwmPortMissingError,
    PwmRangeError,
    PwmRejectedError,
    PwmResetError,
    PwmStaleReplyError,
    PwmTimeoutError,
    PwmVersionError,
)
from twinmatch.links.pwm_link import AMPERES_PER_COUNT, Applied, PwmLink
from twinmatch.links.pwm_messages import PROTOCOL, Banner, Code, Flags
from twinmatch.links.pwm_port import LinkSettings

__all__ = [
    "AMPERES_PER_COUNT",
    "PROTOCOL",
    "Applied",
    "Banner",
    "Code",
    "Flags",
    "LinkSettings",
    "PwmCorruptReplyError",
    "PwmLatchedError",
    "PwmLink",
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
