"""Ages of the wall's clock on a clock that runs at another pace."""

from __future__ import annotations

import pytest

from twinmatch.nodes.camera_bridge import WallToRos

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
