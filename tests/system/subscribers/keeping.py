"""What is built of the messages, kept in build/ from run to run."""

from __future__ import annotations

import fcntl
import hashlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import distributions
from pathlib import Path


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """One test run at a time prepares it."""
    path.parent.mkdir(exist_ok=True)
    with path.open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


def depends_on(sources: Path) -> list[Path]:
    """What is built from: messages, services, and how they are built."""
    globs = ("msg/*.msg", "srv/*.srv", "*.toml", "*.txt", "*.xml", "setup.py")
    return sorted(path for glob in globs for path in sources.glob(glob))


def key_of(sources: Path, *files: Path) -> str:
    """What it depends on: those files, others, the interpreter and its ROS wheels."""
    digest = hashlib.sha256(f"{sys.version} {sys.prefix}".encode())
    for path in (*depends_on(sources), *files):
        digest.update(path.name.encode() + path.read_bytes())
    wheels = sorted(
        f"{d.name}=={d.version}" for d in distributions() if d.name.startswith("ros-")
    )
    digest.update(" ".join(wheels).encode())
    return digest.hexdigest()[:16]
