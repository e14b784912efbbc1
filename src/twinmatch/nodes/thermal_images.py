"""Thermal frames as ROS images."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from twinmatch.links.thermal_client import celsius
from twinmatch.links.thermal_frame import Exposure

__all__ = ["celsius_image", "centikelvin", "raw_image", "time_message"]

CENTIKELVIN = 0.01
_NO_COUNT, _FULL_COUNT = 0, 65535


def centikelvin(exposure: Exposure) -> NDArray[np.uint16]:
    """The image in hundredths of a kelvin at any camera resolution; 0 and 65535 still mean no value."""
    counts = exposure.image
    if exposure.resolution == CENTIKELVIN:
        return counts
    scaled = np.rint(counts * (exposure.resolution / CENTIKELVIN))
    scaled = np.clip(scaled, _NO_COUNT + 1, _FULL_COUNT - 1)
    invalid = (counts == _NO_COUNT) | (counts == _FULL_COUNT)
    return np.where(invalid, counts, scaled).astype(np.uint16)


def raw_image(exposure: Exposure, header: Callable[[Any], None]) -> Image:
    """The image as mono16 in centikelvin; `header` fills the message's header."""
    return _image("mono16", centikelvin(exposure).astype("<u2"), header)


def celsius_image(exposure: Exposure, header: Callable[[Any], None]) -> Image:
    """The image as 32FC1 in °C; NaN means no value, which is everywhere while the shutter is closed.

    Raises:
        RegionError: the camera's counts are not temperatures.
    """
    degrees = celsius(exposure)
    if exposure.frozen:
        degrees = np.full_like(degrees, np.nan)
    return _image("32FC1", degrees.astype("<f4"), header)


def time_message(nanoseconds: int) -> Time:
    """A time stamp."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def _image(encoding: str, pixels: NDArray[Any], header: Callable[[Any], None]) -> Image:
    rows, columns = pixels.shape
    message = Image(height=rows, width=columns, encoding=encoding, step=columns * pixels.itemsize)
    message.data = array("B", pixels.tobytes())  # the field's own type: not checked item by item
    header(message.header)
    return message
