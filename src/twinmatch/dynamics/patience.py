"""A time limit for the code of a plant's file, which may loop for ever."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

__all__ = ["PATIENCE", "TooLongError", "at_most"]

PATIENCE: Final = 60.0
"""Time for loading a plant's file, and for one call of its equations, s. Both take well below a second, or
some seconds if the file reads a table or imports a large library."""


class TooLongError(Exception):
    """The code took longer than its limit."""


@contextmanager
def at_most(seconds: float = PATIENCE) -> Iterator[None]:
    """Raise `TooLongError` in this thread if the block takes longer.

    It interrupts Python code between two instructions, but no call that waits in C, such as `time.sleep`.
    """
    thread, lock, done = ctypes.c_ulong(threading.get_ident()), threading.Lock(), False

    def stop() -> None:
        with lock:
            if not done:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, ctypes.py_object(TooLongError))

    timer = threading.Timer(seconds, stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        with lock:
            done = True
        timer.cancel()
