"""Repairs a session after its recorder was killed or the disk was full.

The readable messages are written to a copy beside the session; the copy replaces the original only after it
has been compared with it. The original is kept as `<session>.broken` if it was damaged in the middle, where
another tool may recover more; an original that is merely truncated contains nothing more and is removed.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from itertools import chain, zip_longest
from pathlib import Path
from typing import NamedTuple

from twinmatch.sessions.files import SessionError
from twinmatch.sessions.messages import Message
from twinmatch.sessions.metadata import METADATA, distro_of, files_listed, mcap_files
from twinmatch.sessions.scan import Scan
from twinmatch.sessions.writer import SessionWriter, sync_folder

BROKEN = ".broken"
"""Suffix appended to the name of the original."""

TORN = "truncated"


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
        SessionError: there is no session, no message can be read, the original of an earlier repair exists,
            or writing fails.
    """
    folder = Path(folder).absolute()
    broken = folder.with_name(folder.name + BROKEN)
    try:
        if not folder.exists() and broken.is_dir():
            broken.rename(folder)
        files = _files(folder)
        found = _examine(folder, files)
        if found.faults:
            found = _rebuild(folder, broken, files, found)
    except OSError as error:
        raise SessionError(f"session {folder}: cannot be repaired ({error.strerror or error})") from error
    return found


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        what = "is a file; give its folder" if folder.is_file() else "does not exist"
        raise SessionError(f"session {folder}: {what}")
    return mcap_files(folder)


def _examine(folder: Path, files: list[Path]) -> Repair:
    """Read all messages; collect faults and counts."""
    faults: list[str] = []
    count, start, end = 0, 2**64, 0
    for file in files:
        if file.stat().st_size == 0:
            faults.append(f"{file.name} is empty")
            continue
        scan = Scan(file)
        for message in scan:
            count += 1
            start, end = min(start, message.log_time), max(end, message.log_time)
        if scan.fault:
            faults.append(f"{file.name}: {scan.fault}")
    listed = files_listed(folder)
    if not listed:
        faults.append(f"{METADATA} is missing or unreadable")
    elif sorted(listed) != sorted(file.name for file in files):
        faults.append(f"{METADATA} does not list the files that exist")
    return Repair(folder, tuple(faults), count, start if count else 0, end, None)


def _rebuild(folder: Path, broken: Path, files: list[Path], found: Repair) -> Repair:
    if found.messages == 0:
        msg = f"session {folder}: {'; '.join(found.faults)}; no message can be read, nothing was changed"
        raise SessionError(msg)
    if broken.exists():
        raise SessionError(f"session {folder}: {broken} of an earlier repair exists; move or remove it first")
    readable = [file for file in files if file.stat().st_size]
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=folder.parent))
    try:
        copy = scratch / folder.name
        _write(copy, readable, distro_of(folder))
        _compare(copy, readable)
        folder.rename(broken)
        try:
            copy.rename(folder)
        except OSError:
            broken.rename(folder)
            raise
        sync_folder(folder.parent)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    if all(TORN in fault or METADATA in fault or "empty" in fault for fault in found.faults):
        shutil.rmtree(broken, ignore_errors=True)
        return found
    return found._replace(original=broken)


def _write(copy: Path, files: list[Path], ros_distro: str) -> None:
    """Write the same messages and records, in as many files."""
    with SessionWriter(copy, ros_distro=ros_distro) as writer:
        for number, file in enumerate(files):
            if number:
                writer.split()
            scan = Scan(file)
            for message in scan:
                writer.add_topic(message.topic)
                writer.write(message.topic.name, message.data, message.log_time, message.publish_time)
            for topic in scan.topics:  # those without messages
                writer.add_topic(topic)
            for name, values in scan.records.items():
                if name != "rosbag2":
                    writer.add_record(name, values)


def _compare(copy: Path, files: list[Path]) -> None:
    """Check that the copy is complete and has the messages of the original."""
    written = _files(copy)
    for new, old in zip_longest(_messages(written), _messages(files)):
        if new is None or old is None or new[1:] != old[1:] or new.topic.name != old.topic.name:
            msg = f"session {copy.name}: the repaired copy differs from the original; nothing was changed"
            raise SessionError(msg)
    faults = _examine(copy, written).faults
    if faults:
        msg = f"session {copy.name}: the repaired copy has faults ({'; '.join(faults)}); nothing was changed"
        raise SessionError(msg)


def _messages(files: list[Path]) -> Iterator[Message]:
    return chain.from_iterable(Scan(file) for file in files)
