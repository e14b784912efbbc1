"""Temperatures of a rectangle of a thermal frame, from its counts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twinmatch.links.thermal_errors import ThermalLinkError
from twinmatch.links.thermal_frame import Exposure
from twinmatch.signals import KELVIN, FloatArray

__all__ = ["Region", "RegionError", "RegionStatistics", "celsius", "region"]

_NO_COUNT = 0
_FULL_COUNT = 65535


class RegionError(ThermalLinkError):
    """A rectangle is outside the frame, empty, or without a valid pixel."""


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of pixels.

    Raises:
        RegionError: it starts before the first pixel, or is empty.
    """

    row: int
    """First row, 0 at the top."""
    column: int
    """First column, 0 at the left."""
    rows: int
    columns: int

    def __post_init__(self) -> None:
        if self.row < 0 or self.column < 0 or self.rows < 1 or self.columns < 1:
            msg = (
                f"region: {self.rows} by {self.columns} pixels from row {self.row}, column {self.column}; "
                "it must start at 0 or later and contain a pixel"
            )
            raise RegionError(msg)


@dataclass(frozen=True, slots=True)
class RegionStatistics:
    """Temperatures over a rectangle."""

    mean: float
    """°C."""
    variance: float
    """Mean square deviation from the mean, °C²; 0 for a single pixel."""
    minimum: float
    """°C."""
    maximum: float
    """°C."""
    pixels: int
    """Number of pixels with a valid count."""

    @property
    def spread(self) -> float:
        """Hottest minus coldest pixel, °C: the non-uniformity of the plate."""
        return self.maximum - self.minimum

    @property
    def deviation(self) -> float:
        """Standard deviation over the pixels, °C."""
        return math.sqrt(self.variance)


def celsius(exposure: Exposure) -> FloatArray:
    """The image in °C, shape (rows, columns); NaN where the count is at either end of its range.

    Raises:
        RegionError: the camera does not deliver temperatures (see `Exposure.radiometric`).
    """
    if not exposure.radiometric:
        msg = "region: the camera's counts are not temperatures; switch TLinear on and gain control off"
        raise RegionError(msg)
    counts = exposure.image
    degrees = counts * exposure.resolution - KELVIN
    degrees[(counts == _NO_COUNT) | (counts == _FULL_COUNT)] = np.nan
    return np.asarray(degrees, dtype=np.float64)


def region(exposure: Exposure, roi: Region | None = None) -> RegionStatistics:
    """Statistics of the temperatures in a rectangle, or in the whole image.

    Raises:
        RegionError: the rectangle leaves the image, no pixel in it is valid, or the camera's counts
            are not temperatures.
    """
    degrees = celsius(exposure)
    if roi is not None:
        rows, columns = degrees.shape
        if roi.row + roi.rows > rows or roi.column + roi.columns > columns:
            msg = (
                f"region: {roi.rows} by {roi.columns} pixels from row {roi.row}, column {roi.column} "
                f"leave the image of {rows} by {columns}"
            )
            raise RegionError(msg)
        degrees = degrees[roi.row : roi.row + roi.rows, roi.column : roi.column + roi.columns]
    valid = degrees[np.isfinite(degrees)]
    if not valid.size:
        msg = "region: every pixel is outside the camera's range; point the camera at the plate"
        raise RegionError(msg)
    return RegionStatistics(
        mean=float(valid.mean()),
        variance=float(valid.var()),
        minimum=float(valid.min()),
        maximum=float(valid.max()),
        pixels=int(valid.size),
    )
