"""One MCAP file of a session during writing."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from twinmatch.sessions.chunk_indexes import ChunkIndexes
from twinmatch.sessions.metadata import Part, Summary, qos_text
from twinmatch.sessions.topics import Topic

__all__ = ["CHUNK_SIZE", "SessionFile"]

CHUNK_SIZE = 64 * 1024
"""Bytes buffered before they are written: what a killed recorder loses if it never flushes."""


class SessionFile:
    """Writes topics, messages and records into one file; failures of the disk are an `OSError`."""

    def __init__(self, path: Path) -> None:
        """Create the file."""
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - takes 70 ms, not needed to read

        self.path = path
        self.counts: dict[Topic, int] = {}
        """Messages in this file, per topic."""
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._span: tuple[int, int] | None = None
        self._file = path.open("wb")
        self._mcap = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.NONE)
        # The writer keeps an object for every chunk until the end: 170 MB for a day that is flushed every
        # 0.4 s. It has no option to keep them elsewhere; a test checks that it uses this attribute.
        self._chunks = ChunkIndexes(path.parent)
        self._mcap._Writer__chunk_indices = self._chunks  # type: ignore[attr-defined]
        self._mcap.start(profile="ros2", library="twinmatch")

    @property
    def size(self) -> int:
        """Bytes written so far, without the current chunk."""
        return 0 if self._file.closed else self._file.tell()

    @property
    def part(self) -> Part:
        """The file's entry in the metadata."""
        start, end = self._span or (0, 0)
        return Part(self.path.name, start, end, sum(self.counts.values()))

    def add_topic(self, topic: Topic) -> None:
        """Add a topic that is not in the file yet."""
        schema = self._schemas.get(topic.type)
        if schema is None:
            schema = self._mcap.register_schema(topic.type, "ros2msg", topic.schema.encode())
            self._schemas[topic.type] = schema
        details = {"offered_qos_profiles": qos_text(topic.qos), "topic_type_hash": topic.type_hash}
        self._channels[topic.name] = self._mcap.register_channel(topic.name, "cdr", schema, details)
        self.counts[topic] = 0

    def write(self, topic: Topic, data: bytes, log_time: int, publish_time: int) -> None:
        """Write one message of an added topic."""
        count = self.counts[topic]
        self._mcap.add_message(self._channels[topic.name], log_time, data, publish_time, sequence=count)
        start, end = self._span or (log_time, log_time)
        self._span = min(start, log_time), max(end, log_time)
        self.counts[topic] = count + 1

    def add_record(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, after the messages so far."""
        self._mcap.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Write everything so far to the disk."""
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
            with contextlib.suppress(OSError):  # the buffer cannot be written to a full disk
                file.close()
