"""Plate temperatures from a simulated rig to an emulated camera: datagrams on a local socket.

The camera server binds the socket's path, and the simulation sends to it. A datagram is the temperature in °C
as text, `31.25`. The sender never blocks, and never fails if there is no receiver: the camera may be started,
stopped and killed at any time, as a real one may.
"""

from __future__ import annotations

import math
import socket
import stat
from pathlib import Path

from twinmatch.emulation.lepton import LeptonError

__all__ = ["PlateFeed", "PlateReceiver"]

_LONGEST = 64
_RANGE = (-100.0, 400.0)


class PlateFeed:
    """The sending end, in the simulated rig."""

    def __init__(self, path: str | Path) -> None:
        self.path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, plate: float) -> bool:
        """Send the plate's temperature, °C; returns False if there is no receiver.

        Raises:
            LeptonError: the temperature is not finite, or out of range.
        """
        _check(plate)
        try:
            self._socket.sendto(f"{plate!r}".encode(), self.path)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def __enter__(self) -> PlateFeed:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class PlateReceiver:
    """The receiving end, in the emulated camera.

    Raises:
        LeptonError: the socket cannot be created at the path.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            if self.path.exists() and stat.S_ISSOCK(self.path.stat().st_mode):
                self.path.unlink()  # left behind by a camera that was killed
            self._socket.bind(str(self.path))
        except OSError as error:
            self._socket.close()
            msg = f"plate feed at {self.path}: {error}; give a path in a folder that can be written"
            raise LeptonError(msg) from error

    def newest(self) -> float | None:
        """The newest temperature since the last call, °C; None if there is none. Never blocks.

        Raises:
            LeptonError: the datagram is not a temperature.
        """
        newest = None
        while True:
            try:
                newest = self._socket.recv(_LONGEST)
            except BlockingIOError:
                return None if newest is None else _parse(newest)

    def close(self) -> None:
        """Close the socket and remove its path."""
        self._socket.close()
        self.path.unlink(missing_ok=True)


def _parse(text: bytes) -> float:
    try:
        plate = float(text)
    except ValueError:
        msg = f"plate feed: {text!r} is not a temperature; send °C as text, such as 31.25"
        raise LeptonError(msg) from None
    _check(plate)
    return plate


def _check(plate: float) -> None:
    low, high = _RANGE
    if not (math.isfinite(plate) and low <= plate <= high):
        msg = f"plate feed: the temperature is {plate} °C; it must be between {low} and {high} °C"
        raise LeptonError(msg)
