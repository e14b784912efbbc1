"""Bounds on what a test may take: so many seconds, so many bytes."""

from __future__ import annotations

import signal
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from tests.support.waiting import PATIENCE


@contextmanager
def within(seconds: int, megabytes: float) -> Iterator[None]:
    """Fail if what is inside computes or hangs for too long, or asks Python for more memory at any moment.

    The seconds are those of this process, which a busy machine does not take away.
    """

    def too_late(_number: int, _frame: FrameType | None) -> None:
        msg = f"was not done after {seconds} s"
        raise AssertionError(msg)

    timers = {signal.SIGPROF: signal.ITIMER_PROF, signal.SIGALRM: signal.ITIMER_REAL}
    before = {number: signal.signal(number, too_late) for number in timers}
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        for number, timer in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])
    assert peak < megabytes * 1e6, f"took {peak / 1e6:.0f} MB"
