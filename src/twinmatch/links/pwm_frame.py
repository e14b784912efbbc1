"""Frames of the serial line: `:` payload `*` CRC `\\n`, the CRC as four upper-case hex digits.

A frame is one line of ASCII: readable in a serial monitor, with damage detected by the CRC. The firmware's
`frame.cpp` follows the same rules, byte for byte.
"""

from __future__ import annotations

import binascii
from enum import Enum

__all__ = ["MAX_PAYLOAD", "Damage", "FrameReader", "crc16", "seal"]

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
        msg = f"frame: {payload!r} cannot be sent; {rule}"
        raise ValueError(msg)
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
        found = []
        for byte in data:
            event = self._take(byte)
            if event is not None:
                found.append(event)
        return found

    def reset(self) -> None:
        """Discard an incomplete frame."""
        self._line = None

    def _take(self, byte: int) -> bytes | Damage | None:
        if byte == ord(":"):
            self._line = bytearray()
            self._overflow = False
            return None
        if self._line is None:
            return None
        if byte == ord("\n"):
            line, self._line = bytes(self._line), None
            return Damage.LENGTH if self._overflow else _open(line)
        if len(self._line) >= _ROOM:
            self._overflow = True
        else:
            self._line.append(byte)
        return None


def _open(line: bytes) -> bytes | Damage:
    line = line[:-1] if line.endswith(b"\r") else line
    payload, tail = line[:-_TAIL], line[-_TAIL:]
    if not payload or not tail.startswith(b"*") or not all(0x20 <= byte <= 0x7E for byte in payload):
        return Damage.CHECKSUM
    if len(payload) > MAX_PAYLOAD:
        return Damage.LENGTH
    # Compared as text, so that a lower-case digit is damage too.
    return payload if tail[1:] == b"%04X" % crc16(payload) else Damage.CHECKSUM
