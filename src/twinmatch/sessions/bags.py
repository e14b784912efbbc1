"""Reading any ROS bag: rosbag2 folders with MCAP or SQLite, or one file of them, and `.bag` files of ROS 1.

The library `rosbags` reads them without ROS; message types are those in the bag, or the standard ones if an
old bag has none. It is an extra: `pip install twinmatch[bags]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.files import ProgressCallback
from twinmatch.sessions.sampling import Channel, Field, SamplingError, check_path, fields_below, follow
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

__all__ = ["Bag", "BagTopic", "Series", "is_bag", "open_bag"]

_FILES: Final = (".mcap", ".db3", ".bag")
_METADATA: Final = "metadata.yaml"
_MANY: Final = 40
"""Topics that an error lists."""
_EVERY: Final = 500
"""Messages between two reports of progress."""


class BagTopic(NamedTuple):
    """A topic of a bag."""

    name: str
    kind: str
    """Message type."""
    messages: int
    numbers: tuple[str, ...]
    """Paths of the numbers in a message."""


class Series(NamedTuple):
    """The numbers of a channel as recorded."""

    kind: str
    """Message type."""
    path: str
    """Path of the number in a message."""
    logged: FloatArray
    """Times of recording, s since 1970, shape (N,)."""
    stamped: FloatArray
    """Header stamps, s since 1970, shape (N,); nan without a header."""
    values: FloatArray
    """Shape (N,)."""


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag."""
    if path.is_dir():
        return any(file.name == _METADATA or file.suffix.lower() in _FILES for file in path.iterdir())
    return path.suffix.lower() in _FILES


class Bag:
    """An open bag."""

    def __init__(self, path: Path, reader: AnyReader) -> None:
        """Wrap an open reader."""
        self.path = path
        self._reader = reader

    @property
    def topics(self) -> list[BagTopic]:
        """Its topics, sorted by name."""
        return [self._topic(name) for name in sorted(self._reader.topics)]

    @property
    def seconds(self) -> float:
        """Duration from the first to the last message, s."""
        return float(self._reader.duration) / 1e9

    def fields_of(self, kind: str) -> Mapping[str, Field]:
        """The fields of a message type."""
        return {name: _field(described) for name, described in self._reader.typestore.fielddefs[kind][1]}

    def series(
        self,
        channels: Sequence[Channel],
        most: int | None = None,
        progress: ProgressCallback | None = None,
    ) -> list[Series]:
        """The numbers of channels, each as recorded.

        Args:
            channels: topics and paths.
            most: most messages read per topic; all if not given.
            progress: called with the number of messages read and their total.

        Raises:
            RecordingError: a topic or field is missing, or a topic has no messages or damaged ones.
        """
        found = [self._checked(channel) for channel in channels]
        rows: list[list[tuple[float, float, float]]] = [[] for _ in found]
        done, total = 0, sum(self._reader.topics[name].msgcount for name in {c.topic for c, _ in found})
        for topic in dict.fromkeys(channel.topic for channel, _ in found):
            wanted = [k for k, (channel, _) in enumerate(found) if channel.topic == topic]
            for count, (logged, message) in enumerate(self._messages(topic)):
                if most is not None and count == most:
                    break
                done += 1
                if progress is not None and done % _EVERY == 0:
                    progress(done, total)
                stamped = _stamp(message)
                for k in wanted:
                    rows[k].append((logged, stamped, follow(message, found[k][0].path)))
        series = []
        for (channel, kind), held in zip(found, rows, strict=True):
            columns = np.array(held, dtype=np.float64).reshape(-1, 3).T
            series.append(Series(kind, channel.path, *columns))
        return series

    def _checked(self, channel: Channel) -> tuple[Channel, str]:
        """The channel with its path, and the type of its messages."""
        topics = self._reader.topics
        name = channel.topic if channel.topic in topics else f"/{channel.topic.lstrip('/')}"
        if name not in topics:
            present = ", ".join(sorted(topics)[:_MANY]) or "none"
            raise RecordingError(f"{self.path}: has no topic {channel.topic}; it has {present}")
        if not topics[name].msgcount:
            raise RecordingError(f"{self.path}: topic {name} has no messages; map another one")
        kind = topics[name].msgtype
        if kind is None:
            raise RecordingError(
                f"{self.path}: topic {name} was recorded with several types; map another one"
            )
        try:
            return Channel(name, check_path(kind, channel.path, self.fields_of)), kind
        except SamplingError as error:
            raise RecordingError(f"{self.path}: {channel.text}: {error}") from None
        except KeyError:
            raise RecordingError(
                f"{self.path}: {name}: the bag does not contain the definition of {kind}; map another topic"
            ) from None

    def _messages(self, topic: str) -> Iterator[tuple[float, Any]]:
        connections = self._reader.topics[topic].connections
        for connection, logged, raw in self._reader.messages(connections):
            yield logged / 1e9, self._reader.deserialize(raw, connection.msgtype)

    def _topic(self, name: str) -> BagTopic:
        info = self._reader.topics[name]
        kind = info.msgtype or "several types"
        try:
            numbers = tuple(fields_below(kind, self.fields_of))
        except KeyError:
            numbers = ()
        return BagTopic(name, kind, info.msgcount, numbers)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """A bag while it is open.

    Raises:
        RecordingError: the bag does not exist or is damaged, or the library that reads it is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader  # noqa: PLC0415 — an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError:
        msg = f"{path}: to read bags, install rosbags: pip install 'twinmatch[bags]'"
        raise RecordingError(msg) from None
    if not path.exists():
        raise RecordingError(f"{path}: does not exist")
    if path.is_dir() and not (path / _METADATA).is_file():
        raise RecordingError(f"{path}: has no {_METADATA}; give the folder of a rosbag2 bag")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            yield Bag(path, reader)
    except TwinmatchError:
        raise
    except Exception as error:  # the library raises many kinds for damaged bytes
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordingError(f"{path}: cannot be read as a bag, or is damaged ({why})") from error


def _stamp(message: Any) -> float:
    """The stamp of the header, s since 1970; nan without one."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = float("nan") if stamp is None else stamp.sec + stamp.nanosec / 1e9
    return seconds or float("nan")


def _field(described: Any) -> Field:
    """Convert a field description of rosbags: a pair of node kind and content."""
    node, of = described
    name = node.name
    if name in ("ARRAY", "SEQUENCE"):
        inner, length = of
        return _field(inner)._replace(array=True, length=length if name == "ARRAY" else None)
    return Field(of[0] if name == "BASE" else of)
