"""VoSPI, the Lepton's video over SPI: from packets to frames, without a wire.

A packet is 164 bytes: two of ID, two of CRC, 80 big-endian words. With telemetry as a footer a frame is
packets 0 to 59 of video and 60 to 62 of telemetry. Between frames the camera sends discard packets. When
a packet is damaged or out of turn, the two sides have lost each other; the host then has to be silent
for more than five frames (185 ms), see `RESYNC_SILENCE`.
"""

from __future__ import annotations

import binascii
from typing import NamedTuple

import numpy as np

from twinmatch.links.thermal_frame import LEPTON_SHAPE, CountArray

PACKET_BYTES = 164
RESYNC_SILENCE = 0.2
"""Seconds without a clock edge after which the camera starts over."""

_ROWS, _COLUMNS = LEPTON_SHAPE
_TELEMETRY_ROWS = 3
_PACKETS = _ROWS + _TELEMETRY_ROWS
_HEADER = 4
_MOST_SKIPPED = 4 * _PACKETS


class SyncLost(Exception):  # noqa: N818
    """The camera and we do not agree where a packet or a frame begins."""


class VospiFrame(NamedTuple):
    """A whole frame."""

    image: CountArray
    """Counts, shape (60, 80)."""
    telemetry: CountArray
    """Telemetry rows A, B, C as words, shape (3, 80)."""


def packet_crc(packet: bytes) -> int:
    """CRC-16 (polynomial 0x1021, from 0) of a packet with its ID's high nibble and its CRC taken as 0."""
    return binascii.crc_hqx(
        bytes((packet[0] & 0x0F, packet[1], 0, 0)) + packet[_HEADER:], 0
    )


class Assembler:
    """Puts frames together from packets fed one by one."""

    def __init__(self) -> None:
        self._words = np.zeros((_PACKETS, _COLUMNS), dtype=np.uint16)
        self._expected = 0
        self._skipped = 0

    def feed(self, packet: bytes) -> VospiFrame | None:
        """Take the next packet; gives a frame when it was the frame's last.

        Raises:
            SyncLost: the packet is damaged, out of turn, or no frame has begun for long.
        """
        if packet[0] & 0x0F == 0x0F:
            return None
        number = (packet[0] & 0x0F) << 8 | packet[1]
        if packet_crc(packet) != int.from_bytes(packet[2:_HEADER], "big"):
            raise self._lost(f"packet {number} is damaged")
        if number == 0:
            self._expected = 0  # a frame begins, whatever became of the one before
        elif self._expected == 0:
            self._skip()
            return None
        elif number != self._expected:
            raise self._lost(f"packet {number} came where {self._expected} was due")
        self._words[number] = np.frombuffer(packet, dtype=">u2", offset=_HEADER)
        self._expected += 1
        self._skipped = 0
        if self._expected < _PACKETS:
            return None
        self._expected = 0
        return VospiFrame(self._words[:_ROWS].copy(), self._words[_ROWS:].copy())

    def _skip(self) -> None:
        """We joined in the midst of a frame: wait for the next to begin, but not for ever."""
        self._skipped += 1
        if self._skipped > _MOST_SKIPPED:
            raise self._lost(f"no frame began within {_MOST_SKIPPED} packets")

    def _lost(self, why: str) -> SyncLost:
        self._expected = 0
        self._skipped = 0
        return SyncLost(why)
