"""After a standstill nothing is published until the readers are back."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from std_msgs.msg import Int64

from tests.support.processes import Processes
from tests.support.ros import listening
from twinmatch.nodes.samples import Standstill
from twinmatch.nodes.topics import EVERYTHING


def test_a_process_that_beats_never_waits() -> None:
    still = Standstill()
    for k in range(40):
        still.beat(k * Standstill.LONG)
        assert still.remaining(k * Standstill.LONG + 0.5 * Standstill.LONG) == 0.0


def test_after_a_standstill_the_first_to_look_waits_whether_or_not_the_heart_has_beaten() -> None:
    for heart_first in (True, False):
        still = Standstill()
        still.beat(0.0)
        woken = 10.0
        if heart_first:
            still.beat(woken)
        assert still.remaining(woken) == Standstill.REDISCOVERY
        assert still.remaining(woken + 0.5 * Standstill.REDISCOVERY) == 0.5 * Standstill.REDISCOVERY
        assert still.remaining(woken + Standstill.REDISCOVERY) == 0.0


def test_an_end_lets_go_of_who_waits() -> None:
    still = Standstill()
    still.beat(time.monotonic() - 2 * Standstill.LONG)
    still.close()
    still.wait()
    assert still.remaining(time.monotonic()) > 0.0


@pytest.mark.ros
def test_nothing_is_lost_around_a_standstill(processes: Processes) -> None:
    """Readers that forgot the process meanwhile receive every number, and each of them once."""
    process = processes.python(Path(__file__).parents[1] / "support" / "counting.py")
    with listening() as listener:
        heard = listener.hear(Int64, "count", EVERYTHING)
        listener.spin_until(lambda: len(heard) > 10, lambda: process.text)
        process.freeze()
        listener.spin_until(lambda: listener.node.count_publishers("count") == 0, "that it is forgotten")
        process.thaw()
        before = heard[-1].data
        listener.spin_until(lambda: heard[-1].data > before + 30, lambda: process.text)
        process.kill()
    numbers = [message.data for message in heard]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
