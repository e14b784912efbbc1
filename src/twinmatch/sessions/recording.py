"""Recording samples or messages as a session, and repairing one after its recorder was killed.

`write_session` writes samples atomically: the session exists completely or not at all. A live `Recording`
writes messages as they arrive and is flushed regularly; files are split, and recording stops before the disk
is full. It depends on neither ROS nor threads; a recorder calls it from its writing thread.

`repair_session` writes the readable messages to a copy beside the session, which replaces the original only
after it has been compared with it. The original is kept as `<session>.broken` if it was damaged in the
middle, where another tool may recover more, or if messages are missing; a merely truncated one contains
nothing more and is removed. It touches neither what is still being written nor what others have written.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

from twinmatch.sessions.cdr import plant_messages
from twinmatch.sessions.files import DiskError, ProgressCallback, SessionError
from twinmatch.sessions.messages import SAMPLE, Topic, topics_of
from twinmatch.sessions.metadata import (
    METADATA,
    REPAIRED,
    counts_listed,
    distro_of,
    files_listed,
    mcap_files,
    miscounted,
)
from twinmatch.sessions.reader import check_samples, gaps_of
from twinmatch.sessions.scan import TRUNCATED, Scan, messages_of
from twinmatch.sessions.writer import LIBRARY, SessionWriter, being_written, sync_folder
from twinmatch.settings import setting
from twinmatch.signals import NANOSECONDS, Sample, Window

MEGABYTE = 1_000_000
FLUSH = 0.4
"""Interval at which a live recording is to be flushed to the disk, s: what a kill may lose."""


class DiskFullError(DiskError):
    """There is too little disk space to start or continue recording."""


@dataclass(frozen=True)
class RecordingLimits:
    """When to split a file and when to stop; finishing a session needs some disk space."""

    min_free_mb: float = setting(
        200.0, "Free disk space below which recording stops.", "MB", 0.0, 1e9
    )
    split_mb: float = setting(
        0.0, "Size at which a new file is started; 0: never.", "MB", 0.0, 1e6
    )
    split_s: float = setting(
        0.0, "Time after which a new file is started; 0: never.", "s", 0.0, 1e7
    )


class Recording(SessionWriter):
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
        self._free = free or free_bytes
        self._require_space(folder, "not started")
        super().__init__(folder, ros_distro=ros_distro)

    @property
    def messages(self) -> int:
        """Messages so far."""
        return sum(self.counts.values())

    def flush(self) -> None:
        """Flush to the disk, check the free space, and start the next file if it is due.

        Raises:
            DiskFullError: too little disk space; the session has been closed and is complete.
        """
        super().flush()
        try:
            self._require_space(self.folder, f"stopped after {self.messages} messages")
        except DiskFullError:
            self.close()
            raise
        if self._due():
            self.split()

    def _due(self) -> bool:
        part = self.part
        limits = self.limits
        span = (part.end - part.start) / NANOSECONDS
        return (0 < limits.split_mb <= self.size / MEGABYTE) or (
            0 < limits.split_s <= span
        )

    def _require_space(self, folder: Path, consequence: str) -> None:
        free = self._free(folder) / MEGABYTE
        if free < self.limits.min_free_mb:
            least = self.limits.min_free_mb
            raise DiskFullError(
                f"recording {folder.name}: {consequence}: no space left in {folder.parent}: {free:.0f} MB "
                f"are free on the disk, but {least:g} MB must stay free; free some space or lower min_free_mb"
            )


def free_bytes(path: Path) -> int:
    """Free bytes on the disk of a path, which need not exist yet."""
    place = path.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free


EPOCH = 946_684_800_000_000_000
"""Stamp of the first sample of an imported recording: 2000-01-01 00:00 UTC, ns.

A recording counts seconds from its own start, without a date. The date of the file or of the import would
make every import a different session, and ROS 2 treats a clock at zero as "no time yet". An imported session
therefore has a date that is visibly artificial.
"""


SAMPLES_BETWEEN = 10_000
"""Samples between two reports of progress."""


def samples_of(window: Window) -> list[Sample]:
    """The samples of a window, stamped `EPOCH` + index · period."""
    return window.samples(EPOCH)


def write_session(
    folder: Path | str,
    samples: Sequence[Sample],
    *,
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
    records: Mapping[str, Mapping[str, str]] | None = None,
    gaps: bool = False,
    topics: Sequence[Topic] | None = None,
) -> Path:
    """Write samples as a session with the topics `plant/sample`, `plant/temperature`, `plant/reference`.

    The session is written to a hidden folder beside its destination, flushed to disk and then renamed, so
    that an error or a kill leaves nothing under its name. The same samples give the same bytes.

    Args:
        folder: the session's folder; its last part is the session's name.
        samples: at least one; increasing indices, finite values.
        overwrite: replace an existing session; anything other than a session is never replaced.
        progress: called with the number of samples written and the total.
        records: metadata records, under the names in `settings`.
        gaps: whether indices may skip; otherwise they must be consecutive.
        topics: which of the topics, see `plant_topics`; default: all of a single loop, else the samples.

    Returns:
        The folder.

    Raises:
        SessionError: there are no samples, gaps, values that are not finite, or stamps outside ROS time; the
            folder exists; or writing fails.
    """
    target = Path(folder).absolute()
    check_samples(samples, f"session {target.name}")
    _check_gaps(samples, target, allowed=gaps)
    _check_target(target, may_overwrite=overwrite)
    topics = topics_of(samples) if topics is None else topics
    step = "written"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _scratch(target) as scratch:
            step = "moved to its destination"
            _write(scratch / target.name, samples, topics, progress, records or {})
            _move(scratch / target.name, target, scratch / "replaced")
    except OSError as error:
        raise SessionError(
            f"session {target}: cannot be {step} ({error.strerror})"
        ) from error
    return target


@contextmanager
def _scratch(target: Path) -> Iterator[Path]:
    """A hidden folder beside a session, for what will take its place; it is removed at the end."""
    scratch = Path(
        tempfile.mkdtemp(
            prefix=f".{target.name}.", suffix=".partial", dir=target.parent
        )
    )
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _check_gaps(samples: Sequence[Sample], target: Path, *, allowed: bool) -> None:
    for before, behind in gaps_of(samples):
        if allowed and behind > before:
            continue
        msg = f"session {target.name}: sample {behind} follows sample {before}; give only one unbroken part"
        raise SessionError(msg)


def _write(
    folder: Path,
    samples: Sequence[Sample],
    topics: Sequence[Topic],
    progress: ProgressCallback | None,
    records: Mapping[str, Mapping[str, str]],
) -> None:
    with SessionWriter(folder) as writer:
        for name, values in records.items():
            writer.add_record(name, values)
        for topic in topics:
            writer.add_topic(topic)
        written = 0
        for message in plant_messages(samples, topics):
            if message.topic is SAMPLE:
                written += 1
                if progress is not None and written % SAMPLES_BETWEEN == 0:
                    progress(written, len(samples))
            writer.write(
                message.topic.name, message.data, message.log_time, message.publish_time
            )


def _move(written: Path, target: Path, aside: Path) -> None:
    """Move a finished session to its destination; an existing one goes aside, and back if that fails."""
    if target.exists():
        target.rename(aside)
    try:
        written.rename(target)
    except OSError:
        if aside.exists():
            aside.rename(target)
        raise
    sync_folder(target.parent)


def _check_target(target: Path, *, may_overwrite: bool) -> None:
    if not target.name:
        raise SessionError(f"session {target}: a session needs a folder with a name")
    if not (target.exists() or target.is_symlink()):
        return
    if not may_overwrite:
        raise SessionError(
            f"session {target}: exists already; choose another name or ask to overwrite it"
        )
    if not _is_session(target):
        msg = f"session {target}: is not a session and will not be overwritten; choose another name"
        raise SessionError(msg)


def _is_session(folder: Path) -> bool:
    if folder.is_symlink() or not folder.is_dir():
        return False
    names = [path.name for path in folder.iterdir()]
    return bool(names) and all(
        name == METADATA or name.endswith(".mcap") for name in names
    )


BROKEN = ".broken"
"""Suffix appended to the name of the original."""

_NOTHING_MORE = (TRUNCATED, "missing or unreadable", "does not list", "is empty")
"""Faults of an original that contains no more than its repaired copy."""


class Repair(NamedTuple):
    """Result of a repair."""

    folder: Path
    """The session, now complete."""
    faults: tuple[str, ...]
    """What was wrong; empty: nothing, and nothing was changed."""
    messages: int
    """Number of messages."""
    start: int
    """Log time of the earliest, ns."""
    end: int
    """Log time of the latest, ns."""
    original: Path | None
    """Where the original was kept; None if it was not."""

    @property
    def duration(self) -> float:
        """Seconds from the earliest to the latest message."""
        return (self.end - self.start) / 1e9


def repair_session(folder: Path | str) -> Repair:
    """Repair a session; a complete one is left unchanged.

    Args:
        folder: the session's folder. If a repair was interrupted just before its end, only
            `<folder>.broken` may exist; the repair is then repeated.

    Raises:
        SessionError: there is no session, it is still being written or was written by another program, no
            message can be read, the original of an earlier repair exists, or writing fails.
    """
    folder = Path(folder).absolute()
    broken = folder.with_name(folder.name + BROKEN)
    try:
        if not folder.exists() and broken.is_dir():
            broken.rename(folder)
        files = _files_at_rest(folder)
        repair = _examine(folder, files)
        if repair.faults:
            repair = _rebuild(folder, broken, files, repair)
    except OSError as error:
        raise SessionError(
            f"session {folder}: cannot be repaired ({error.strerror or error})"
        ) from error
    return repair


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        problem = "is a file; give its folder" if folder.is_file() else "does not exist"
        raise SessionError(f"session {folder}: {problem}")
    return mcap_files(folder)


def _files_at_rest(folder: Path) -> list[Path]:
    files = _files(folder)
    busy = [file.name for file in files if being_written(file)]
    if busy or files != _files(folder):
        subject = f"{busy[0]} is" if busy else "its files are"
        raise SessionError(
            f"session {folder}: {subject} still being written; end its recorder first"
        )
    return files


def _examine(folder: Path, files: list[Path]) -> Repair:
    # only repairs read strictly
    from twinmatch.sessions.strict import strict_refusal  # noqa: PLC0415

    faults: list[str] = []
    counts: Counter[str] = Counter()
    start = 2**64
    end = 0
    for file in files:
        if file.stat().st_size == 0:
            faults.append(f"{file.name} is empty")
            continue
        scan = Scan(file)
        for message in scan:
            counts[message.topic.name] += 1
            start = min(start, message.log_time)
            end = max(end, message.log_time)
        if scan.topics and not _is_own(scan):
            author = f"by {scan.library!r}" if scan.library else "by another program"
            raise SessionError(
                f"session {folder}: {file.name} was written {author}; nothing was changed: use its tools "
                "(ros2 bag reindex, mcap recover), or twinmatch import, which reads it up to the damage"
            )
        if scan.fault:
            faults.append(f"{file.name}: {scan.fault}")
        elif refusal := strict_refusal(file):
            faults.append(f"{file.name}: the file is damaged: {refusal}")
    listed = files_listed(folder)
    if not listed:
        faults.append(f"{METADATA} is missing or unreadable")
    elif sorted(listed) != sorted(file.name for file in files):
        faults.append(f"{METADATA} does not list the files that exist")
    faults += miscounted(counts_listed(folder), counts)
    return Repair(
        folder, tuple(faults), counts.total(), start if counts else 0, end, None
    )


def _is_own(scan: Scan) -> bool:
    """Whether twinmatch wrote a file, or its damage may hide that: the original is kept then."""
    same_letters = sum(a == b for a, b in zip(scan.library, LIBRARY, strict=False))
    return scan.library == LIBRARY or (
        scan.is_damaged and (not scan.library or same_letters > len(LIBRARY) // 2)
    )


def _rebuild(folder: Path, broken: Path, files: list[Path], repair: Repair) -> Repair:
    if repair.messages == 0:
        msg = f"session {folder}: {'; '.join(repair.faults)}; no message can be read, nothing was changed"
        raise SessionError(msg)
    if broken.exists():
        raise SessionError(
            f"session {folder}: {broken} of an earlier repair exists; move or remove it first"
        )
    readable = [file for file in files if file.stat().st_size]
    with _scratch(folder) as scratch:
        copy = scratch / folder.name
        rewrite(copy, readable, repair, distro_of(folder))
        _compare(copy, readable)
        _move(copy, folder, broken)
    if not _damages(repair.faults):
        shutil.rmtree(broken, ignore_errors=True)
        return repair
    return repair._replace(original=broken)


def _damages(faults: Sequence[str]) -> list[str]:
    """The faults that may have cost messages, or changed them."""
    damages = []
    for fault in faults:
        if not any(words in fault for words in _NOTHING_MORE):
            damages.append(fault)
    return damages


def rewrite(copy: Path, files: list[Path], repair: Repair, ros_distro: str) -> None:
    """Write all that can be read of a session's files into a folder, with a record of what was damaged."""
    damages = _damages(repair.faults)
    with SessionWriter(copy, ros_distro=ros_distro) as writer:
        if damages:
            writer.add_record(REPAIRED, {"faults": "; ".join(damages)})
        for number, file in enumerate(files):
            if number:
                writer.split()
            scan = Scan(file)
            for message in scan:
                writer.add_topic(message.topic)
                writer.write(
                    message.topic.name,
                    message.data,
                    message.log_time,
                    message.publish_time,
                )
            for topic in scan.topics:  # those without messages
                writer.add_topic(topic)
            for name, values in scan.records.items():
                if name == REPAIRED and damages:
                    writer.add_record(
                        name, {"faults": "; ".join([*values.values(), *damages])}
                    )
                elif name != "rosbag2":
                    writer.add_record(name, values)


def _compare(copy: Path, files: list[Path]) -> None:
    """Check that the copy is complete and has the messages of the original."""
    written = _files(copy)
    for new, old in zip_longest(messages_of(written), messages_of(files)):
        if (
            new is None
            or old is None
            or not new.is_sound
            or new != old._replace(is_sound=True)
        ):
            msg = f"session {copy.name}: the repaired copy differs from the original; nothing was changed"
            raise SessionError(msg)
    faults = _examine(copy, written).faults
    if faults:
        msg = f"session {copy.name}: the repaired copy has faults ({'; '.join(faults)}); nothing was changed"
        raise SessionError(msg)
