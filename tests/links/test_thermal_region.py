"""Counts to degrees, and statistics of rectangles."""

from __future__ import annotations

import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from twinmatch.links.thermal_client import Region, RegionError, celsius, region
from twinmatch.links.thermal_frame import Exposure, FrameFlags


def exposure(counts: object, resolution: float = 0.01, flags: FrameFlags = FrameFlags.NONE) -> Exposure:
    image = np.array(counts, dtype=np.uint16)
    return Exposure(image=image, stamp=0, resolution=resolution, frame_counter=0, flags=flags)


def test_counts_are_kelvin_by_resolution() -> None:
    assert celsius(exposure([[27315, 30815]]))[0] == pytest.approx([0.0, 35.0], abs=1e-9)
    assert celsius(exposure([[3032]], resolution=0.1))[0, 0] == pytest.approx(30.05, abs=1e-9)


def test_statistics_of_a_rectangle() -> None:
    counts = np.full((60, 80), 27315)
    counts[10:12, 20:22] = [[30000, 30100], [30200, 30300]]
    found = region(exposure(counts), Region(10, 20, 2, 2))
    degrees = [26.85, 27.85, 28.85, 29.85]
    assert found.mean == pytest.approx(statistics.mean(degrees))
    assert found.variance == pytest.approx(statistics.pvariance(degrees))
    assert found.deviation == pytest.approx(statistics.pstdev(degrees))
    assert (found.minimum, found.maximum) == pytest.approx((26.85, 29.85))
    assert found.spread == pytest.approx(3.0)
    assert found.pixels == 4


def test_pixels_at_the_ends_of_the_range_do_not_count() -> None:
    found = region(exposure([[0, 30000], [65535, 30100]]))
    assert found.pixels == 2
    assert found.mean == pytest.approx(27.35)


@given(hnp.arrays(np.uint16, (6, 8), elements=st.integers(1, 65534)), st.data())
def test_a_rectangle_lies_within_the_image(image: np.ndarray, data: st.DataObject) -> None:
    row, column = data.draw(st.integers(0, 5)), data.draw(st.integers(0, 7))
    roi = Region(row, column, data.draw(st.integers(1, 6 - row)), data.draw(st.integers(1, 8 - column)))
    whole, part = region(exposure(image)), region(exposure(image), roi)
    assert whole.minimum <= part.minimum <= part.maximum <= whole.maximum
    assert part.pixels == roi.rows * roi.columns
    # Popoviciu: no variance exceeds a quarter of the spread squared.
    assert part.variance <= part.spread**2 / 4 + 1e-6


@pytest.mark.parametrize("box", [(-1, 0, 1, 1), (0, -1, 1, 1), (0, 0, 0, 1), (0, 0, 1, 0)])
def test_an_invalid_rectangle(box: tuple[int, int, int, int]) -> None:
    with pytest.raises(RegionError, match="start at 0 or later and contain a pixel"):
        Region(*box)


@pytest.mark.parametrize("box", [(5, 0, 2, 1), (0, 7, 1, 2)])
def test_a_rectangle_outside_the_image(box: tuple[int, int, int, int]) -> None:
    with pytest.raises(RegionError, match="leave the image of 6 by 8"):
        region(exposure(np.ones((6, 8))), Region(*box))


def test_no_valid_pixel() -> None:
    with pytest.raises(RegionError, match="every pixel is outside"):
        region(exposure(np.zeros((6, 8))))


@pytest.mark.parametrize("flag", [FrameFlags.GAIN_CONTROL, FrameFlags.NOT_RADIOMETRIC])
def test_counts_that_are_not_temperatures(flag: FrameFlags) -> None:
    with pytest.raises(RegionError, match="not temperatures; switch TLinear on"):
        celsius(exposure(np.ones((6, 8)), flags=flag))
