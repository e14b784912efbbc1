"""The node that publishes the plant time of a virtual rig, in a process of its own."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from tests.support.processes import Start
from tests.support.ros import Listener
from twinmatch.emulation.clock import ClockServer

pytestmark = pytest.mark.ros

CLOCK = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class Ticking:
    """A rig's clock, 10 ms of plant time every millisecond or so, until it is stopped."""

    def __init__(self) -> None:
        self.server = ClockServer()
        self.stamp = 1_700_000_000_000_000_000
        self.stands = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.001):
            if not self.stands:
                self.stamp += 10_000_000
                self.server.send(self.stamp)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.server.close()


@pytest.fixture
def ticking() -> Iterator[Ticking]:
    opened = Ticking()
    yield opened
    opened.close()


def test_plant_time_becomes_the_clock_and_standing_is_an_error(
    start: Start, listener: Listener, ticking: Ticking
) -> None:
    begin = ticking.stamp
    clock = listener.hear(Clock, "/clock", CLOCK)
    health = listener.health
    start(
        "plant_clock",
        "-p",
        "address:={}:{}".format(*ticking.server.address),
        "-p",
        "patience:=0.3",
    )
    listener.spin_until(lambda: len(clock) > 50 and health, "the clock")
    times = [Time.from_msg(message.clock).nanoseconds for message in clock]
    assert all(time % 10_000_000 == begin % 10_000_000 for time in times)
    assert times == sorted(times)
    assert begin < times[0] <= ticking.stamp
    ticking.stands = True
    listener.spin_until(
        lambda: (
            health[-1].status[0].level == b"\2"
            and "stood still" in health[-1].status[0].message
        ),
        "the warning",
    )
    ticking.stands = False
    listener.spin_until(lambda: health[-1].status[0].level == b"\0", "its withdrawal")
