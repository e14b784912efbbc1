"""Ctrl-C while compiled code runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def held_interrupts() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C; the yielded function raises the deferred `KeyboardInterrupt`, if any.

    Python may raise it while a compiled loop converts its arguments or its result, where it is not handled:
    the loop then fails with another error, or the process crashes.
    """
    held = threading.Event()

    def check() -> None:
        if held.is_set():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only the main thread receives signals
        yield check
        return
    before = signal.signal(signal.SIGINT, lambda *_: held.set())
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
    check()
