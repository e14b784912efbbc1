"""When recorded messages are due."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.nodes.pace import Pace

SECONDS = st.floats(0.0, 1e6)


def test_stands_still_until_resumed() -> None:
    pace = Pace(2.0, start=100.0)
    assert pace.paused
    assert pace.wait(100.0, now=50.0) is None
    assert pace.position(now=50.0) == 100.0


def test_rate_divides_the_waiting() -> None:
    pace = Pace(2.0, start=100.0)
    pace.resume(now=50.0)
    assert pace.wait(110.0, now=50.0) == 5.0
    assert pace.wait(110.0, now=54.0) == 1.0
    assert pace.wait(110.0, now=60.0) == 0.0


def test_pause_takes_nothing_away() -> None:
    pace = Pace(1.0, start=0.0)
    pace.resume(now=0.0)
    pace.pause(now=3.0)
    pace.pause(now=4.0)
    assert pace.position(now=99.0) == 3.0
    pace.resume(now=100.0)
    pace.resume(now=101.0)
    assert pace.wait(10.0, now=102.0) == 5.0


def test_without_pace_nothing_waits_but_a_pause() -> None:
    pace = Pace(0.0, start=0.0)
    assert pace.wait(1e9, now=0.0) is None
    pace.resume(now=0.0)
    assert pace.wait(1e9, now=0.0) == 0.0
    pace.reach(1e9, now=1.0)
    assert pace.position(now=5.0) == 1e9
    pace.reach(1e8, now=1.0)
    assert pace.position(now=5.0) == 1e9
    pace.pause(now=6.0)
    assert pace.wait(2e9, now=7.0) is None


@given(rate=st.floats(0.01, 1000.0), first=SECONDS, wait=SECONDS, recorded=SECONDS)
def test_after_the_wait_the_message_is_due(rate: float, first: float, wait: float, recorded: float) -> None:
    pace = Pace(rate, start=first)
    pace.resume(now=wait)
    rest = pace.wait(recorded, now=wait)
    assert rest is not None
    assert rest >= 0.0
    assert pace.position(now=wait + rest) >= recorded - 1e-3 * max(1.0, rate)
    assert pytest.approx(0.0, abs=1e-3) == pace.wait(recorded, now=wait + rest)


def test_change_continues_from_where_the_recording_stands() -> None:
    pace = Pace(2.0, 100.0)
    pace.resume(10.0)
    pace.change(10.0, 13.0)
    assert pace.rate == 10.0
    assert pace.position(13.0) == 106.0
    assert pace.position(14.0) == 116.0
    assert pace.wait(126.0, 14.0) == 1.0


def test_change_while_paused_stays_paused() -> None:
    pace = Pace(2.0, 100.0)
    pace.resume(10.0)
    pace.pause(11.0)
    pace.change(5.0, 20.0)
    assert pace.paused
    assert pace.position(30.0) == 102.0
    pace.resume(40.0)
    assert pace.position(41.0) == 107.0


def test_change_to_and_from_no_pace() -> None:
    pace = Pace(1.0, 0.0)
    pace.resume(0.0)
    pace.change(0.0, 5.0)
    assert pace.wait(1000.0, 5.0) == 0.0
    pace.reach(1000.0, 6.0)
    pace.change(10.0, 7.0)
    assert pace.position(8.0) == 1010.0
