"""How many threads the libraries of linear algebra start.

They start one for each core when numpy is imported, and each waits for work in a loop for some milliseconds
before it sleeps. The matrices here are too small for them: one thread is quicker.
"""

from __future__ import annotations

import os
from typing import Final

__all__ = ["ONE_THREAD", "start_one_thread"]

ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""Environment of a process whose linear algebra has one thread; it is read when numpy is imported."""


def start_one_thread() -> None:
    """Have linear algebra use one thread in this process, which has not imported numpy yet, and in those that
    it starts; if the user has set one of the variables, all stay as they are."""
    if ONE_THREAD.keys().isdisjoint(os.environ):
        os.environ.update(ONE_THREAD)
