"""Bounds on what a test may take: so many seconds, so many bytes."""

from __future__ import annotations

import signal
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["within"]


@contextmanager
def within(seconds: int, megabytes: float) -> Iterator[None]:
    """Fail if what is inside hangs for so long, or asks Python for more memory than that at any moment."""

    def too_late(_number: int, _frame: FrameType | None) -> None:
        msg = f"was not done after {seconds} s"
        raise AssertionError(msg)

    before = signal.signal(signal.SIGALRM, too_late)
    signal.alarm(seconds)
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert peak < megabytes * 1e6, f"took {peak / 1e6:.0f} MB"
