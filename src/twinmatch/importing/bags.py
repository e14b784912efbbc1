"""Reading any ROS bag: rosbag2 folders with MCAP or SQLite, or one file of them, and `.bag` files of ROS 1.

Message types are those in the bag, else the standard and the installed ones. The library `rosbags` reads them
without ROS. It is an extra: `pip install twinmatch[bags]`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.importing.bag_files import SCANS, definition_of, first_line, scans_of, suffix_of
from twinmatch.importing.column_map import Column, described
from twinmatch.importing.mapped import Mapped, by_signal, map_samples
from twinmatch.importing.resampling import Gaps, bridged_up_to, held_means
from twinmatch.importing.tables import Table
from twinmatch.sampling.channels import (
    Channel,
    SamplingError,
    check_path,
    fields_below,
    follow,
    usual_unit,
)
from twinmatch.sampling.sources import (
    INPUT,
    OUTPUT,
    REFERENCE,
    TIME,
    FollowedSignal,
    SignalMap,
    SignalSource,
    signals_of,
)
from twinmatch.sessions.files import ProgressCallback, RecordingError, part_of
from twinmatch.sessions.messages import Message, Topic
from twinmatch.sessions.metadata import METADATA, counts_listed, files_of, miscounted
from twinmatch.sessions.scan import Scan
from twinmatch.signals import FloatArray

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
    why: str = ""
    """Why there are none, if its messages cannot be read."""


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
        return any(file.name == METADATA or suffix_of(file) in SCANS for file in path.iterdir())
    return suffix_of(path) in SCANS


class Bag:
    """An open bag."""

    def __init__(self, path: Path, scans: Callable[[], Sequence[Scan]], notes: Sequence[str]) -> None:
        """Look through all its messages.

        Args:
            path: its folder or file.
            scans: makes new passes over its files.
            notes: what is known already of its files, as sentences.

        Raises:
            SessionError: a file is damaged, so that nothing of it can be read.
        """
        self.path = path
        self._scans = scans
        self._topics: dict[str, list[Topic]] = {}
        self._counts: Counter[str] = Counter()
        notes, start, end = [*notes], math.inf, -math.inf
        for scan in scans():
            before = self._counts.total()
            for message in scan:
                self._counts[message.topic.name] += 1
                start, end = min(start, message.log_time), max(end, message.log_time)
            for topic in scan.topics:
                self._topics.setdefault(topic.name, []).append(topic)
            read = self._counts.total() - before
            if scan.fault and not read:
                raise RecordingError(f"{scan.path}: {scan.fault}; no message can be read")
            if scan.fault:
                notes.append(f"{scan.path.name}: {scan.fault}; {read} messages were read")
        self.seconds = (end - start) / 1e9 if self._counts else 0.0
        """Duration from the first to the last message, s."""
        if path.is_dir():
            notes += miscounted(counts_listed(path), self._counts)
        self.notes = [f"{note}." for note in notes]
        """What is missing, as sentences."""

    @property
    def topics(self) -> list[BagTopic]:
        """Its topics, sorted by name."""
        return [self._topic(name) for name in sorted(self._topics)]

    @property
    def columns(self) -> list[Column]:
        """An overview of the numbers of each topic, under the names that a map uses."""
        listed = [topic for topic in self.topics if topic.messages and len(topic.numbers) <= _FIELDS]
        channels = [Channel(topic.name, path) for topic in listed for path in topic.numbers]
        columns = [
            described(channel.text, usual_unit(series.kind, series.path), series.values, ordered=False)
            for channel, series in zip(channels, self.series(channels, _ENOUGH), strict=True)
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
            most: most messages read per topic, and none of a topic with damaged ones; all if not given.
            progress: called with the number of messages read and their total.

        Raises:
            RecordingError: a topic or field is missing, or a topic has no messages or damaged ones.
        """
        checked = [self._check(channel) for channel in channels]
        rows: list[list[tuple[float, float, float]]] = [[] for _ in checked]
        wanted: dict[str, list[int]] = {}
        for k, (channel, _) in enumerate(checked):
            wanted.setdefault(channel.topic, []).append(k)
        total = sum(self._counts[name] for name in wanted)
        for done, raw in enumerate(self._messages(wanted, most), 1):
            if progress is not None and done % _EVERY == 0:
                progress(done, total)
            try:
                message = self._decoded(raw)
                stamped = _stamp(message)
                for k in wanted.get(raw.topic.name, ()):
                    rows[k].append((raw.log_time / 1e9, stamped, follow(message, checked[k][0].path)))
            except TwinmatchError:
                if most is None:
                    raise
                for k in wanted.pop(raw.topic.name):
                    rows[k].clear()
        series = []
        for (channel, kind), held in zip(checked, rows, strict=True):
            columns = np.array(held, dtype=np.float64).reshape(-1, 3).T
            series.append(Series(kind, channel.path, *columns))
        return series

    def _messages(self, topics: Collection[str], most: int | None) -> Iterator[Message]:
        """The messages of topics in the order of recording, or the first few of each; `topics` may shrink."""
        left = dict.fromkeys(topics, most or -1)  # counts down to 0, or for ever
        for message in chain.from_iterable(self._scans()) if left else ():
            name = message.topic.name
            if name in left and name in topics:
                left[name] -= 1
                yield message
                if not left[name]:
                    del left[name]
            if not left:
                return

    def _decoded(self, message: Message) -> Any:
        try:
            return definition_of(message.topic).decode(message.data)
        except Exception as error:  # the library raises many kinds for damaged bytes
            name, kind, *_ = message.topic
            what = f"a message of {len(message.data)} bytes is not a {kind} ({first_line(error)})"
            raise RecordingError(f"{self.path}: {name}: {what}") from error

    def _check(self, channel: Channel) -> tuple[Channel, str]:
        topics = self._topics
        name = channel.topic if channel.topic in topics else f"/{channel.topic.lstrip('/')}"
        if name not in topics:
            present = ", ".join(sorted(topics)[:_MANY]) or "none"
            raise RecordingError(f"{self.path}: has no topic {channel.topic}; it has {present}")
        if not self._counts[name]:
            raise RecordingError(f"{self.path}: topic {name} has no messages; map another one")
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
            raise RecordingError(f"{self.path}: {name}: {error}, or map another topic") from None

    def _topic(self, name: str) -> BagTopic:
        kinds = sorted({topic.type for topic in self._topics[name]})
        if len(kinds) > 1:
            return BagTopic(name, "several types", self._counts[name], (), " and ".join(kinds))
        try:
            numbers = tuple(fields_below(kinds[0], definition_of(self._topics[name][0]).fields_of))
        except RecordingError as error:
            return BagTopic(name, kinds[0], self._counts[name], (), str(error))
        return BagTopic(name, kinds[0], self._counts[name], numbers)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """A bag while it is open.

    Raises:
        RecordingError: the bag does not exist or is damaged, or the library that reads it is not installed.
    """
    if find_spec("rosbags") is None:
        msg = f"{path}: to read bags, install rosbags: pip install 'twinmatch[bags]'"
        raise RecordingError(msg)
    if not path.exists():
        raise RecordingError(f"{path}: does not exist")
    files, notes = files_of(path, lambda file: suffix_of(file) in SCANS) if path.is_dir() else ([path], [])
    if not files or len({suffix_of(file) for file in files}) > 1:
        what = "has files of several kinds; give one of them" if files else f"has no {', '.join(SCANS)} file"
        raise RecordingError(f"{path}: {what}")
    with scans_of(files) as scans:
        yield Bag(path, scans, notes)


def _stamp(message: Any) -> float:
    """The stamp of the header, s since 1970; nan without one."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = float("nan") if stamp is None else stamp.sec + stamp.nanosec / 1e9
    return seconds or float("nan")


_ASTRAY: Final = 1.0
"""If headers and the bag's clock differ by more, s, the headers are of another clock."""


class _Signal(NamedTuple):
    time: FloatArray
    """s since 1970, increasing, shape (N,)."""
    values: FloatArray


def map_bag(
    path: Path,
    given: SignalMap,
    plant: type[Plant],
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
    progress: ProgressCallback | None = None,
) -> Mapped:
    """The samples of a plant from a bag.

    The arguments are those of `map_samples`, with the folder of the bag in place of a table, and topics and
    fields in place of columns; `progress` is called with the number of messages read and their total.

    Raises:
        RecordingError: as `open_bag`, `Bag.series` and `map_samples`; a signal that is not mapped.
        PlantError: the plant has several outputs or inputs.
    """
    _ = plant.output, plant.drive  # the rows are those of the only output
    sources = by_signal(plant, given.sources)
    if TIME in sources:
        raise RecordingError("--map time: a bag has the times of its messages; leave it out")
    for name in (OUTPUT, INPUT):
        if name not in sources:
            msg = f"{path}: no topic is mapped to {name}; add --map {name}=TOPIC:FIELD (--list shows them)"
            raise RecordingError(msg)
    with open_bag(path) as bag:
        signals, notes = _read(bag, plant, sources, progress)
        notes = [*bag.notes, *notes]
    columns, left_out = _rows(signals, longest)
    if columns[TIME].size < 2:
        msg = f"{path}: fewer than two readings of {sources[OUTPUT].text} follow the first input; check --map"
        raise RecordingError(msg)
    if left_out:
        notes.append(f"The first {left_out} readings precede the first input or set-point and are left out.")
    table = Table(path, columns, range(left_out + 1, left_out + 1 + columns[TIME].size), "reading")
    named = {name: SignalSource((name,)) for name in columns}  # the values are in the plant's units
    given = SignalMap(named, given.plant, given.period)
    run = map_samples(table, given, plant, longest=longest, gaps=gaps)
    return run._replace(sources=sources, notes=[*run.notes, *notes])


def _read(
    bag: Bag, plant: type[Plant], sources: Mapping[str, SignalSource], progress: ProgressCallback | None
) -> tuple[dict[str, _Signal], list[str]]:
    """Signals in the plant's units with their times, and notes."""
    known, followed, recorded = signals_of(plant), {}, {}
    for number, (name, source) in enumerate(sources.items()):
        progress_here = part_of(progress, number, len(sources))
        recorded[name] = held = bag.series(source.channels(name), progress=progress_here)
        channels = [Channel(c.topic, s.path) for c, s in zip(source.channels(name), held, strict=True)]
        try:
            followed[name] = source.follow(name, known[name].unit, channels, [s.kind for s in held])
        except SamplingError as error:
            raise RecordingError(f"{bag.path}: {error}") from None
    offsets = [
        f"{followed[name].channels[0].topic} by {off:.3g} s"
        for name, held in recorded.items()
        if (off := max(map(_clock_offset, held))) > _ASTRAY
    ]
    notes = []
    if offsets:
        notes.append(
            f"The headers have another clock ({', '.join(offsets)}); the times of the bag are used instead."
        )
    logged = bool(offsets)
    return {n: _signal_of(bag.path, n, followed[n], held, logged) for n, held in recorded.items()}, notes


def _clock_offset(series: Series) -> float:
    """Median distance of the headers from the bag's clock, s; 0 without headers."""
    apart = np.abs(series.logged - series.stamped)
    return float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else 0.0


def _signal_of(path: Path, name: str, signal: FollowedSignal, series: list[Series], logged: bool) -> _Signal:
    """A signal in the plant's unit, at the times of its first channel."""
    rising = [_growing(path, name, one, logged) for one in series]
    time = rising[0].time
    values = [rising[0].values, *(np.interp(time, other.time, other.values) for other in rising[1:])]
    return _Signal(time, signal.value(values))


def _growing(path: Path, name: str, series: Series, logged: bool) -> _Signal:
    time = series.logged if logged else np.where(np.isfinite(series.stamped), series.stamped, series.logged)
    kept = np.isfinite(series.values)
    if not kept.any():
        raise RecordingError(f"{path}: no message of {name} has a number; map another field")
    time, values = time[kept], series.values[kept]
    # Messages are sorted by time, since some arrive out of order; of several at one time the last is kept.
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    last = np.append(np.diff(time) > 0, True)
    return _Signal(time[last], values[last])


def _rows(signals: Mapping[str, _Signal], longest: float | None) -> tuple[dict[str, FloatArray], int]:
    """Columns of a table by signal, and the number of readings left out before its first row."""
    output = signals[OUTPUT]
    starts = [signals[name].time[0] for name in (INPUT, REFERENCE) if name in signals]
    begin = int(np.searchsorted(output.time, max(starts)))
    time = output.time[begin:]
    columns = {TIME: time, OUTPUT: output.values[begin:]}
    if time.size > 1:  # fewer are refused
        for name, signal in signals.items():
            if name == INPUT:
                columns[name] = _means(signal, time, longest)
            elif name == REFERENCE:
                columns[name] = signal.values[np.searchsorted(signal.time, time, side="right") - 1]
            elif name != OUTPUT:
                columns[name] = np.interp(time, signal.time, signal.values)
    return columns, begin


def _means(signal: _Signal, time: FloatArray, longest: float | None) -> FloatArray:
    """Mean of the held signal from each time to the next; before a gap and at the end, over a median step."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    ends = np.append(time[1:], time[-1] + usual)
    wide = np.flatnonzero(steps > bridged_up_to(time, longest))
    ends[wide] = time[wide] + usual
    return held_means(signal.time, signal.values, time, ends, ends - time)


_ENOUGH: Final = 2000
"""Messages read per topic."""
_FIELDS: Final = 20
"""Most numbers in a listed message; messages with more are images and point clouds."""
