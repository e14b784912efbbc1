"""Reading any ROS bag: rosbag2 folders with MCAP or SQLite, or one file of them, and `.bag` files of ROS 1.

Message types are those in the bag, else the standard and the installed ones. The library `rosbags` reads them
without ROS. It is an extra: `pip install twinmatch[bags]`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.errors import TwinmatchError
from twinmatch.importing.bag_files import (
    SCANS,
    definition_of,
    first_line,
    scans_of,
    suffix_of,
)
from twinmatch.importing.column_map import Column, described
from twinmatch.sampling.channels import (
    Channel,
    Followed,
    SamplingError,
    by_name,
    check_path,
    fields_below,
    usual_unit,
)
from twinmatch.sessions.files import ProgressCallback, RecordingError
from twinmatch.sessions.messages import Message, Topic
from twinmatch.sessions.metadata import METADATA, counts_listed, files_of, miscounted
from twinmatch.sessions.scan import Scan
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class BagTopic(NamedTuple):
    """A topic of a bag."""

    name: str
    kind: str
    """Message type."""
    messages: int
    numbers: tuple[str, ...]
    """Paths of the numbers in a message."""
    why: str = ""
    """Why its messages cannot be read; empty if they can."""


class Series(NamedTuple):
    """The numbers of a channel as recorded."""

    kind: str
    """Message type."""
    path: str
    """Path of the number in a message."""
    place: FloatArray
    """Place of each message among those read, in the order of recording, shape (N,)."""
    logged: FloatArray
    """Times of recording, s since 1970, shape (N,)."""
    stamped: FloatArray
    """Header stamps, s since 1970, shape (N,); nan without a header."""
    values: FloatArray
    """Shape (N,)."""

    @property
    def has_stamp(self) -> NDArray[np.bool_]:
        """Which messages have a header stamp, shape (N,)."""
        return np.isfinite(self.stamped)


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag."""
    if path.is_dir():
        return any(
            file.name == METADATA or suffix_of(file) in SCANS for file in path.iterdir()
        )
    return suffix_of(path) in SCANS


class Bag:
    """An open bag."""

    MAX_TOPICS: Final = 1000
    """Most topics of a bag: graphs of robots have some hundreds."""
    _MOST_LISTED: Final = 40
    """Most topics that an error lists."""
    PROGRESS_EVERY: Final = 500
    """Messages between two reports of progress."""

    def __init__(
        self, path: Path, scans: Callable[[], Sequence[Scan]], notes: Sequence[str]
    ) -> None:
        """Look through all its messages.

        Args:
            path: its folder or file.
            scans: makes new passes over its files.
            notes: sentences about its files, without full stop, such as that one is missing.

        Raises:
            RecordingError: there are too many topics, or a file is damaged and nothing of it can be read.
        """
        self.path = path
        self._scans = scans
        self._topics: dict[str, list[Topic]] = {}
        self._counts: Counter[str] = Counter()
        faults = []
        first = math.inf
        last = -math.inf
        for scan in scans():
            counted_before = self._counts.total()
            for message in scan:
                self._counts[message.topic.name] += 1
                first = min(first, message.log_time)
                last = max(last, message.log_time)
            self._add_topics(scan.topics)
            if scan.fault:
                faults.append(_partly_read(scan, self._counts.total() - counted_before))
        self.seconds = (last - first) / 1e9 if self._counts else 0.0
        """Duration from the first to the last message, s."""
        missing = miscounted(counts_listed(path), self._counts) if path.is_dir() else []
        self.notes = [f"{note}." for note in (*notes, *faults, *missing)]
        """What is missing, as sentences."""

    def _add_topics(self, topics: Sequence[Topic]) -> None:
        for topic in topics:
            self._topics.setdefault(topic.name, []).append(topic)
        if len(self._topics) > self.MAX_TOPICS:
            raise RecordingError(
                f"{self.path}: has {len(self._topics)} topics, more than {self.MAX_TOPICS}; copy those of "
                "the plant into a bag of their own: ros2 bag convert"
            )

    @property
    def topics(self) -> list[BagTopic]:
        """Its topics, sorted by name; elements of lists go by their names, if messages give them any."""
        topics = {name: self._overview_of(name) for name in sorted(self._topics)}
        paths_by_name: dict[str, dict[str, None]] = {  # sets that keep their order
            name: {}
            for name, topic in topics.items()
            if len(topic.numbers) <= _LISTING.numbers
        }
        for raw in self._messages(paths_by_name, _LISTING.for_names):
            with suppress(TwinmatchError):  # damage is reported where a channel is read
                message = self._decoded(raw)
                for path in topics[raw.topic.name].numbers:
                    paths_by_name[raw.topic.name] |= dict.fromkeys(
                        by_name(message, path)
                    )
        return [
            topic._replace(numbers=tuple(paths_by_name.get(name, ())) or topic.numbers)
            for name, topic in topics.items()
        ]

    @property
    def columns(self) -> list[Column]:
        """An overview of the numbers of each topic, under the names that a map uses."""
        listed = [
            topic for topic in self.topics if topic.messages and _can_be_listed(topic)
        ]
        channels = [
            Channel(topic.name, path) for topic in listed for path in topic.numbers
        ]
        columns = [
            described(
                channel.text,
                usual_unit(series.kind, series.path),
                series.values,
                ordered=False,
            )
            for channel, series in zip(
                channels, self.series(channels, _LISTING.messages), strict=True
            )
            if series.values.size
        ]
        return [column for column in columns if column.kind != "text"]

    def series(
        self,
        channels: Sequence[Channel],
        most: int | None = None,
        progress: ProgressCallback | None = None,
    ) -> list[Series]:
        """The numbers of channels, each as recorded.

        Args:
            channels: topics and paths.
            most: most messages read per topic; a topic with a damaged one then has no numbers. If not given,
                all are read.
            progress: called with the number of messages read and their total.

        Raises:
            RecordingError: a topic or field is missing, or a topic has no messages or damaged ones.
        """
        readings = [_ChannelReadings(*self._resolved(channel)) for channel in channels]
        by_topic: dict[str, list[_ChannelReadings]] = {}
        for channel_readings in readings:
            by_topic.setdefault(channel_readings.channel.topic, []).append(
                channel_readings
            )
        total = sum(self._counts[name] for name in by_topic)
        for place, raw in enumerate(self._messages(by_topic, most), 1):
            if progress is not None and place % self.PROGRESS_EVERY == 0:
                progress(place, total)
            try:
                message = self._decoded(raw)
                for channel_readings in by_topic[raw.topic.name]:
                    channel_readings.take(place, raw, message)
            except TwinmatchError as error:
                if most is None:
                    raise self._named_error(error) from None
                for channel_readings in by_topic.pop(raw.topic.name):
                    channel_readings.clear()
        return [channel_readings.series() for channel_readings in readings]

    def _named_error(self, error: TwinmatchError) -> RecordingError:
        """The error with the path of the bag, which a `RecordingError` names already."""
        return (
            error
            if isinstance(error, RecordingError)
            else RecordingError(f"{self.path}: {error}")
        )

    def _messages(self, topics: Collection[str], most: int | None) -> Iterator[Message]:
        """The messages of topics in the order of recording: of each the first `most`, or all.

        The caller may remove topics of which it wants no further message.
        """
        remaining = dict.fromkeys(topics, most or -1)  # from -1 it never reaches 0
        if not remaining:
            return
        for message in chain.from_iterable(self._scans()):
            name = message.topic.name
            if name in remaining and name in topics:
                remaining[name] -= 1
                yield message
                if not remaining[name]:
                    del remaining[name]
            if not remaining:
                return

    def _decoded(self, message: Message) -> Any:
        try:
            return definition_of(message.topic).decode(message.data)
        except Exception as error:  # the library raises many kinds for damaged bytes
            name, kind, *_ = message.topic
            problem = f"a message of {len(message.data)} bytes is not a {kind} ({first_line(error)})"
            raise RecordingError(f"{self.path}: {name}: {problem}") from error

    def _resolved(self, channel: Channel) -> tuple[Channel, str]:
        """The channel with names as the bag has them, and its message type.

        Raises:
            RecordingError: it is not in the bag, or cannot be read.
        """
        topics = self._topics
        name = (
            channel.topic
            if channel.topic in topics
            else f"/{channel.topic.lstrip('/')}"
        )
        if name not in topics:
            present = ", ".join(sorted(topics)[: self._MOST_LISTED]) or "none"
            raise RecordingError(
                f"{self.path}: has no topic {channel.topic}; it has {present}"
            )
        if not self._counts[name]:
            raise RecordingError(
                f"{self.path}: topic {name} has no messages; map another one"
            )
        kinds = {topic.type for topic in topics[name]}
        if len(kinds) > 1:
            raise RecordingError(
                f"{self.path}: topic {name} was recorded with several types; map another one"
            )
        (kind,) = kinds
        try:
            for topic in topics[name]:
                path = check_path(kind, channel.path, definition_of(topic).fields_of)
            return Channel(name, path), kind
        except SamplingError as error:
            raise RecordingError(f"{self.path}: {channel.text}: {error}") from None
        except RecordingError as error:
            raise RecordingError(
                f"{self.path}: {name}: {error}, or map another topic"
            ) from None

    def _overview_of(self, name: str) -> BagTopic:
        """A topic, with the numbers of its messages if these can be read."""
        kinds = sorted({topic.type for topic in self._topics[name]})
        if len(kinds) > 1:
            return BagTopic(
                name, "several types", self._counts[name], (), " and ".join(kinds)
            )
        try:
            numbers = tuple(
                fields_below(kinds[0], definition_of(self._topics[name][0]).fields_of)
            )
        except RecordingError as error:
            return BagTopic(name, kinds[0], self._counts[name], (), str(error))
        return BagTopic(name, kinds[0], self._counts[name], numbers)


class _ChannelReadings:
    """The numbers of a channel, taken message by message."""

    def __init__(self, channel: Channel, kind: str) -> None:
        """Begin without numbers."""
        self.channel = channel
        self._kind = kind
        self._followed = Followed(channel)
        self._rows: list[tuple[float, float, float, float]] = []

    def take(self, place: int, raw: Message, message: Any) -> None:
        """Take the number in the `place`-th message: `raw` as recorded, `message` decoded."""
        number = self._followed.number(message)
        if number is not None:
            # else it is about other elements, perhaps of another publisher
            self._rows.append((place, raw.log_time / 1e9, _stamp(message), number))

    def clear(self) -> None:
        """Forget all numbers."""
        self._rows.clear()

    def series(self) -> Series:
        """The numbers taken so far."""
        columns = np.array(self._rows, dtype=np.float64).reshape(-1, 4).T
        return Series(self._kind, self.channel.path, *columns)


def _partly_read(scan: Scan, messages: int) -> str:
    """A sentence on the fault of a file, and how many messages were read in spite of it.

    Raises:
        RecordingError: no message was read.
    """
    if not messages:
        raise RecordingError(f"{scan.path}: {scan.fault}; no message can be read")
    return f"{scan.path.name}: {scan.fault}; {messages} messages were read"


def _can_be_listed(topic: BagTopic) -> bool:
    """Whether its messages have few enough numbers for an overview; a list counts as one."""
    return len({path.split("[")[0] for path in topic.numbers}) <= _LISTING.numbers


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """A bag while it is open.

    Raises:
        RecordingError: the bag does not exist or is damaged, or the library that reads it is not installed.
    """
    if find_spec("rosbags") is None:
        raise RecordingError(
            f"{path}: to read bags, install rosbags: pip install 'twinmatch[bags]'"
        )
    if not path.exists():
        raise RecordingError(f"{path}: does not exist")
    files, notes = (
        files_of(path, lambda file: suffix_of(file) in SCANS)
        if path.is_dir()
        else ([path], [])
    )
    if not files or len({suffix_of(file) for file in files}) > 1:
        problem = (
            "has files of several kinds; give one of them"
            if files
            else f"has no {', '.join(SCANS)} file"
        )
        raise RecordingError(f"{path}: {problem}")
    with scans_of(files) as scans:
        yield Bag(path, scans, notes)


def _stamp(message: Any) -> float:
    """The stamp of the header, s since 1970; nan without one."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = float("nan") if stamp is None else stamp.sec + stamp.nanosec / 1e9
    return seconds or float("nan")


class BagListing(Rule):
    """How much of a bag is read for a list of its numbers."""

    messages: int = 2000
    """Read per topic."""
    for_names: int = 50
    """Messages read per topic for the names of elements: several publishers may take turns."""
    numbers: int = 20
    """Most numbers in a listed message; messages with more are images and point clouds."""


_LISTING: Final = BagListing()
