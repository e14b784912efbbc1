"""A thousand malformed documents of each kind: how many end in a traceback, or take longer than ten seconds?

    python -m benchmarks.malformed 1000
    python -m benchmarks.malformed 1000 laws memories

Seconds are processor time; a call that takes longer than ten is ended and counted.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
import warnings
from collections import deque
from pathlib import Path
from types import FrameType
from typing import Final

from tests.support.malformed import KINDS, readings

PATIENCE: Final = 10.0


class _TooLongError(Exception):
    """A call has taken longer than it may."""


def _give_up(_signal: int, _frame: FrameType | None) -> None:
    raise _TooLongError


def measure(kind: str, number: int) -> str:
    """One line on so many documents of a kind."""
    slowest = 0.0
    accepted = 0
    tracebacks = 0
    slow = 0
    signal.signal(signal.SIGPROF, _give_up)
    with tempfile.TemporaryDirectory() as folder:
        # what is compiled or imported first does not count
        deque(readings(kind, 30, 4, Path(folder)), 0)
        drawn = readings(kind, number, 5, Path(folder))
        for _ in range(number):
            begin = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, PATIENCE)
            reading = next(drawn)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            slowest = max(slowest, time.process_time() - begin)
            accepted += reading.accepted
            slow += isinstance(reading.bug, _TooLongError)
            tracebacks += reading.bug is not None and not isinstance(
                reading.bug, _TooLongError
            )
    return f"{kind:10} {number:6} {accepted:8} {tracebacks:10} {slow:6} {slowest:9.2f}"


def main() -> None:
    number = int(sys.argv[1]) if sys.argv[1:] else 1000
    kinds = sys.argv[2:] or KINDS
    warnings.simplefilter("ignore", RuntimeWarning)  # of numbers near the largest
    print("kind       number accepted tracebacks > 10 s slowest/s")
    for kind in kinds:
        print(measure(kind, number), flush=True)


if __name__ == "__main__":
    main()
