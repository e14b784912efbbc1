"""The Lepton's command interface over I2C, as little of it as the program needs.

Registers are 16 bits wide at 16-bit addresses: the data, then their length in words, then the command are
written, and the status is read until the camera is no longer busy. A Lepton 2.5 wakes up with TLinear at
0.01 K and gain control off; telemetry is what has to be switched on. All of it is set, so that nothing
depends on what ran before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from twinmatch_camera.errors import SourceError

_STATUS: Final = 0x0002
_COMMAND: Final = 0x0004
_LENGTH: Final = 0x0006
_DATA: Final = 0x0008

_BUSY: Final = 0b001
_BOOT_MODE: Final = 0b010
_BOOTED: Final = 0b100

_SET: Final = 1
SETTINGS: Final = (
    ("gain control off", 0x0100, 0),
    ("telemetry on", 0x0218, 1),
    ("telemetry as a footer", 0x021C, 1),
    ("TLinear on", 0x4EC0, 1),
    ("TLinear at 0.01 K", 0x4EC4, 1),
)
"""What is set: a name, the command's number, the value (32 bits)."""

_BOOT_SECONDS = 5.0
_COMMAND_SECONDS = 1.0
_PAUSE = 0.005


class CciWire(Protocol):
    """An I2C bus with a Lepton on it. Both calls raise OSError when it does not answer."""

    def write(self, register: int, words: Sequence[int]) -> None:
        """Write words from a register on."""

    def read(self, register: int) -> int:
        """Read the word of a register."""


def configure(wire: CciWire, sleep: Callable[[float], None] = time.sleep) -> None:
    """Wait until the camera has booted and set all of `SETTINGS`.

    Raises:
        SourceError: the camera does not answer, does not boot, or refuses a setting.
    """
    try:
        _wait(wire, sleep, _BOOT_MODE | _BOOTED, _BOOT_SECONDS, "to boot")
        for name, command, value in SETTINGS:
            wire.write(_DATA, (value & 0xFFFF, value >> 16))
            wire.write(_LENGTH, (2,))
            wire.write(_COMMAND, (command | _SET,))
            status = _wait(wire, sleep, 0, _COMMAND_SECONDS, f"for {name}")
            code = status >> 8
            if code:
                code -= 256 if code > 127 else 0
                raise SourceError(
                    f"Lepton: it refuses {name} with error {code}; is it a Lepton 2.5?"
                )
    except OSError as error:
        msg = f"Lepton: no answer on I2C ({error}); check the wiring, and that I2C is switched on"
        raise SourceError(msg) from error


def _wait(
    wire: CciWire,
    sleep: Callable[[float], None],
    needed: int,
    seconds: float,
    what: str,
) -> int:
    """Read the status until it is not busy and has the bits needed."""
    for _ in range(round(seconds / _PAUSE)):
        status = wire.read(_STATUS)
        if not status & _BUSY and status & needed == needed:
            return status
        sleep(_PAUSE)
    raise SourceError(
        f"Lepton: waited {seconds} s {what}, its status is 0x{status:04x}; power it off and on"
    )
