"""Thermal frames as ROS images, and ages of the wall's clock on a clock that runs at another pace."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from std_msgs.msg import Header

from twinmatch.links.thermal_client import RegionError
from twinmatch.links.thermal_frame import Exposure, FlatField, FrameFlags
from twinmatch.nodes.camera_bridge import WallToRos, celsius_image, centikelvin, raw_image


def exposure(counts: list[list[int]], resolution: float = 0.01, **values: Any) -> Exposure:
    image = np.array(counts, dtype=np.uint16)
    return Exposure(image=image, stamp=0, resolution=resolution, frame_counter=0, **values)


def test_centikelvin_are_the_counts_of_a_fine_camera() -> None:
    counts = [[0, 29815, 65535]]
    assert centikelvin(exposure(counts)).tolist() == counts


def test_a_coarse_camera_is_scaled_but_not_its_ends() -> None:
    """0 and 65535 mean no value, and no value becomes one of them."""
    found = centikelvin(exposure([[0, 2982, 6600, 65535]], resolution=0.1))
    assert found.tolist() == [[0, 29820, 65534, 65535]]


def test_raw_is_mono16_row_by_row() -> None:
    message = raw_image(exposure([[1, 2, 3], [4, 5, 65535]]), Header())
    assert (message.height, message.width, message.step, message.encoding) == (2, 3, 6, "mono16")
    assert message.is_bigendian == 0
    assert np.frombuffer(bytes(message.data), "<u2").tolist() == [1, 2, 3, 4, 5, 65535]


def test_celsius_has_nan_where_there_is_no_value() -> None:
    message = celsius_image(exposure([[0, 29815], [27315, 65535]]), Header())
    assert (message.height, message.width, message.step, message.encoding) == (2, 2, 8, "32FC1")
    degrees = np.frombuffer(bytes(message.data), "<f4")
    np.testing.assert_allclose(degrees, [np.nan, 25.0, 0.0, np.nan], atol=1e-5)


def test_a_closed_shutter_shows_nothing() -> None:
    closed = exposure([[29815, 29815]], flat_field=FlatField.RUNNING)
    assert np.isnan(np.frombuffer(bytes(celsius_image(closed, Header()).data), "<f4")).all()


def test_a_picture_does_not_hold_temperatures() -> None:
    with pytest.raises(RegionError, match="counts are not temperatures"):
        celsius_image(exposure([[1, 2]], flags=FrameFlags.GAIN_CONTROL), Header())


SECOND = 1_000_000_000


def test_real_time_runs_as_the_wall_does() -> None:
    past = WallToRos()
    assert past.at(7 * SECOND, wall=9 * SECOND, ros=1000 * SECOND, simulated=False) == 998 * SECOND


@pytest.mark.parametrize("speed", [0.5, 1.0, 10.0])
def test_a_second_ago_is_many_in_a_fast_simulation(speed: float) -> None:
    past = WallToRos()
    for tick in range(100):
        wall = tick * SECOND // 10
        ros = 5000 * SECOND + round(wall * speed)
        found = past.at(wall - SECOND // 100, wall=wall, ros=ros, simulated=True)
    assert found == pytest.approx(ros - 0.01 * speed * SECOND, abs=1e-6 * SECOND)


def test_leaps_of_the_clock_do_not_count_as_pace() -> None:
    past = WallToRos()
    for wall, ros in ((0, 0), (1, 1), (2, 1_000_000), (3, 5)):
        past.at(0, wall=wall * SECOND, ros=ros * SECOND, simulated=True)
    assert past.at(3 * SECOND, wall=4 * SECOND, ros=6 * SECOND, simulated=True) == 5 * SECOND


def test_before_the_clock_is_set_there_is_no_past() -> None:
    past = WallToRos()
    assert past.at(7 * SECOND, wall=9 * SECOND, ros=0, simulated=True) == 0
