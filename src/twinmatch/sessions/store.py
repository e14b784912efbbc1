"""Writes a whole session at once: either it is there, complete, or it is not there."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from twinmatch.sessions.checks import check_samples, gaps_of
from twinmatch.sessions.errors import SessionError
from twinmatch.sessions.files import Told
from twinmatch.sessions.metadata import METADATA
from twinmatch.sessions.topics import PLANT_TOPICS, SAMPLE, Topic, plant_messages
from twinmatch.sessions.writer import SessionWriter, sync_folder
from twinmatch.signals import Sample, Window

__all__ = ["EPOCH", "samples_of", "write_session"]

EPOCH = 946_684_800_000_000_000
"""Stamp of the first sample of an imported recording: 2000-01-01 00:00 UTC, ns.

A recording counts seconds from its own beginning and does not say when that was. The date of the file
or of the import would make every import of it a different session. And zero will not do: ROS 2 reads
a clock at zero as "no time yet". So an imported session visibly carries a date nobody measured.
"""


SAMPLES_BETWEEN = 10_000
"""Samples between two words about how many have been written."""


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
    told: Told | None = None,
    records: Mapping[str, Mapping[str, str]] | None = None,
    gaps: bool = False,
    topics: Sequence[Topic] = PLANT_TOPICS,
) -> Path:
    """Write samples as a session with the topics `plant/sample`, `plant/temperature`, `plant/reference`.

    The session is written into a hidden folder beside its place, brought to the disk and then renamed, so
    that an error or a kill leaves nothing under its name. The same samples give the same bytes.

    Args:
        folder: the session's folder; its last part is the session's name.
        samples: at least one; growing indices, finite values.
        overwrite: replace a session that is there; anything else than a session is never replaced.
        told: called now and then with how many samples of how many have been written.
        records: what is to be noted about the session, by the names of `settings`.
        gaps: whether indices may skip; otherwise they have to be consecutive.
        topics: fewer topics, for a plant that has no temperature or no loop; see `plant_topics`.

    Returns:
        The folder.

    Raises:
        SessionError: no samples, gaps, values that are not finite, stamps outside ROS time; the folder
            exists; the disk refuses.
    """
    target = Path(folder).absolute()
    check_samples(samples, f"session {target.name}")
    _check_gaps(samples, target, allowed=gaps)
    _check_target(target, overwrite)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        workshop = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".partial", dir=target.parent))
    except OSError as error:
        msg = f"session {target}: cannot be written ({error.strerror})"
        raise SessionError(msg) from error
    try:
        _write(workshop / target.name, samples, topics, told, records or {})
        _move(workshop, target)
    except OSError as error:
        msg = f"session {target}: cannot be put in its place ({error.strerror})"
        raise SessionError(msg) from error
    finally:
        shutil.rmtree(workshop, ignore_errors=True)
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
    told: Told | None,
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
                if told is not None and written % SAMPLES_BETWEEN == 0:
                    told(written, len(samples))
            writer.write(message.topic.name, message.data, message.log_time, message.publish_time)


def _move(workshop: Path, target: Path) -> None:
    """Put the finished session in its place; one that is there stays until the new one takes over."""
    old = workshop / "replaced"
    if target.exists():
        target.rename(old)
    try:
        (workshop / target.name).rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise
    sync_folder(target.parent)


def _check_target(target: Path, overwrite: bool) -> None:
    if not target.name:
        msg = f"session {target}: a session needs a folder with a name"
        raise SessionError(msg)
    if not (target.exists() or target.is_symlink()):
        return
    if not overwrite:
        msg = f"session {target}: exists already; choose another name or ask to overwrite it"
        raise SessionError(msg)
    if not _is_session(target):
        msg = f"session {target}: is something else than a session and will not be overwritten"
        raise SessionError(msg)


def _is_session(folder: Path) -> bool:
    """Whether a folder holds metadata and MCAP files and nothing besides."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    names = [path.name for path in folder.iterdir()]
    return bool(names) and all(name == METADATA or name.endswith(".mcap") for name in names)
