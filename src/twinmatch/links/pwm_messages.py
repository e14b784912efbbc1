"""Requests to the PWM board and its replies, each with exactly one spelling.

| request | reply |
|---|---|
| `H seq` starts a session, output to zero | `B seq firmware protocol mcusr deadline_ms restarts` |
| `P seq pwm` sets the output | `S seq time_ms applied adc flags` |
| `Q seq` queries the state | `S …` |
| `C seq` clears a trip | `S …` |

The reply to a refused request is `E seq code`, with `-` for seq if the request was too damaged to read it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum, IntFlag

__all__ = [
    "PROTOCOL",
    "PWM_LIMIT",
    "SEQUENCES",
    "Banner",
    "Code",
    "Flags",
    "Refusal",
    "Reply",
    "Request",
    "Status",
    "Verb",
    "is_newer",
    "parse_reply",
    "parse_request",
]

PROTOCOL = 1
"""Version of the protocol; the board reports its own in the banner."""

PWM_LIMIT = 255.0
"""Largest magnitude of a command; its sign is the direction, positive heats the plate."""

SEQUENCES = 65536
"""Sequence numbers run from 0 to 65535 and wrap."""

_NUMBER = r"(0|[1-9]\d*)"
_SIGNED = r"(0|-?[1-9]\d{0,4})"
_ANY_REQUEST = re.compile(rf"(.) {_NUMBER}(?: .*)?", re.ASCII)
_SET = re.compile(rf"P {_NUMBER} {_SIGNED}", re.ASCII)
_PLAIN = re.compile(rf"[HQC] {_NUMBER}", re.ASCII)
_BANNER = re.compile(rf"B {_NUMBER} (\S+) {_NUMBER} {_NUMBER} {_NUMBER} {_NUMBER}", re.ASCII)
_FOREIGN = re.compile(rf"B {_NUMBER} (\S+) {_NUMBER}(?: .*)?", re.ASCII)  # common to all versions
_STATUS = re.compile(rf"S {_NUMBER} {_NUMBER} {_SIGNED} {_NUMBER} {_NUMBER}", re.ASCII)
_REFUSAL = re.compile(rf"E (-|{_NUMBER}) ([A-Z_]+)", re.ASCII)


class Verb(Enum):
    """Requests of the host."""

    HELLO = "H"
    SET = "P"
    QUERY = "Q"
    CLEAR = "C"


class Code(Enum):
    """Reasons of a refusal."""

    CRC = "CRC"
    SYNTAX = "SYNTAX"
    UNKNOWN = "UNKNOWN"
    RANGE = "RANGE"
    LATCHED = "LATCHED"
    TOO_LONG = "TOO_LONG"


class Flags(IntFlag):
    """State of the board's output."""

    NONE = 0
    ENABLED = 0x01
    """The driver is enabled."""
    TRIPPED = 0x02
    """The output is off until it is cleared; one of the next three is the cause."""
    DEADLINE = 0x04
    """No command within the deadline."""
    DRIVER = 0x08
    """The driver reported a fault."""
    RESET = 0x10
    """The board restarted since it was last cleared."""
    DUPLICATE = 0x20
    """The request repeats one already answered; it had no effect."""


@dataclass(frozen=True, slots=True)
class Request:
    """A request. `pwm`, −255 to 255, belongs to `Verb.SET` only."""

    verb: Verb
    sequence: int
    pwm: int = 0

    def __str__(self) -> str:
        """Its payload."""
        value = f" {self.pwm}" if self.verb is Verb.SET else ""
        return f"{self.verb.value} {self.sequence}{value}"


@dataclass(frozen=True, slots=True)
class Banner:
    """The board's description of itself."""

    sequence: int
    firmware: str
    protocol: int
    reset_flags: int
    """The MCUSR register at start; 0 if a boot loader has cleared it."""
    deadline_ms: int
    """Time without a command after which the output trips."""
    restarts: int
    """Starts since power-up, modulo 65536."""

    def __str__(self) -> str:
        """Its payload."""
        return (
            f"B {self.sequence} {self.firmware} {self.protocol} {self.reset_flags} "
            f"{self.deadline_ms} {self.restarts}"
        )


@dataclass(frozen=True, slots=True)
class Status:
    """The board's report of its output."""

    sequence: int
    time_ms: int
    """Milliseconds since the board started, modulo 2³²."""
    applied: int
    """PWM on the pins, −255 to 255."""
    adc: int
    """Current feedback, 0 to 1023 counts."""
    flags: Flags

    def __str__(self) -> str:
        """Its payload."""
        return f"S {self.sequence} {self.time_ms} {self.applied} {self.adc} {int(self.flags)}"


@dataclass(frozen=True, slots=True)
class Refusal:
    """A refused request. `sequence` is None if the request was too damaged to read it."""

    sequence: int | None
    code: Code

    def __str__(self) -> str:
        """Its payload."""
        return f"E {'-' if self.sequence is None else self.sequence} {self.code.value}"


Reply = Banner | Status | Refusal


def is_newer(sequence: int, last: int) -> bool:
    """Whether `sequence` comes after `last`, counting modulo 65536."""
    return 1 <= (sequence - last) % SEQUENCES < SEQUENCES // 2


def parse_request(payload: bytes) -> Request | Refusal:
    """Parse a request as the board does; a refusal is what the board would answer."""
    text = payload.decode("latin-1")
    outline = _ANY_REQUEST.fullmatch(text)
    if outline is None or int(outline[2]) >= SEQUENCES:
        return Refusal(None, Code.SYNTAX)
    sequence = int(outline[2])
    if outline[1] not in {verb.value for verb in Verb}:
        return Refusal(sequence, Code.UNKNOWN)
    if _PLAIN.fullmatch(text):
        return Request(Verb(text[0]), sequence)
    match = _SET.fullmatch(text)
    if match is None:
        return Refusal(sequence, Code.SYNTAX)
    pwm = int(match[2])
    return Request(Verb.SET, sequence, pwm) if abs(pwm) <= PWM_LIMIT else Refusal(sequence, Code.RANGE)


def parse_reply(payload: bytes) -> Reply | None:
    """Parse a reply of the board; None if it is not exactly one valid reply.

    From a banner of another protocol version, only firmware and protocol are read.
    """
    text = payload.decode("latin-1")
    if match := _STATUS.fullmatch(text):
        sequence, time_ms, applied, adc, flags = map(int, match.groups())
        return _checked(sequence, Status(sequence, time_ms, applied, adc, Flags(flags)))
    if match := _BANNER.fullmatch(text):
        sequence, protocol, reset_flags, deadline, restarts = (int(match[i]) for i in (1, 3, 4, 5, 6))
        return _checked(sequence, Banner(sequence, match[2], protocol, reset_flags, deadline, restarts))
    if (match := _FOREIGN.fullmatch(text)) and int(match[3]) != PROTOCOL:
        return _checked(int(match[1]), Banner(int(match[1]), match[2], int(match[3]), 0, 0, 0))
    if (match := _REFUSAL.fullmatch(text)) and match[3] in Code.__members__:
        numbered = None if match[1] == "-" else int(match[1])
        return _checked(numbered or 0, Refusal(numbered, Code(match[3])))
    return None


def _checked(sequence: int, reply: Reply) -> Reply | None:
    plausible = sequence < SEQUENCES
    if isinstance(reply, Status):
        plausible = plausible and abs(reply.applied) <= PWM_LIMIT and reply.adc <= 1023
        plausible = plausible and reply.time_ms < 2**32 and int(reply.flags) <= 0xFF
    return reply if plausible else None
