"""Ends what an FMU's process started: programs that outlive it or left its process group.

Each FMU's process has a mark in its environment, which everything it starts inherits. Build servers find the
remains of a build in the same way.
"""

from __future__ import annotations

import contextlib
import os
import signal
from pathlib import Path
from typing import Final

__all__ = ["MARK", "end_marked"]

MARK: Final = "TWINMATCH_FMU"
"""Environment variable with the mark."""
_ROUNDS: Final = 20
"""Most searches: a process that is found may just have started another one."""


def end_marked(mark: str) -> None:
    """Kill all other processes with this mark in their environment."""
    wanted = f"{MARK}={mark}".encode()
    for _ in range(_ROUNDS):
        found = _marked(wanted)
        if not found:
            return
        for process in found:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)


def _marked(wanted: bytes) -> list[int]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        if int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            if wanted in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
    return found
