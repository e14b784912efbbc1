"""The protocol of the PWM board: frames, messages, and the host's side of it, without a port or a clock.

A frame is one line of ASCII, `:` payload `*` CRC `\n` with the CRC as four upper-case hex digits: readable in
a serial monitor, with damage detected by the CRC. The firmware's `frame.cpp` follows the same rules, byte for
byte. Each message has exactly one spelling:

| request | reply |
|---|---|
| `H seq` starts a session, output to zero | `B seq firmware protocol mcusr deadline_ms restarts` |
| `P seq pwm` sets the output | `S seq time_ms applied adc flags` |
| `Q seq` queries the state | `S …` |
| `C seq` clears a trip | `S …` |

The reply to a refused request is `E seq code`, with `-` for seq if the request was too damaged to read it.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import dataclass
from enum import Enum, IntFlag

MAX_PAYLOAD = 40
"""Most characters between `:` and `*`."""

_TAIL = 5  # '*' and four hex digits
_ROOM = MAX_PAYLOAD + _TAIL + 1  # and a '\r', as serial monitors send


class Damage(Enum):
    """Why a line that starts like a frame is invalid."""

    CHECKSUM = "CRC"
    """Its CRC is wrong or missing."""
    LENGTH = "TOO_LONG"
    """It is longer than any frame."""


def crc16(payload: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected; 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(payload, 0xFFFF)


def seal(payload: str) -> bytes:
    """The line that carries `payload`.

    Raises:
        ValueError: the payload is too long, or contains a reserved character.
    """
    body = payload.encode("ascii")
    if not 1 <= len(body) <= MAX_PAYLOAD or ":" in payload or not payload.isprintable():
        rule = f"give 1 to {MAX_PAYLOAD} printable ASCII characters other than ':'"
        raise ValueError(f"frame: {payload!r} cannot be sent; {rule}")
    return b":%b*%04X\n" % (body, crc16(body))


class FrameReader:
    """Finds frames in a stream of bytes.

    Bytes outside `:` … `\\n` are skipped, and a `:` inside a frame starts a new one, so a lost line end costs
    one frame.
    """

    def __init__(self) -> None:
        self._line: bytearray | None = None
        self._overflow = False

    def feed(self, data: bytes) -> list[bytes | Damage]:
        """Take received bytes; return the payloads and damages they complete, in order."""
        events = []
        for byte in data:
            if (event := self._take(byte)) is not None:
                events.append(event)
        return events

    def _take(self, byte: int) -> bytes | Damage | None:
        if byte == ord(":"):
            self._line = bytearray()
            self._overflow = False
            return None
        if self._line is None:
            return None
        if byte == ord("\n"):
            line = bytes(self._line)
            self._line = None
            return Damage.LENGTH if self._overflow else _open(line)
        if len(self._line) >= _ROOM:
            self._overflow = True
        else:
            self._line.append(byte)
        return None


def _open(line: bytes) -> bytes | Damage:
    line = line[:-1] if line.endswith(b"\r") else line
    payload = line[:-_TAIL]
    tail = line[-_TAIL:]
    if (
        not payload
        or not tail.startswith(b"*")
        or not all(0x20 <= byte <= 0x7E for byte in payload)
    ):
        return Damage.CHECKSUM
    if len(payload) > MAX_PAYLOAD:
        return Damage.LENGTH
    # Compared as text, so that a lower-case digit is damage too.
    return payload if tail[1:] == b"%04X" % crc16(payload) else Damage.CHECKSUM


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
_BANNER = re.compile(
    rf"B {_NUMBER} (\S+) {_NUMBER} {_NUMBER} {_NUMBER} {_NUMBER}", re.ASCII
)
# common to all versions
_FOREIGN = re.compile(rf"B {_NUMBER} (\S+) {_NUMBER}(?: .*)?", re.ASCII)
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
    """The output is off until it is cleared; `DEADLINE`, `DRIVER`, `RESET` or `BUDGET` is the cause."""
    DEADLINE = 0x04
    """No command within the deadline."""
    DRIVER = 0x08
    """The driver reported a fault."""
    RESET = 0x10
    """The board restarted since it was last cleared."""
    DUPLICATE = 0x20
    """The request repeats one already answered; it had no effect."""
    BUDGET = 0x40
    """The drive was high for longer than a plant needs; a clear counts only after a rest."""


@dataclass(frozen=True, slots=True)
class Request:
    """A request, as text its payload. `pwm`, −255 to 255, belongs to `Verb.SET` only."""

    verb: Verb
    sequence: int
    pwm: int = 0

    def __str__(self) -> str:
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
        return (
            f"B {self.sequence} {self.firmware} {self.protocol} {self.reset_flags} "
            f"{self.deadline_ms} {self.restarts}"
        )


@dataclass(frozen=True, slots=True)
class BoardStatus:
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
        return f"S {self.sequence} {self.time_ms} {self.applied} {self.adc} {int(self.flags)}"


@dataclass(frozen=True, slots=True)
class Refusal:
    """A refused request. `sequence` is None if the request was too damaged to read it."""

    sequence: int | None
    code: Code

    def __str__(self) -> str:
        return f"E {'-' if self.sequence is None else self.sequence} {self.code.value}"


Reply = Banner | BoardStatus | Refusal


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
    return (
        Request(Verb.SET, sequence, pwm)
        if abs(pwm) <= PWM_LIMIT
        else Refusal(sequence, Code.RANGE)
    )


def parse_reply(payload: bytes) -> Reply | None:
    """Parse a reply of the board; None if it is not exactly one valid reply.

    From a banner of another protocol version, only firmware and protocol are read.
    """
    text = payload.decode("latin-1")
    if match := _STATUS.fullmatch(text):
        sequence, time_ms, applied, adc, flags = map(int, match.groups())
        return _check(
            sequence, BoardStatus(sequence, time_ms, applied, adc, Flags(flags))
        )
    if match := _BANNER.fullmatch(text):
        sequence = int(match[1])
        protocol, reset_flags, deadline, restarts = map(int, match.groups()[2:])
        return _check(
            sequence,
            Banner(sequence, match[2], protocol, reset_flags, deadline, restarts),
        )
    if match := _FOREIGN.fullmatch(text):
        sequence = int(match[1])
        protocol = int(match[3])
        if protocol != PROTOCOL:
            return _check(sequence, Banner(sequence, match[2], protocol, 0, 0, 0))
    if match := _REFUSAL.fullmatch(text):
        numbered = None if match[1] == "-" else int(match[1])
        if match[3] in Code.__members__:
            return _check(numbered or 0, Refusal(numbered, Code(match[3])))
    return None


def _check(sequence: int, reply: Reply) -> Reply | None:
    plausible = sequence < SEQUENCES
    if isinstance(reply, BoardStatus):
        plausible = plausible and abs(reply.applied) <= PWM_LIMIT and reply.adc <= 1023
        plausible = plausible and reply.time_ms < 2**32 and int(reply.flags) <= 0xFF
    return reply if plausible else None


class Conversation:
    """Numbers requests and finds their replies in the received bytes.

    `first` is the sequence number of the first request. A random one for every session prevents late replies
    to an earlier session from being accepted.
    """

    def __init__(self, first: int = 0) -> None:
        self._reader = FrameReader()
        self._next = first % SEQUENCES
        self._request: Request | None = None
        self.damaged = 0
        """Damaged or mismatched replies since this request was sent."""
        self.stale = 0
        """Replies to earlier requests since this one was sent."""
        self.spoiled = False
        """Whether waiting longer is useless because the request or its reply was damaged."""
        self.refused_line: Refusal | None = None
        """The board's report that it could not read the request, since this was last sent."""

    def ask(self, verb: Verb, pwm: int = 0) -> bytes:
        """Start a new request and abandon the outstanding one; returns the bytes to send."""
        self._request = Request(verb, self._next, pwm)
        self._next = (self._next + 1) % SEQUENCES
        self.damaged = self.stale = 0
        return self.repeat()

    def repeat(self) -> bytes:
        """The bytes of the outstanding request again, under the same number.

        Raises:
            ValueError: no request is outstanding.
        """
        if self._request is None:
            raise ValueError("conversation: no request is outstanding; ask() first")
        self.spoiled = False
        self.refused_line = None
        return seal(str(self._request))

    def hear(self, data: bytes) -> Reply | None:
        """Take received bytes; returns the reply to the outstanding request once it is complete."""
        answer = None
        for event in self._reader.feed(data):
            answer = self._judge(event) or answer
        return answer

    def _judge(self, event: bytes | Damage) -> Reply | None:
        if self._request is None:
            return None
        reply = None if isinstance(event, Damage) else parse_reply(event)
        if isinstance(reply, Refusal) and reply.sequence is None:
            self.refused_line = reply
            self.spoiled = True
        elif reply is not None and reply.sequence != self._request.sequence:
            self.stale += 1
        elif not isinstance(
            reply,
            (Refusal, Banner if self._request.verb is Verb.HELLO else BoardStatus),
        ):
            self.damaged += 1
            self.spoiled = True
        else:
            self._request = None
            return reply
        return None
