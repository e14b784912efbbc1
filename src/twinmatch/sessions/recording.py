"""A session in the making: messages as they come, brought to the disk again and again, split, and stopped
before the disk is full.

It knows neither ROS nor threads; a recorder calls it from the one thread that writes.
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
    """There is too little room to record, or to go on recording."""


class RecordingLimits(NamedTuple):
    """When to split and when to stop."""

    min_free_mb: float = 200.0
    """Room that has to stay on the disk, MB; what ends a session needs some."""
    split_mb: float = 0.0
    """A file is ended when it has this size, MB; 0: never."""
    split_s: float = 0.0
    """A file is ended when its messages span this time, s; 0: never."""


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
            folder: where the session goes; it must not exist.
            limits: when to split and to stop.
            ros_distro: ROS 2 distribution that records.
            free: says how many bytes are free where a path is; by default the file system does.

        Raises:
            DiskFullError: too little room to begin with.
            SessionError: the folder exists or cannot be made.
        """
        self.limits = limits or RecordingLimits()
        self._free = free or _free
        self._require_room(folder, "will not begin")
        self._writer = SessionWriter(folder, ros_distro=ros_distro)

    @property
    def folder(self) -> Path:
        """Where the session is."""
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
        """Announce a topic.

        Raises:
            SessionError: it was announced as another, or the disk refuses.
        """
        self._writer.add_topic(topic)

    def add_record(self, name: str, values: Mapping[str, str]) -> None:
        """Note something about the session that is no message.

        Raises:
            SessionError: the disk refuses.
        """
        self._writer.add_record(name, values)

    def write(self, name: str, data: bytes, log_time: int) -> None:
        """Write one message of an announced topic, recorded at `log_time` (ns).

        Raises:
            SessionError: the topic is not announced, the time is negative, or the disk refuses.
        """
        self._writer.write(name, data, log_time)

    def flush(self) -> None:
        """Bring everything so far to the disk, begin another file if it is time, and look at the room.

        Raises:
            DiskFullError: too little room; the session has been closed and is whole.
            SessionError: the disk refuses.
        """
        self._writer.flush()
        try:
            self._require_room(self.folder, f"stopped after {self.messages} messages")
        except DiskFullError:
            self.close()
            raise
        if self._due():
            self._writer.split()

    def close(self) -> None:
        """Finish the session.

        Raises:
            SessionError: the disk refuses.
        """
        self._writer.close()

    def _due(self) -> bool:
        part, limits = self._writer.part, self.limits
        span = (part.end - part.start) / NANOSECONDS
        return (0 < limits.split_mb <= self._writer.size / MEGABYTE) or (0 < limits.split_s <= span)

    def _require_room(self, folder: Path, consequence: str) -> None:
        free = self._free(folder) / MEGABYTE
        if free < self.limits.min_free_mb:
            msg = (
                f"recording {folder.name}: {consequence}, {free:.0f} MB are free on the disk and "
                f"{self.limits.min_free_mb:g} MB have to stay; make room or lower min_free_mb"
            )
            raise DiskFullError(msg)


def _free(path: Path) -> int:
    """Free bytes where a path is or will be."""
    place = path.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free
