"""An emulated FLIR Lepton 2.5: images of a plate at a given temperature.

It models what matters to a loop closed through the camera: 9 new images per second, common noise of all
pixels and independent noise of each, a plate of non-uniform temperature, drift between flat-field
corrections, and the corrections, during which the image is frozen and marked as such. Not modelled: optics,
emissivity, and corrections triggered by a change of the sensor's temperature.

An image depends only on the settings, the seed, the plate's temperature and the time since power-on.

Plate temperatures come from a simulated rig as datagrams on a local socket, which the camera server binds:
the temperature in °C as text, `31.25`. The sender never blocks, and never fails if there is no receiver: the
camera may be started, stopped and killed at any time, as a real one may.
"""

from __future__ import annotations

import math
import socket
import stat
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.links.thermal_client import Region
from twinmatch.links.thermal_frame import (
    LEPTON_SHAPE,
    CountArray,
    Exposure,
    FlatField,
    FrameFlags,
)
from twinmatch.signals import KELVIN, FloatArray

PLATE = Region(row=14, column=22, rows=32, columns=36)
"""Where the plate lies in the emulated image."""

_SENSOR_WARMING = 8.0
_SENSOR_TIME = 300.0
_LONGEST = 64
"""Longest datagram, bytes."""
_RANGE = (-100.0, 400.0)
"""Temperatures that a plate can have, °C."""


class LeptonError(TwinmatchError):
    """Invalid settings, temperature or time."""


@dataclass(frozen=True, slots=True)
class LeptonSettings:
    """Properties of the emulated camera and its scene.

    Raises:
        LeptonError: a value is not finite, or out of its range.
    """

    rate: float = 9.0
    """New images per second."""
    ambient: float = 23.0
    """Temperature of everything except the plate, °C."""
    gradient: float = 0.02
    """Fraction by which the plate's excess over ambient falls from its centre to its corners."""
    pixel_noise: float = 0.05
    """Standard deviation of the noise of each pixel, K."""
    common_noise: float = 0.08
    """Standard deviation of the noise common to all pixels of an image, K."""
    drift: float = 0.02
    """Rise of all temperatures per minute since the last flat-field correction, K/min."""
    resolution: float = 0.01
    """Kelvin per count."""
    flat_field_period: float = 180.0
    """Seconds between the starts of flat-field corrections; the first is at power-on."""
    flat_field_duration: float = 0.9
    """Time for which the image is frozen, s."""
    flat_field_warning: float = 2.0
    """Time before a correction during which it is announced, s."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not math.isfinite(value) or (
                value < 0 and item.name not in {"ambient", "drift"}
            ):
                msg = f"emulated Lepton: {item.name} is {value}; it must be finite and not negative"
                raise LeptonError(msg)
        if not (self.rate > 0 and self.resolution > 0):
            msg = f"emulated Lepton: rate {self.rate} and resolution {self.resolution} must be positive"
            raise LeptonError(msg)
        if self.flat_field_duration + self.flat_field_warning >= self.flat_field_period:
            raise LeptonError(
                f"emulated Lepton: a flat-field correction every {self.flat_field_period} s has no room for "
                f"a warning of {self.flat_field_warning} s and a duration of {self.flat_field_duration} s"
            )


class EmulatedLepton:
    """One camera since its power-on."""

    def __init__(
        self, settings: LeptonSettings = LeptonSettings(), seed: int = 0
    ) -> None:
        self.settings = settings
        self._seed = seed
        self._shape_of_plate = _shape_of_plate(settings.gradient)
        self._counter = 0
        self._tick = -1
        self._image: CountArray = self._counts(np.full(LEPTON_SHAPE, settings.ambient))

    def expose(self, plate: float, elapsed: float, stamp: int) -> Exposure:
        """The camera's output `elapsed` seconds after power-on.

        Within 1/rate seconds of the last image, and during a flat-field correction, the last image and frame
        counter are repeated.

        Args:
            plate: temperature of the plate's centre, °C.
            elapsed: time since power-on, s; must not decrease from call to call.
            stamp: the monotonic clock to write into the exposure, ns.

        Raises:
            LeptonError: the temperature is not finite, or time goes back.
        """
        if not math.isfinite(plate):
            msg = f"emulated Lepton: the plate's temperature is {plate} °C; it must be finite"
            raise LeptonError(msg)
        # At its exact start, a tick must not be rounded into the one before.
        tick = math.floor(elapsed * self.settings.rate + 1e-6)
        if tick < self._tick or tick < 0:
            newest = self._tick / self.settings.rate
            msg = f"emulated Lepton: time {elapsed} s is before that of the last image, {newest} s"
            raise LeptonError(msg)
        state, since = self._flat_field(tick / self.settings.rate)
        if tick > self._tick and state is not FlatField.RUNNING:
            self._image = self._take(plate, tick, since)
            self._counter += 1
        self._tick = tick
        return Exposure(
            image=self._image,
            stamp=stamp,
            resolution=self.settings.resolution,
            frame_counter=self._counter % 2**32,
            flat_field=state,
            flat_field_age=round(since * 1000),
            sensor_temperature=self._sensor(elapsed),
            flags=FrameFlags.EMULATED,
        )

    def _flat_field(self, elapsed: float) -> tuple[FlatField, float]:
        """State of the correction and seconds since the last one began."""
        settings = self.settings
        since = elapsed % settings.flat_field_period
        if since < settings.flat_field_duration:
            return FlatField.RUNNING, since
        if since >= settings.flat_field_period - settings.flat_field_warning:
            return FlatField.IMMINENT, since
        return FlatField.COMPLETE, since

    def _take(self, plate: float, tick: int, since: float) -> CountArray:
        settings = self.settings
        rng = np.random.default_rng((self._seed, tick))
        scene = settings.ambient + (plate - settings.ambient) * self._shape_of_plate
        common = (
            settings.common_noise * rng.standard_normal()
            + settings.drift * since / 60.0
        )
        return self._counts(
            scene + common + settings.pixel_noise * rng.standard_normal(LEPTON_SHAPE)
        )

    def _counts(self, degrees: FloatArray) -> CountArray:
        counts = np.rint((degrees + KELVIN) / self.settings.resolution)
        return np.clip(counts, 0, 65535).astype(np.uint16)

    def _sensor(self, elapsed: float) -> int:
        degrees = self.settings.ambient + _SENSOR_WARMING * -math.expm1(
            -elapsed / _SENSOR_TIME
        )
        return round((degrees + KELVIN) * 100)


def _shape_of_plate(gradient: float) -> FloatArray:
    """Excess over ambient per pixel, relative to the plate's centre; shape (rows, columns)."""
    rows = (np.arange(PLATE.rows) - (PLATE.rows - 1) / 2) / (PLATE.rows / 2)
    columns = (np.arange(PLATE.columns) - (PLATE.columns - 1) / 2) / (PLATE.columns / 2)
    shape = np.zeros(LEPTON_SHAPE)
    shape[
        PLATE.row : PLATE.row + PLATE.rows, PLATE.column : PLATE.column + PLATE.columns
    ] = 1.0 - gradient * (rows[:, None] ** 2 + columns**2) / 2
    return shape


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
        msg = (
            f"plate feed: {text!r} is not a temperature; send °C as text, such as 31.25"
        )
        raise LeptonError(msg) from None
    _check(plate)
    return plate


def _check(plate: float) -> None:
    low, high = _RANGE
    if not (math.isfinite(plate) and low <= plate <= high):
        msg = f"plate feed: the temperature is {plate} °C; it must be between {low} and {high} °C"
        raise LeptonError(msg)
