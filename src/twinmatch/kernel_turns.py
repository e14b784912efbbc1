"""One process at a time compiles a kernel; the others wait for what it keeps on disk.

Processes that begin together, such as the nodes of a graph, need the same kernels at the same time.
"""

from __future__ import annotations

import contextlib
import fcntl
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

PATIENCE: Final = 120.0
"""Longest time to wait for another process, s: a process that was stopped must not stop all others. The
largest kernel takes 7 s of processor time."""
_PAUSE: Final = 0.02
"""Time between two attempts, s."""


class KernelTurn:
    """The right of this process to compile a kernel: a lock that ends with the process, however that ends.

    It says nothing of what is on disk: a process that has waited looks there again. If it cannot be had, as on a disk
    without locks, the process compiles nevertheless: all compile the same.
    """

    def __init__(self, kernel: str) -> None:
        """The turn at a kernel of this name."""
        self._kernel = kernel
        self._locks = contextlib.ExitStack()

    def take(self, folder: str, wait_with: Callable[[], None]) -> None:
        """Wait until no other process compiles this kernel, at most `PATIENCE`.

        Args:
            folder: where the kernel is kept.
            wait_with: called once if another process has to be waited for.
        """
        self.give_back()
        with contextlib.suppress(OSError):
            file = (Path(folder) / f"{self._kernel}.lock").open("ab")
            self._locks.enter_context(file)
            if self._is_free(file.fileno()):
                return
            wait_with()
            latest = time.monotonic() + PATIENCE
            while time.monotonic() < latest:
                time.sleep(_PAUSE)
                if self._is_free(file.fileno()):
                    return

    def give_back(self) -> None:
        """Let other processes have it; nothing if this process does not."""
        self._locks.close()

    def _is_free(self, lock: int) -> bool:
        """Whether the lock was free; this process has it from now on."""
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
