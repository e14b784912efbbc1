"""A FLIR Lepton 2.5 on the Raspberry Pi's SPI and I2C buses."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from twinmatch.links.thermal_frame import Exposure
from twinmatch_camera.errors import SourceError
from twinmatch_camera.sources.cci import CciWire, configure
from twinmatch_camera.sources.telemetry import exposure
from twinmatch_camera.sources.vospi import (
    PACKET_BYTES,
    RESYNC_SILENCE,
    Assembler,
    SyncLost,
)

_log = logging.getLogger(__name__)

_PACKETS_AT_ONCE = 20
"""Per transfer: 3280 bytes, below the 4096 that spidev takes by default."""
_REPEAT_AFTER = 0.12
"""Seconds after which a frame is passed on although its counter stands still."""
_PATIENCE = 5.0
"""Seconds without any frame after which the camera counts as failed."""
_CCI_ADDRESS = 0x2A


class SpiWire(Protocol):
    """An SPI bus with a Lepton on it."""

    def readbytes(self, count: int) -> Sequence[int]:
        """Clock in so many bytes. Raises OSError."""

    def close(self) -> None:
        """Give the bus back."""


class LeptonSource:
    """Reads VoSPI without a pause, and passes on each new image once.

    Args:
        spi: bus and device, /dev/spidevBUS.DEVICE.
        speed: SPI clock, Hz; the camera takes at most 20 MHz and needs at least 2.2 MHz.
        i2c: bus of the command interface.
        wires: opens both buses; for tests.
        sleep: waits so many seconds; for tests.
    """

    def __init__(
        self,
        *,
        spi: tuple[int, int] = (0, 0),
        speed: int = 16_000_000,
        i2c: int = 1,
        wires: Callable[[], tuple[SpiWire, CciWire]] | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._where = f"/dev/spidev{spi[0]}.{spi[1]} and /dev/i2c-{i2c}"
        self._wires = wires or (lambda: (_open_spi(spi, speed), _I2cWire(i2c)))
        self._sleep = sleep
        self._spi: SpiWire | None = None
        self._assembler = Assembler()
        self._packets: deque[bytes] = deque()
        self._last_counter: int | None = None
        self._last_passed = 0.0
        self._last_frame = 0.0

    @property
    def name(self) -> str:
        """What it is, for the log."""
        return f"Lepton on {self._where}"

    def open(self) -> None:
        """Open the buses, set the camera up, and find the start of its stream."""
        try:
            self._spi, cci = self._wires()
        except ImportError as error:
            msg = f"Lepton: {error}; install with `pip install 'twinmatch-camera[lepton]'`"
            raise SourceError(msg) from error
        except OSError as error:
            msg = f"Lepton on {self._where}: {error}; switch SPI and I2C on, and join their groups"
            raise SourceError(msg) from error
        configure(cci, self._sleep)
        self._resynchronise()
        self._last_frame = time.monotonic()

    def read(self, timeout: float) -> Exposure | None:
        """The next new image, or the same again while the camera's picture stands still."""
        deadline = time.monotonic() + timeout
        while (now := time.monotonic()) < deadline:
            taken = self._frame()
            if taken is None:
                if now - self._last_frame > _PATIENCE:
                    raise SourceError(
                        f"Lepton on {self._where}: no frame in {_PATIENCE} s; check wiring"
                    )
                continue
            self._last_frame = now
            moved = taken.frame_counter != self._last_counter
            if moved or now - self._last_passed >= _REPEAT_AFTER:
                self._last_counter = taken.frame_counter
                self._last_passed = now
                return taken
        return None

    def close(self) -> None:
        """Give the SPI bus back."""
        if self._spi is not None:
            self._spi.close()
            self._spi = None

    def _frame(self) -> Exposure | None:
        """One packet further; an exposure if it completes a frame."""
        try:
            if not self._packets:
                self._fetch()
            frame = self._assembler.feed(self._packets.popleft())
        except SyncLost as lost:
            _log.debug("%s; synchronising again", lost)
            self._resynchronise()
            return None
        if frame is None:
            return None
        return exposure(frame.image, frame.telemetry, time.monotonic_ns())

    def _fetch(self) -> None:
        if self._spi is None:
            raise SourceError("Lepton: read before it was opened")
        try:
            data = bytes(self._spi.readbytes(_PACKETS_AT_ONCE * PACKET_BYTES))
        except OSError as error:
            raise SourceError(f"Lepton on {self._where}: {error}") from error
        self._packets.extend(
            data[i : i + PACKET_BYTES] for i in range(0, len(data), PACKET_BYTES)
        )

    def _resynchronise(self) -> None:
        """Be silent until the camera begins a new stream; chip select is up between transfers."""
        self._packets.clear()
        self._sleep(RESYNC_SILENCE)


def _open_spi(spi: tuple[int, int], speed: int) -> SpiWire:
    import spidev  # noqa: PLC0415

    bus: SpiWire = spidev.SpiDev()
    bus.open(*spi)  # type: ignore[attr-defined]
    bus.max_speed_hz = speed  # type: ignore[attr-defined]
    bus.mode = 3  # type: ignore[attr-defined]
    return bus


class _I2cWire:
    """The command interface over smbus2, with a stop between address and data as the camera expects."""

    def __init__(self, bus: int) -> None:
        import smbus2  # noqa: PLC0415

        self._message = smbus2.i2c_msg
        self._bus = smbus2.SMBus(bus)

    def write(self, register: int, words: Sequence[int]) -> None:
        data = [
            byte for word in (register, *words) for byte in (word >> 8, word & 0xFF)
        ]
        self._bus.i2c_rdwr(self._message.write(_CCI_ADDRESS, data))

    def read(self, register: int) -> int:
        self._bus.i2c_rdwr(
            self._message.write(_CCI_ADDRESS, [register >> 8, register & 0xFF])
        )
        answer = self._message.read(_CCI_ADDRESS, 2)
        self._bus.i2c_rdwr(answer)
        return int.from_bytes(bytes(answer), "big")
