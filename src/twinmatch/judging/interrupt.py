"""Ctrl-C that waits until compiled code has returned."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["held_interrupts"]


@contextmanager
def held_interrupts() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back; the function given raises the `KeyboardInterrupt` that was held, if any.

    Python may raise it while a compiled loop takes its arguments or gives its result, where nothing is
    ready for that: the loop then fails with another error, or the process crashes.
    """
    held = threading.Event()

    def check() -> None:
        if held.is_set():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one gets signals
        yield check
        return
    before = signal.signal(signal.SIGINT, lambda *_: held.set())
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
    check()
