"""A session being recorded: messages are written as they arrive and flushed regularly; files are split, and
recording stops before the disk is full.

It depends on neither ROS nor threads; a recorder calls it from its writing thread.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from twinmatch.sessions.errors import SessionError
from twinmatch.sessions.topics import Topic
from twinmatch.sessions.writer import SessionWriter

__all__ = ["DiskFullError", "Recording", "RecordingLimits"]

MEGABYTE = 1_000_000
NANOSECONDS = 1_000_000_000


class DiskFullError(SessionError):
    """There is too little disk space to start or continue recording."""


class RecordingLimits(NamedTuple):
    """When to split a file and when to stop."""

    min_free_mb: float = 200.0
    """Disk space that must stay free, MB; finishing a session needs some."""
    split_mb: float = 0.0
    """Size at which the next file is started, MB; 0: never."""
    split_s: float = 0.0
    """Time span of the messages at which the next file is started, s; 0: never."""


class Recording:
    """Writes messages into a session folder until it is closed or the disk is nearly full."""

    def __init__(
        self,
        folder: Path,
        limits: RecordingLimits | None = None,
        *,
        ros_distro: str = "unknown",
        free: Callable[[Path], int] | None = None,
    ) -> None:
        """Create the folder.

        Args:
            folder: folder of the session; it must not exist.
            limits: when to split and to stop.
            ros_distro: ROS 2 distribution of the recorder.
            free: returns the free bytes at a path; by default asks the file system.

        Raises:
            DiskFullError: too little disk space to start.
            SessionError: the folder exists or cannot be created.
        """
        self.limits = limits or RecordingLimits()
        self._free = free or _free
        self._require_space(folder, "not started")
        self._writer = SessionWriter(folder, ros_distro=ros_distro)

    @property
    def folder(self) -> Path:
        """Folder of the session."""
        return self._writer.folder

    @property
    def counts(self) -> Mapping[Topic, int]:
        """Messages so far, per topic."""
        return self._writer.counts

    @property
    def messages(self) -> int:
        """Messages so far."""
        return sum(self._writer.counts.values())

    def add_topic(self, topic: Topic) -> None:
        """Add a topic.

        Raises:
            SessionError: it was added with another type or QoS, or writing fails.
        """
        self._writer.add_topic(topic)

    def add_record(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record about the session.

        Raises:
            SessionError: writing fails.
        """
        self._writer.add_record(name, values)

    def write(self, name: str, data: bytes, log_time: int) -> None:
        """Write one message of an added topic, recorded at `log_time` (ns).

        Raises:
            SessionError: the topic was not added, the time is negative, or writing fails.
        """
        self._writer.write(name, data, log_time)

    def flush(self) -> None:
        """Flush to the disk, check the free space, and start the next file if it is due.

        Raises:
            DiskFullError: too little disk space; the session has been closed and is complete.
            SessionError: writing fails.
        """
        self._writer.flush()
        try:
            self._require_space(self.folder, f"stopped after {self.messages} messages")
        except DiskFullError:
            self.close()
            raise
        if self._due():
            self._writer.split()

    def close(self) -> None:
        """Finish the session.

        Raises:
            SessionError: writing fails.
        """
        self._writer.close()

    def _due(self) -> bool:
        part, limits = self._writer.part, self.limits
        span = (part.end - part.start) / NANOSECONDS
        return (0 < limits.split_mb <= self._writer.size / MEGABYTE) or (0 < limits.split_s <= span)

    def _require_space(self, folder: Path, consequence: str) -> None:
        free = self._free(folder) / MEGABYTE
        if free < self.limits.min_free_mb:
            msg = (
                f"recording {folder.name}: {consequence}: {free:.0f} MB are free on the disk, but "
                f"{self.limits.min_free_mb:g} MB must stay free; free some space or lower min_free_mb"
            )
            raise DiskFullError(msg)


def _free(path: Path) -> int:
    """Free bytes on the disk of a path, which need not exist yet."""
    place = path.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free
