"""Recording samples or messages as a session.

`write_session` writes samples atomically: the session exists completely or not at all. A live `Recording`
writes messages as they arrive and is flushed regularly; files are split, and recording stops before the disk
is full. It depends on neither ROS nor threads; a recorder calls it from its writing thread.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from twinmatch.sessions.files import ProgressCallback, SessionError
from twinmatch.sessions.messages import PLANT_TOPICS, SAMPLE, Topic, plant_messages
from twinmatch.sessions.metadata import METADATA
from twinmatch.sessions.reader import check_samples, gaps_of
from twinmatch.sessions.writer import SessionWriter, sync_folder
from twinmatch.signals import Sample, Window

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
        self._free = free or _free
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
        part, limits = self.part, self.limits
        span = (part.end - part.start) / NANOSECONDS
        return (0 < limits.split_mb <= self.size / MEGABYTE) or (0 < limits.split_s <= span)

    def _require_space(self, folder: Path, consequence: str) -> None:
        free = self._free(folder) / MEGABYTE
        if free < self.limits.min_free_mb:
            raise DiskFullError(
                f"recording {folder.name}: {consequence}: {free:.0f} MB are free on the disk, but "
                f"{self.limits.min_free_mb:g} MB must stay free; free some space or lower min_free_mb"
            )


def _free(path: Path) -> int:
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


def samples_of(window: Window, start: int = EPOCH) -> list[Sample]:
    """The samples of a window, stamped `start` (ns) + index · period."""
    columns = zip(window.reference.tolist(), window.output.tolist(), window.input.tolist(), strict=True)
    return [
        Sample(index, start + round(index * window.period * 1e9), *values)
        for index, values in enumerate(columns, start=window.first)
    ]


def write_session(
    folder: Path | str,
    samples: Sequence[Sample],
    *,
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
    records: Mapping[str, Mapping[str, str]] | None = None,
    gaps: bool = False,
    topics: Sequence[Topic] = PLANT_TOPICS,
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
        topics: fewer topics, for a plant without a temperature or a loop; see `plant_topics`.

    Returns:
        The folder.

    Raises:
        SessionError: there are no samples, gaps, values that are not finite, or stamps outside ROS time; the
            folder exists; or writing fails.
    """
    target = Path(folder).absolute()
    check_samples(samples, f"session {target.name}")
    _check_gaps(samples, target, allowed=gaps)
    _check_target(target, overwrite)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".partial", dir=target.parent))
    except OSError as error:
        raise SessionError(f"session {target}: cannot be written ({error.strerror})") from error
    try:
        _write(scratch / target.name, samples, topics, progress, records or {})
        _move(scratch, target)
    except OSError as error:
        msg = f"session {target}: cannot be moved to its destination ({error.strerror})"
        raise SessionError(msg) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return target


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
            writer.write(message.topic.name, message.data, message.log_time, message.publish_time)


def _move(scratch: Path, target: Path) -> None:
    """Move the finished session to its destination; an existing one is restored if that fails."""
    old = scratch / "replaced"
    if target.exists():
        target.rename(old)
    try:
        (scratch / target.name).rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise
    sync_folder(target.parent)


def _check_target(target: Path, overwrite: bool) -> None:
    if not target.name:
        raise SessionError(f"session {target}: a session needs a folder with a name")
    if not (target.exists() or target.is_symlink()):
        return
    if not overwrite:
        raise SessionError(f"session {target}: exists already; choose another name or ask to overwrite it")
    if not _is_session(target):
        msg = f"session {target}: is not a session and will not be overwritten; choose another name"
        raise SessionError(msg)


def _is_session(folder: Path) -> bool:
    """Whether a folder contains only metadata and MCAP files."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    names = [path.name for path in folder.iterdir()]
    return bool(names) and all(name == METADATA or name.endswith(".mcap") for name in names)
