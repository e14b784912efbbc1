"""Small disks."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

_NEW_MOUNTS = 0x00020000
"""CLONE_NEWNS of linux/sched.h."""


def keep_mounts_to_this_process() -> None:
    """Let what is mounted from now on be seen by this process and those it starts, and vanish with them.

    So nothing stays mounted when a run of tests is killed. Where that is not permitted, no test may mount.
    """
    if ctypes.CDLL(None).unshare(_NEW_MOUNTS) == 0:
        subprocess.run(["mount", "--make-rprivate", "/"], check=True)


def fill(disk: Path) -> None:
    """Write a file that takes all the room that is left, however much has been written."""
    with (disk / "of others").open("wb", buffering=0) as stream, suppress(OSError):
        while stream.write(bytes(4096)):
            pass


@contextmanager
def small_disk(
    place: Path, kilobytes: int, *, read_only: bool = False
) -> Iterator[Path]:
    """A file system of its own in a new folder; the test is skipped where none may be mounted."""
    place.mkdir()
    options = f"size={kilobytes}k,{'ro' if read_only else 'rw'}"
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    completed = subprocess.run(words, capture_output=True, text=True, check=False)
    if completed.returncode != 0:
        pytest.skip(f"no file system may be mounted here: {completed.stderr.strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)
