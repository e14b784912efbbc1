"""Writes a session: serialised messages of any type into a rosbag2 folder with MCAP files.

It does not depend on ROS, so a live recorder and an importer use the same class.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from twinmatch.sessions.files import DiskError, SessionError, open_regular
from twinmatch.sessions.messages import Topic
from twinmatch.sessions.metadata import METADATA, Part, Summary, qos_text

if TYPE_CHECKING:
    from mcap.data_stream import RecordBuilder
    from mcap.records import ChunkIndex

CHUNK_SIZE = 64 * 1024
"""Bytes buffered before they are written: what a killed recorder loses if it never flushes."""
LIBRARY = "twinmatch"
"""What the files of a session name as the program that wrote them."""
BLOCK = 1 << 20
"""Bytes written to the summary at once."""


class _Block(NamedTuple):
    """Encoded chunk index records for the summary."""

    data: bytes

    def write(self, stream: RecordBuilder) -> None:
        stream.write(self.data)


class _ChunkIndexes:
    """Replaces the list in which a writer collects its chunk indexes.

    Its file in the folder has no name: it vanishes with the process, however it ends.
    """

    def __init__(self, folder: Path) -> None:
        from mcap.data_stream import RecordBuilder  # noqa: PLC0415

        self._file = tempfile.TemporaryFile(dir=folder, prefix=".chunks-")  # noqa: SIM115
        self._record = RecordBuilder()

    def append(self, index: ChunkIndex) -> None:
        index.write(self._record)
        self._file.write(self._record.end())  # type: ignore[no-untyped-call]

    def __iter__(self) -> Iterator[_Block]:
        self._file.seek(0)
        while data := self._file.read(BLOCK):
            yield _Block(data)

    def close(self) -> None:
        self._file.close()


class _SessionFile:
    """Writes topics, messages and records into one file; failures of the disk are an `OSError`."""

    def __init__(self, path: Path) -> None:
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415

        self.path = path
        self.counts: dict[Topic, int] = {}
        """Messages in this file, per topic."""
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._span: tuple[int, int] | None = None
        self._file = path.open("wb")
        with contextlib.suppress(OSError):  # some file systems have no locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._mcap = Writer(
            self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.NONE
        )
        # The writer keeps an object for every chunk until the end: 170 MB for a day that is flushed every
        # 0.4 s. It has no option to keep them elsewhere; a test checks that it uses this attribute.
        self._chunks = _ChunkIndexes(path.parent)
        self._mcap._Writer__chunk_indices = self._chunks  # type: ignore[attr-defined]
        self._mcap.start(profile="ros2", library=LIBRARY)

    def hold(self) -> int:
        """A handle that keeps the file locked after it has been closed."""
        return os.dup(self._file.fileno())

    @property
    def size(self) -> int:
        """Bytes written so far, without the current chunk."""
        return 0 if self._file.closed else self._file.tell()

    @property
    def part(self) -> Part:
        start, end = self._span or (0, 0)
        return Part(self.path.name, start, end, sum(self.counts.values()))

    def add_topic(self, topic: Topic) -> None:
        schema = self._schemas.get(topic.type)
        if schema is None:
            schema = self._mcap.register_schema(
                topic.type, "ros2msg", topic.schema.encode()
            )
            self._schemas[topic.type] = schema
        details = {
            "offered_qos_profiles": qos_text(topic.qos),
            "topic_type_hash": topic.type_hash,
        }
        self._channels[topic.name] = self._mcap.register_channel(
            topic.name, "cdr", schema, details
        )
        self.counts[topic] = 0

    def write(
        self, topic: Topic, data: bytes, log_time: int, publish_time: int
    ) -> None:
        count = self.counts[topic]
        self._mcap.add_message(
            self._channels[topic.name], log_time, data, publish_time, sequence=count
        )
        start, end = self._span or (log_time, log_time)
        self._span = min(start, log_time), max(end, log_time)
        self.counts[topic] = count + 1

    def add_record(self, name: str, values: Mapping[str, str]) -> None:
        self._mcap.add_metadata(name, dict(values))

    def flush(self) -> None:
        self._mcap.flush()  # type: ignore[no-untyped-call]
        os.fsync(self._file.fileno())

    def finish(self, ros_distro: str) -> None:
        """Write the rosbag2 record and the index, and close the file."""
        summary = Summary((self.part,), self.counts, ros_distro)
        self.add_record("rosbag2", {"serialized_metadata": summary.text()})
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self._chunks.close()

    def abandon(self) -> None:
        """Close the file without finishing it."""
        for file in (self._file, self._chunks):
            with contextlib.suppress(OSError):
                # the buffer cannot be written to a full disk
                file.close()


class SessionWriter:
    """Writes messages into a new folder `<name>/` as `<name>_0.mcap` and, on closing, `metadata.yaml`.

    Chunks are not compressed: the messages of a truncated chunk can still be read, every MCAP reader supports
    them, and the bytes do not depend on the version of a compressor.

    A failed write raises `DiskError` in the call that makes it. After that nothing more is written: the
    file ends there, and `read_session` reads it up to that point.

    Until it is closed, its newest file is locked (flock), and `being_written` says so. The lock ends with the
    process, however it ends.
    """

    def __init__(self, folder: Path | str, *, ros_distro: str = "unknown") -> None:
        """Create the folder and its first file.

        Args:
            folder: folder of the session; it must not exist, its parents are created.
            ros_distro: ROS 2 distribution of the recorder.

        Raises:
            SessionError: the folder exists or has no name; a `DiskError` if it cannot be created.
        """
        self.folder = Path(folder)
        self.name = self.folder.absolute().name
        if not self.name:
            raise SessionError(
                f"session {self.folder}: a session needs a folder with a name"
            )
        self.counts: dict[Topic, int] = {}
        """Messages written so far, per topic."""
        self._ros_distro = ros_distro
        self._topics: dict[str, Topic] = {}
        self._records: dict[str, Mapping[str, str]] = {}
        self._parts: list[Part] = []
        self._failed = False
        self._closed = False
        self._lock: int | None = None
        self._file: _SessionFile | None = None
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            msg = f"session {self.folder}: exists already; choose another name or remove it"
            raise SessionError(msg) from None
        except OSError as error:
            raise DiskError.of(self.folder, error, "to begin with") from error
        self._begin()

    @property
    def part(self) -> Part:
        """Name, span and message count of the current file."""
        return Part("", 0, 0, 0) if self._file is None else self._file.part

    @property
    def size(self) -> int:
        """Bytes in the current file, without the current chunk."""
        return 0 if self._file is None else self._file.size

    def add_topic(self, topic: Topic) -> None:
        """Add a topic; adding it again changes nothing.

        Raises:
            SessionError: a topic of that name has another type or QoS.
        """
        added = self._topics.get(topic.name)
        if added is not None:
            if added != topic:
                msg = f"session {self.name}: {topic.name} was added before with another type or QoS"
                raise SessionError(msg)
            return
        with self._disk() as file:
            file.add_topic(topic)
        self._topics[topic.name] = topic
        self.counts[topic] = 0

    def write(
        self, name: str, data: bytes, log_time: int, publish_time: int | None = None
    ) -> None:
        """Write one serialised message.

        Args:
            name: a topic that was added.
            data: CDR bytes with their encapsulation header, as delivered by a raw subscription.
            log_time: time of reception, ns since the epoch of its clock, not negative.
            publish_time: time of publication, ns; `log_time` if not known.

        Raises:
            SessionError: the topic was not added, or a time is negative.
        """
        topic = self._topics.get(name)
        if topic is None:
            raise SessionError(
                f"session {self.name}: {name} was not added before its first message"
            )
        if log_time < 0 or (publish_time or 0) < 0:
            raise SessionError(
                f"session {self.name}: a message of {name} has a negative time"
            )
        with self._disk() as file:
            file.write(
                topic,
                data,
                log_time,
                log_time if publish_time is None else publish_time,
            )
        self.counts[topic] += 1

    def add_record(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record about the session.

        It is repeated in every further file and replaces an earlier record of the same name.
        """
        with self._disk() as file:
            file.add_record(name, values)
        self._records[name] = dict(values)

    def flush(self) -> None:
        """Flush all messages to the disk; a kill or power failure then loses only later ones."""
        with self._disk() as file:
            file.flush()

    def split(self) -> None:
        """Finish the file and start the next."""
        with self._disk() as file:
            file.finish(self._ros_distro)
        self._parts.append(file.part)
        self._begin()

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`. Closing again does nothing."""
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
        self._hold(None)

    def abandon(self) -> None:
        """Close the file without writing index and metadata."""
        self._closed = True
        if self._file is not None:
            self._file.abandon()
        self._hold(None)

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self) -> None:
        path = self.folder / f"{self.name}_{len(self._parts)}.mcap"
        with self._disk(begins=True):
            self._file = _SessionFile(path)
            self._hold(self._file.hold())
            for topic in self._topics.values():
                self._file.add_topic(topic)
            for name, values in self._records.items():
                self._file.add_record(name, values)

    def _hold(self, handle: int | None) -> None:
        """Keep the lock of another file, or of none; of two files the older is released last."""
        before = self._lock
        self._lock = handle
        if before is not None:
            os.close(before)

    @contextlib.contextmanager
    def _disk(self, *, begins: bool = False) -> Iterator[_SessionFile]:
        """Turn the first failed write into a `DiskError`, and refuse to write after it."""
        if self._failed or (self._file is None and not begins):
            msg = f"session {self.name}: writing failed before; only the messages before that are kept"
            raise SessionError(msg)
        try:
            yield self._file  # type: ignore[misc]  # None only while the first file is created
        except OSError as error:
            self._failed = True
            self.abandon()
            when = f"after {sum(self.counts.values())} messages"
            raise DiskError.of(self.folder, error, when) from error


def being_written(file: Path) -> bool:
    """Whether a `SessionWriter` holds a file of its session.

    Raises:
        OSError: it cannot be opened.
    """
    with open_regular(file) as handle, contextlib.suppress(OSError):
        # some file systems have no locks
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def write_metadata(folder: Path, summary: Summary) -> None:
    """Write `metadata.yaml` atomically."""
    path = folder / METADATA
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("w", encoding="utf-8") as file:
        file.write(summary.file_text())
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
