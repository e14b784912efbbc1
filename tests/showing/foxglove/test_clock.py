"""The time that viewers are sent."""

from __future__ import annotations

import time

from twinmatch.showing.foxglove.server import StreamTime


def test_without_a_clock_it_is_that_of_the_wall() -> None:
    stream = StreamTime()
    assert not stream.on_sample(1.0, clock=False)
    assert abs(stream.now - time.time_ns()) < 10**10


def test_with_one_it_is_that_of_the_plant() -> None:
    stream = StreamTime()
    assert stream.on_clock(7, 1.0)
    assert not stream.on_clock(8, 1.1)
    assert stream.now == 8


def test_after_the_end_of_a_clock_it_stands_until_another_graph_has_samples() -> None:
    stream = StreamTime()
    stream.on_clock(7, 1.0)
    assert not stream.on_sample(2.0, clock=False)  # still on its way when the clock ended
    assert not stream.on_sample(9.0, clock=True)  # the clock is there but slow
    assert stream.now == 7
    assert stream.on_sample(9.0, clock=False)
    assert stream.now > 10**18
