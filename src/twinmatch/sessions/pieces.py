"""Pieces of one run: a recorder that was killed is replaced by another one, with another folder.

The folders are `run`, `run_2`, `run_3` …; a record in each of them but the first names the first. A new
recorder fetches what was published before it started, so the last piece usually holds the whole run.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, Final

from twinmatch.sessions.files import SessionError
from twinmatch.sessions.messages import Message
from twinmatch.sessions.metadata import CONTINUES, mcap_files
from twinmatch.sessions.scan import Scan

_NUMBERED: Final = re.compile(r"(?P<first>.+)_(?P<number>[2-9]|[1-9]\d+)")


def pieces_of(path: Path) -> list[Path]:
    """The folders of the run that begins with this one, itself included, in their order."""
    found = [path]
    if not path.is_dir():
        return found
    whole = Path(os.path.realpath(path))  # `resolve` fails for circular links
    for number in count(2):
        piece = whole.with_name(f"{whole.name}_{number}")
        if not piece.is_dir() or not _continues(piece, whole.name):
            return found
        found.append(piece)
    return found


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


def joined(found: Sequence[Any], path: Path, notes: Sequence[str]) -> Any:
    """Sessions of one run as one: the last that begins at its beginning, and later messages of others.

    Args:
        found: the sessions, at least one, in their order.
        path: the folder of the run.
        notes: remarks on pieces that were left out.
    """
    begin = min(session.samples[0].index for session in found)
    base = max(k for k, session in enumerate(found) if session.samples[0].index == begin)
    whole, later = found[base], found[base + 1 :]
    notes = [*notes, f"{whole.path.name} holds the run from its beginning"] if len(found) > 1 else [*notes]
    samples = list(whole.samples)
    for session in later:
        samples += [sample for sample in session.samples if sample.index > samples[-1].index]
    source = _one_after_another([session.source for session in (whole, *later)]) if later else whole.source
    counts = Counter(message.topic.name for message in source()) if later else whole.counts
    topics = {topic.name: topic for session in (*later, whole) for topic in session.topics}
    return replace(
        whole,
        name=Path(os.path.realpath(path)).name,
        path=path,
        samples=samples,
        topics=list(topics.values()),
        counts={name: counts[name] for name in topics},
        end=max(session.end for session in (whole, *later)),
        notes=[*notes, *whole.notes],
        source=source,
    )


def _one_after_another(
    sources: Sequence[Callable[[], Any]],
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
