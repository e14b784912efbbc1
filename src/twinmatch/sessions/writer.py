"""Writes a session: serialised messages of any type into a rosbag2 folder with MCAP files.

Nothing here knows ROS, so a live recorder and an importer write through the same object.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType

from twinmatch.sessions.errors import SessionError
from twinmatch.sessions.file import SessionFile
from twinmatch.sessions.metadata import METADATA, Part, Summary
from twinmatch.sessions.topics import Topic

__all__ = ["SessionWriter"]


class SessionWriter:
    """Writes messages into a new folder `<name>/` as `<name>_0.mcap` and, on closing, `metadata.yaml`.

    The chunks are not compressed: the messages of a torn chunk can then still be read one by one, every
    MCAP reader understands them, and the bytes do not depend on the version of a compressor.

    Every failure of the disk is a `SessionError` at the call that meets it. After one, nothing more is
    written: the file ends where the disk refused, and `read_session` reads it up to there.
    """

    def __init__(self, folder: Path | str, *, name: str | None = None, ros_distro: str = "unknown") -> None:
        """Create the folder and begin its file.

        Args:
            folder: where the session goes; it must not exist, its parents are made.
            name: the session's name, if it is not the folder's.
            ros_distro: ROS 2 distribution that records.

        Raises:
            SessionError: the folder exists, has no name, or cannot be made.
        """
        self.folder = Path(folder)
        self.name = name or self.folder.absolute().name
        if not self.name:
            msg = f"session {self.folder}: a session needs a folder with a name"
            raise SessionError(msg)
        self.counts: dict[Topic, int] = {}
        """Messages written so far, per topic."""
        self._ros_distro = ros_distro
        self._topics: dict[str, Topic] = {}
        self._records: dict[str, Mapping[str, str]] = {}
        self._parts: list[Part] = []
        self._failed = False
        self._closed = False
        self._file: SessionFile | None = None
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            msg = f"session {self.folder}: exists already; choose another name or remove it"
            raise SessionError(msg) from None
        except OSError as error:
            msg = f"session {self.folder}: the folder cannot be made ({error.strerror})"
            raise SessionError(msg) from error
        self._begin()

    @property
    def part(self) -> Part:
        """Name, span and messages of the file that is being written."""
        return Part("", 0, 0, 0) if self._file is None else self._file.part

    @property
    def size(self) -> int:
        """Bytes of that file so far, without the chunk that is being gathered."""
        return 0 if self._file is None else self._file.size

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic; doing so again changes nothing.

        Raises:
            SessionError: the name is taken by a topic of another type or QoS, or the disk refuses.
        """
        known = self._topics.get(topic.name)
        if known is not None:
            if known != topic:
                msg = f"session {self.name}: {topic.name} was added before with another type or QoS"
                raise SessionError(msg)
            return
        with self._disk() as file:
            file.add_topic(topic)
        self._topics[topic.name] = topic
        self.counts[topic] = 0

    def write(self, name: str, data: bytes, log_time: int, publish_time: int | None = None) -> None:
        """Write one serialised message.

        Args:
            name: a topic that was added.
            data: CDR bytes with their encapsulation header, as a raw subscription delivers them.
            log_time: when it was received, ns since the epoch of its clock, not negative.
            publish_time: when it was sent, ns; `log_time` if not known.

        Raises:
            SessionError: the topic was not added, the time is negative, or the disk refuses.
        """
        topic = self._topics.get(name)
        if topic is None:
            msg = f"session {self.name}: {name} was not added before its first message"
            raise SessionError(msg)
        if log_time < 0 or (publish_time or 0) < 0:
            msg = f"session {self.name}: a message of {name} has a negative time"
            raise SessionError(msg)
        with self._disk() as file:
            file.write(topic, data, log_time, log_time if publish_time is None else publish_time)
        self.counts[topic] += 1

    def add_record(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record: something about the session that is no message.

        It is repeated in every further file; one of the same name replaces the one before.

        Raises:
            SessionError: the disk refuses.
        """
        with self._disk() as file:
            file.add_record(name, values)
        self._records[name] = dict(values)

    def flush(self) -> None:
        """Bring all messages so far safely to the disk; a kill or power cut then loses only later ones.

        Raises:
            SessionError: the disk refuses.
        """
        with self._disk() as file:
            file.flush()

    def split(self) -> None:
        """Finish the file and go on in the next.

        Raises:
            SessionError: the disk refuses.
        """
        with self._disk() as file:
            file.finish(self._ros_distro)
        self._parts.append(file.part)
        self._begin()

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`. Closing again does nothing.

        Raises:
            SessionError: the disk refuses.
        """
        if self._closed:
            return
        if self._failed:
            self.abandon()
            return
        with self._disk() as file:
            file.finish(self._ros_distro)
            parts = (*self._parts, file.part)
            write_metadata(self.folder, Summary(parts, self.counts, self._ros_distro))
        self._closed = True

    def abandon(self) -> None:
        """Close the file as it is, without index and metadata."""
        self._closed = True
        if self._file is not None:
            self._file.abandon()

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _begin(self) -> None:
        path = self.folder / f"{self.name}_{len(self._parts)}.mcap"
        with self._disk(begins=True):
            self._file = SessionFile(path)
            for topic in self._topics.values():
                self._file.add_topic(topic)
            for name, values in self._records.items():
                self._file.add_record(name, values)

    @contextlib.contextmanager
    def _disk(self, *, begins: bool = False) -> Iterator[SessionFile]:
        """Turn what the disk refuses into a message, once, and write nothing afterwards."""
        if self._failed or (self._file is None and not begins):
            msg = f"session {self.name}: writing failed before; only what was written until then is kept"
            raise SessionError(msg)
        try:
            yield self._file  # type: ignore[misc]  # None only while the first file begins
        except OSError as error:
            self._failed = True
            self.abandon()
            msg = (
                f"session {self.name}: cannot be written ({error.strerror or error}) after "
                f"{sum(self.counts.values())} messages; make room or choose another folder"
            )
            raise SessionError(msg) from error


def write_metadata(folder: Path, summary: Summary) -> None:
    """Write `metadata.yaml`, so that it has its name only when it is complete."""
    path = folder / METADATA
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("w", encoding="utf-8") as file:
        file.write(summary.file_text())
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
