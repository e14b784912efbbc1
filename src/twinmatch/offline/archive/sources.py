"""Resolves the user's arguments to sessions: files, session folders, folders of them, patterns."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from twinmatch.offline.archive.errors import ArchiveError

__all__ = ["find_sessions", "is_single"]

METADATA = "metadata.yaml"
RECORDINGS = (".mat", ".csv")


def find_sessions(named: Iterable[Path | str]) -> list[Path]:
    """The sessions and recordings of the arguments, in their order, each once.

    A folder with an MCAP file or a `metadata.yaml` is a session. Any other folder stands for all sessions and
    recordings (`.mat`, `.csv`) in it and below, sorted by name. A pattern (`*`, `?`, `[…]`, `**`) that the
    shell has not resolved is resolved here. Whether they can be read is found out when they are judged.

    Raises:
        ArchiveError: nothing matches a pattern, or a folder has no sessions.
    """
    found: dict[Path, Path] = {}
    for name in named:
        for path in _resolved(Path(name)):
            found.setdefault(Path(os.path.realpath(path)), path)  # `resolve` fails for circular links
    return list(found.values())


def is_single(named: Sequence[Path | str]) -> bool:
    """Whether a single session or recording was given, rather than several or a folder of them."""
    return len(named) == 1 and not _is_pattern(Path(named[0])) and not _is_collection(Path(named[0]))


def _resolved(path: Path) -> Sequence[Path]:
    if _is_pattern(path):
        matches = sorted(glob.glob(str(path), recursive=True))  # noqa: PTH207 — Path.glob takes no absolute ones
        if not matches:
            msg = f"{path}: no file or folder matches this pattern"
            raise ArchiveError(msg)
        return [found for match in matches for found in _resolved(Path(match))]
    if not _is_collection(path):
        return [path]
    found = _within(path)
    if not found:
        msg = f"{path}: has neither sessions (folders with .mcap files) nor recordings (.mat, .csv)"
        raise ArchiveError(msg)
    return found


def _is_pattern(path: Path) -> bool:
    return glob.has_magic(str(path)) and not path.exists()


def _is_collection(path: Path) -> bool:
    return path.is_dir() and not _is_session(inner.name for inner in path.iterdir())


def _is_session(names: Iterable[str]) -> bool:
    return any(name == METADATA or name.endswith(".mcap") for name in names)


def _within(folder: Path) -> list[Path]:
    found = []
    for place, folders, files in os.walk(folder):
        if _is_session(files):
            found.append(Path(place))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [
            Path(place, name)
            for name in files
            if not name.startswith(".") and Path(name).suffix.lower() in RECORDINGS
        ]
    return sorted(found)
