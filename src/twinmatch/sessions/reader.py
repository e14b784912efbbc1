"""Reads a session: all its samples, and its messages as a stream.

A recorder that was killed is replaced by another one, with another folder: the pieces of one run are `run`,
`run_2`, `run_3` …, and a record in each of them but the first names the first. A new recorder fetches what
was published before it started, so the last piece usually holds the whole run.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, count, pairwise
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.sessions.cdr import current, decode_sample
from twinmatch.sessions.files import ProgressCallback, SessionError, part_of
from twinmatch.sessions.messages import SAMPLE, Message, Topic, current_topic, fields_of
from twinmatch.sessions.metadata import (
    CONTINUES,
    counts_listed,
    doubts,
    files_of,
    has_reference,
    is_mcap,
    mcap_files,
    miscounted,
    plant_of,
    repairs,
)
from twinmatch.sessions.scan import Scan, messages_of
from twinmatch.signals import Sample, Window, joined

SUFFIX = "plant/sample"
MESSAGES_BETWEEN = 5000
"""Messages between two reports of progress."""
ROUNDED: Final = 5e-3
"""Share by which a measured sampling period may be rounded."""


@dataclass(frozen=True, slots=True)
class Session:
    """One recorded run."""

    name: str
    path: Path
    """The folder or file it was read from."""
    topic: str
    """Topic the samples were published on."""
    samples: list[Sample]
    """All samples, with finite values; their indices skip ticks without a sample."""
    topics: list[Topic]
    """All topics of the session."""
    counts: dict[str, int]
    """Messages per topic name."""
    start: int
    """Log time of the earliest message, ns since the epoch of its clock."""
    end: int
    """Log time of the latest message, ns."""
    notes: list[str]
    """Remarks on the data for readers of the results, as sentences; they begin with `missing`."""
    source: Callable[[], Iterable[Message]] = field(repr=False)
    """Yields the messages from the beginning at each call."""
    records: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Metadata records of the recorder by name; the last of those with the same name."""
    plant: str = ""
    """Name of the plant; empty where it is not recorded, as in sessions of the Peltier rig."""
    has_reference: bool = True
    """Whether its set-points are meaningful; otherwise the loop is treated as unknown."""
    missing: Sequence[str] = ()
    """What was lost of it, or may be wrong, as sentences: files that are cut off, damaged or not there."""

    @property
    def duration(self) -> float:
        """Seconds from the earliest to the latest message."""
        return (self.end - self.start) / 1e9

    @property
    def period(self) -> float:
        """Sampling period, s, computed from the stamps of the samples."""
        return period_of(self.samples)

    def window(self) -> Window:
        """All samples as one window.

        Raises:
            SignalError: samples are missing, see `notes`.
        """
        return Window.from_samples(self.samples, self.period)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages, serialised, in the order in which they were recorded.

        Args:
            topics: names of the wanted topics; all if not given.

        Raises:
            SessionError: the session has no such topic, or the file no longer exists.
        """
        unknown = sorted(set(topics or ()) - self.counts.keys())
        if unknown:
            msg = f"session {self.name}: has no topic {', '.join(unknown)}; it has {_names(self.topics)}"
            raise SessionError(msg)
        for message in self.source():
            if topics is None or message.topic.name in topics:
                yield message


def read_session(
    path: Path | str, topic: str | None = None, progress: ProgressCallback | None = None
) -> Session:
    """Read a session folder or a single MCAP file of one.

    A run of several pieces, because its recorder was replaced, is one session; given the first piece, or one
    without samples, the others are read too. A piece without samples is left out, with a remark in `notes`. A
    truncated or damaged file is read as far as it can be, with a remark in `notes`. They also list where
    samples are missing because the loop had no temperature, was late, or was restarted.

    Args:
        path: the folder or the `.mcap` file.
        topic: the topic with the samples, if the session has several rigs; by default the only topic of type
            LoopSample with a name ending in `plant/sample`.
        progress: called with the bytes read and the total.

    Raises:
        SessionError: the path does not exist or is not a session; it has no plant topic, several, or no
            samples; values are not finite, or the stamps do not advance.
    """
    path = Path(path)
    pieces = pieces_of(path)
    if len(pieces) == 1:
        try:
            return _read(path, topic, progress)
        except SessionError:
            if (first := first_of(path)) == path:
                raise
            pieces = pieces_of(first)
            path = first
    sessions = []
    left_out = []
    errors = []
    for number, piece in enumerate(pieces):
        try:
            sessions.append(_read(piece, topic, part_of(progress, number, len(pieces))))
        except SessionError as error:
            errors.append(error)
            left_out.append(f"{piece.name} is left out: {error}")
    if not sessions:
        raise errors[0]
    return _join(sessions, path, left_out)


def named(name: str) -> str:
    """The name of a file as text; bytes that are not UTF-8 become escapes."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


_NUMBERED: Final = re.compile(r"(?P<first>.+)_(?P<number>[2-9]|[1-9]\d+)")


def pieces_of(path: Path) -> list[Path]:
    """The folders of the run that begins with this one, itself included, in their order."""
    pieces = [path]
    if not path.is_dir():
        return pieces
    whole = Path(os.path.realpath(path))  # `resolve` fails for circular links
    for number in count(2):
        piece = whole.with_name(f"{whole.name}_{number}")
        if not piece.is_dir() or not _continues(piece, whole.name):
            return pieces
        pieces.append(piece)
    return pieces


def first_of(path: Path) -> Path:
    """The folder that begins the run of this one: itself, unless it continues another one that is there."""
    whole = Path(os.path.realpath(path))
    match = _NUMBERED.fullmatch(whole.name)
    if match is None:
        return path
    first = whole.with_name(match["first"])
    return first if first.is_dir() and whole in pieces_of(first) else path


def _continues(piece: Path, first: str) -> bool:
    """Whether a folder says so; one whose recorder was killed at once may not even say that."""
    try:
        scan = Scan(mcap_files(piece)[0])
    except SessionError:
        return False
    with suppress(SessionError):
        next(iter(scan), None)
        if scan.records or scan.topics:
            return scan.records.get(CONTINUES, {}).get("session") == first
    return True


def _join(sessions: Sequence[Session], path: Path, left_out: Sequence[str]) -> Session:
    """Sessions of one run as one: the last that begins at its beginning, and later messages of others."""
    begin = min(session.samples[0].index for session in sessions)
    base = max(
        k for k, session in enumerate(sessions) if session.samples[0].index == begin
    )
    whole = sessions[base]
    later = sessions[base + 1 :]
    parts = (whole, *later)
    notes = [*left_out]
    if len(sessions) > 1:
        notes.append(f"{whole.path.name} holds the run from its beginning")
    notes += whole.notes
    for session in later:
        notes += doubts(session.records)
    if later:
        source: Callable[[], Iterable[Message]] = _one_after_another(
            [session.source for session in parts]
        )
        counts: Mapping[str, int] = Counter(message.topic.name for message in source())
    else:
        source = whole.source
        counts = whole.counts
    topics: dict[str, Topic] = {}
    for session in (*later, whole):
        topics |= {topic.name: topic for topic in session.topics}
    return replace(
        whole,
        name=named(Path(os.path.realpath(path)).name),
        path=path,
        samples=joined(session.samples for session in parts),
        topics=list(topics.values()),
        counts={name: counts[name] for name in topics},
        end=max(session.end for session in parts),
        notes=notes,
        missing=[*left_out, *whole.missing],
        source=source,
    )


def _one_after_another(
    sources: Sequence[Callable[[], Iterable[Message]]],
) -> Callable[[], Iterator[Message]]:
    """The messages of the first, then of each other one those that are later."""

    def messages() -> Iterator[Message]:
        end = -1
        for source in sources:
            newest = end
            for message in source():
                if message.log_time > end:
                    newest = max(newest, message.log_time)
                    yield message
            end = newest

    return messages


def _read(path: Path, topic: str | None, progress: ProgressCallback | None) -> Session:
    files, notes = _files(path)
    scans = [Scan(file) for file in files]
    contents = _contents_of(_with_progress(scans, progress))
    topics_by_name: dict[str, Topic] = {}
    records: dict[str, Mapping[str, str]] = {}
    for scan in scans:
        topics_by_name |= {recorded.name: recorded for recorded in scan.topics}
        records |= scan.records
    topics = list(topics_by_name.values())
    name = named(
        path.resolve().name if path.is_dir() else re.sub(r"_\d+$", "", path.stem)
    )
    faults = [f"{scan.path.name}: {scan.fault}" for scan in scans if scan.fault]
    place = "; ".join([f"session {name}", *faults])
    chosen = _plant_topic(topics, topic, place)
    samples = [
        decode_sample(current(message).data)
        for message in contents.samples.get(chosen.name, [])
    ]
    check_samples(samples, place)
    missing = [
        *notes,
        *(_extent(fault, samples) for fault in faults),
        *repairs(records),
    ]
    if path.is_dir() and not missing:
        missing = miscounted(counts_listed(path), contents.counts)
    return Session(
        name=name,
        path=path,
        topic=chosen.name,
        samples=samples,
        topics=[current_topic(recorded) for recorded in topics],
        counts={recorded.name: contents.counts[recorded.name] for recorded in topics},
        start=contents.start,
        end=contents.end,
        notes=[
            *missing,
            *_gaps(samples),
            *_clock(samples),
            *doubts(records),
        ],
        missing=missing,
        source=lambda: map(current, messages_of(files)),
        records=records,
        plant=plant_of(records),
        has_reference=has_reference(records),
    )


class _Contents(NamedTuple):
    """What the messages of a session are."""

    counts: Counter[str]
    """Number of messages, by topic."""
    samples: Mapping[str, list[Message]]
    """Messages that are samples, by topic."""
    start: int
    """Time of the first message, ns."""
    end: int
    """Time of the last message, ns."""


def _contents_of(messages: Iterable[Message]) -> _Contents:
    """Count messages, and keep those that are samples."""
    counts: Counter[str] = Counter()
    samples: dict[str, list[Message]] = {}
    start = 2**64
    end = 0
    for message in messages:
        name = message.topic.name
        counts[name] += 1
        start = min(start, message.log_time)
        end = max(end, message.log_time)
        if message.topic.type == SAMPLE.type:
            samples.setdefault(name, []).append(message)
    return _Contents(counts, samples, start, end)


def _with_progress(
    scans: Sequence[Scan], progress: ProgressCallback | None
) -> Iterator[Message]:
    """The messages of all files, with calls of `progress` in between."""
    for number, message in enumerate(chain.from_iterable(scans), 1):
        if progress is not None and number % MESSAGES_BETWEEN == 0:
            progress(
                sum(scan.read for scan in scans),
                sum(scan.path.stat().st_size for scan in scans),
            )
        yield message


def _files(path: Path) -> tuple[list[Path], list[str]]:
    if not path.exists():
        raise SessionError(f"session {path}: does not exist")
    if not path.is_dir():
        return [path], []
    files, notes = files_of(path, is_mcap)
    return files or mcap_files(path), notes


def _plant_topic(topics: list[Topic], wanted: str | None, place: str) -> Topic:
    plants = [topic for topic in topics if topic.type == SAMPLE.type]
    if wanted is None:
        plants = [topic for topic in plants if topic.name.endswith(SUFFIX)]
    else:
        plants = [topic for topic in plants if topic.name == wanted]
    if not plants:
        asked = f"topic {wanted}" if wanted else f"topic ending in {SUFFIX}"
        raise SessionError(
            f"{place}: has no {asked} of type {SAMPLE.type}; it has {_names(topics)}"
        )
    if len(plants) > 1:
        raise SessionError(
            f"{place}: has samples of several rigs ({_names(plants)}); give the topic to use"
        )
    if fields_of(current_topic(plants[0]).schema) != fields_of(SAMPLE.schema):
        raise SessionError(
            f"{place}: {plants[0].name} was recorded with another definition of LoopSample; "
            "read it with the version that recorded it"
        )
    return plants[0]


def _names(topics: list[Topic]) -> str:
    return ", ".join(sorted(topic.name for topic in topics)) or "no topics"


def _extent(fault: str, samples: list[Sample]) -> str:
    last = samples[-1].index * period_of(samples)
    return f"{fault}; {len(samples)} samples up to t = {last:g} s could be read"


def _gaps(samples: list[Sample]) -> list[str]:
    gaps = gaps_of(samples)
    if not gaps:
        return []
    shown = ", ".join(f"from {before} to {behind}" for before, behind in gaps[:3])
    further = f" and {len(gaps) - 3} more" if len(gaps) > 3 else ""
    return [f"the samples' indices step {shown}{further}: samples are missing there"]


def _clock(samples: list[Sample]) -> list[str]:
    """A note on a clock that was set during recording; no samples are missing then."""
    period = period_of(samples)
    for before, after in pairwise(samples):
        seconds = (after.stamp - before.stamp) / 1e9
        if after.index == before.index + 1 and not 0 < seconds < 2 * period:
            return [
                f"the stamps step by {seconds:g} s from sample {before.index} to {after.index}"
            ]
    return []


def check_samples(samples: Sequence[Sample], place: str) -> None:
    """Refuse samples that cannot be judged; the error message starts with `place`.

    Raises:
        SessionError: there are no samples, or a value is not finite.
    """
    if not samples:
        raise SessionError(f"{place}: has no samples")
    for name in ("references", "outputs", "inputs"):
        for sample in samples:
            values = getattr(sample, name)
            if not all(map(math.isfinite, values)):
                raise SessionError(
                    f"{place}: {name.removesuffix('s')} of sample {sample.index} is "
                    f"{', '.join(map(str, values))}; only finite values can be used"
                )


def gaps_of(samples: Sequence[Sample]) -> list[tuple[int, int]]:
    """Index before and index after every gap in the samples' indices."""
    return [(a.index, b.index) for a, b in pairwise(samples) if b.index != a.index + 1]


def period_of(samples: Sequence[Sample]) -> float:
    """Sampling period in seconds from the stamps of consecutive samples; 1 s if there are none.

    Raises:
        SessionError: the stamps do not advance.
    """
    steps = [b.stamp - a.stamp for a, b in pairwise(samples) if b.index == a.index + 1]
    if not steps:
        return 1.0
    mean = sum(steps) / len(steps) / 1e9
    if mean <= 0:
        msg = f"session: the stamps do not advance between samples {samples[0].index} and {samples[-1].index}"
        raise SessionError(msg)
    return rounded_period(mean)


def rounded_period(mean: float) -> float:
    """The nominal period of a loop, s, from its measured mean.

    Loops are set to whole milliseconds, and clocks and stamps are slightly off: a mean within half a percent
    of whole milliseconds is rounded to them, any other to the nanosecond.
    """
    whole = round(mean, 3)
    if whole > 0 and abs(mean - whole) <= ROUNDED * whole:
        return whole
    return round(mean, 9)
