"""Mapping a camera's clock to ours."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from twinmatch.links.thermal_client import CLOCK_MEMORY, StampMapper

MS = 1_000_000


def test_the_quickest_frame_sets_the_offset() -> None:
    mapper = StampMapper()
    assert mapper.map(0, 1000 * MS + 5 * MS) == 1005 * MS
    assert mapper.map(100 * MS, 1100 * MS + 1 * MS) == 1101 * MS
    assert mapper.map(200 * MS, 1200 * MS + 80 * MS) == 1201 * MS


@given(st.integers(0, 10**15), st.lists(st.integers(0, 500 * MS), min_size=1, max_size=50))
def test_never_early_and_late_by_the_shortest_transit(offset: int, transits: list[int]) -> None:
    mapper = StampMapper()
    for i, transit in enumerate(transits):
        taken = 111 * MS * i
        mapped = mapper.map(taken, taken + offset + transit)
        assert mapped - (taken + offset) == min(transits[: i + 1])


def test_clocks_that_drift_apart_cost_what_they_drift_in_two_stretches() -> None:
    mapper = StampMapper()
    worst = 0
    for i in range(0, 3600 * 9):
        ours = 111 * MS * i
        camera = ours - ours * 50 // 1_000_000  # 50 ppm slow
        worst = max(worst, abs(mapper.map(camera, ours) - ours))
    # 50 ppm of two stretches of 30 s are 3 ms.
    assert worst <= 2 * CLOCK_MEMORY * 50 // 1_000_000 + MS


def test_a_quick_frame_is_forgotten_after_two_stretches() -> None:
    mapper = StampMapper(memory=10)
    mapper.map(0, 100)
    assert mapper.map(1, 111) == 101
    assert mapper.map(12, 122) == 122
    assert mapper.map(23, 133) == 133
