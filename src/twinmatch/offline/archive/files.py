"""Files of an archive: the sessions that the user named, their hashes, and a folder of results."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import twinmatch
from twinmatch.errors import TwinmatchError
from twinmatch.sessions.documents import DocumentError, parse_json
from twinmatch.sessions.files import read_bounded
from twinmatch.sessions.metadata import METADATA
from twinmatch.sessions.reader import first_of, pieces_of


class ArchiveError(TwinmatchError):
    """No sessions were found, or the folder for results cannot be used."""


class ClusterError(ArchiveError):
    """A Dask cluster cannot be reached, was lost, or cannot judge sessions."""


RECORDINGS = (".mat", ".csv")


def find_sessions(named: Iterable[Path | str]) -> list[Path]:
    """The sessions and recordings of the arguments, in their order, each once.

    A folder with an MCAP file or a `metadata.yaml` is a session. Any other folder stands for all sessions and
    recordings (`.mat`, `.csv`) in it and below, sorted by name. A pattern (`*`, `?`, `[…]`, `**`) that the
    shell has not resolved is resolved here. Whether they can be read is found out when they are judged. Of
    the pieces of one run only the first is listed, if it is among them.
    """
    paths: dict[Path, Path] = {}
    for name in named:
        for path in _resolve(Path(name)):
            # `resolve` fails for circular links
            paths.setdefault(Path(os.path.realpath(path)), path)
    first_piece = {resolved: first_of(resolved) for resolved in paths}
    listed = []
    for resolved, path in paths.items():
        is_first = first_piece[resolved] == resolved
        if is_first or first_piece[resolved] not in paths:
            listed.append(path)
    return listed


def is_single(named: Sequence[Path | str]) -> bool:
    """Whether a single session or recording was given, rather than several or a folder of them."""
    return (
        len(named) == 1
        and not _is_pattern(Path(named[0]))
        and not _is_collection(Path(named[0]))
    )


def _resolve(path: Path) -> Sequence[Path]:
    if _is_pattern(path):
        matches = sorted(glob.glob(str(path), recursive=True))  # noqa: PTH207
        if not matches:
            raise ArchiveError(f"{path}: no file or folder matches this pattern")
        return [session for match in matches for session in _resolve(Path(match))]
    if not _is_collection(path):
        return [path]
    sessions = _within(path)
    if not sessions:
        msg = f"{path}: has neither sessions (folders with .mcap files) nor recordings (.mat, .csv)"
        raise ArchiveError(msg)
    return sessions


def _is_pattern(path: Path) -> bool:
    """Whether a path has wildcards, and is not the name of a file that has such characters."""
    return glob.has_magic(str(path)) and not path.exists()


def _is_collection(path: Path) -> bool:
    """Whether a path is a folder that is not itself a session."""
    return path.is_dir() and not _is_session(inner.name for inner in path.iterdir())


def _is_session(names: Iterable[str]) -> bool:
    """Whether a folder with files of these names is a session."""
    return any(name == METADATA or name.endswith(".mcap") for name in names)


def _within(folder: Path) -> list[Path]:
    """The sessions and recordings in a folder and below, without hidden ones."""
    sessions = []
    for path, folders, files in os.walk(folder):
        if _is_session(files):
            sessions.append(Path(path))
            folders.clear()  # so that the walk does not descend
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        sessions += [
            Path(path, name)
            for name in files
            if not name.startswith(".") and Path(name).suffix.lower() in RECORDINGS
        ]
    return sorted(sessions)


LIBRARIES = ("numpy", "scipy", "numba")
BLOCK = 1 << 20


def content_of(path: Path) -> str:
    """A hash of a recording, or of the MCAP files and metadata of a session folder."""
    if not path.is_dir():
        return _hash([path], path.parent)
    pieces = pieces_of(path)
    files = [
        file
        for piece in pieces
        for file in (*piece.glob("*.mcap"), *piece.glob("metadata.yaml"))
    ]
    return _hash(sorted(files), path if len(pieces) == 1 else path.parent)


def key_of(content: str, terms: str) -> str:
    """One hash of all that a result depends on: `content_of` the session, settings and candidates as text."""
    return hashlib.sha256("\0".join((content, terms, software())).encode()).hexdigest()


@cache
def software() -> str:
    """Version and code hash of this package, and versions of the numerical libraries.

    The last bits of a result may depend on any of them.
    """
    root = Path(twinmatch.__file__).parent
    code = _hash(sorted(root.rglob("*.py")), root)[:12]
    versions = [f"twinmatch {twinmatch.__version__} (code {code})"]
    for library in LIBRARIES:
        try:
            versions.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            versions.append(f"{library} unknown")
    return ", ".join(versions)


def _hash(files: Iterable[Path], root: Path) -> str:
    digest = hashlib.sha256()
    for file in files:
        size = file.stat().st_size
        digest.update(f"{file.relative_to(root)}\0{size}\0".encode())
        with file.open("rb") as stream:
            while block := stream.read(BLOCK):
                digest.update(block)
    return digest.hexdigest()


MAX_BYTES = 1 << 28
"""Longest result: it has every verdict of a session, some kilobytes each."""


class Store:
    """A folder of results."""

    def __init__(self, folder: Path) -> None:
        """Open the folder; it is created if it does not exist.

        Raises:
            ArchiveError: the folder cannot be created.
        """
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            msg = (
                f"{folder}: the folder for results cannot be created ({error.strerror})"
            )
            raise ArchiveError(msg) from error

    def file_of(self, session: Path) -> Path:
        """File of this session's result; sessions of the same name in two folders have separate files."""
        hash_of_path = hashlib.sha256(str(session.resolve()).encode()).hexdigest()[:8]
        return (
            self.folder / f"{session.resolve().stem or 'session'}-{hash_of_path}.json"
        )

    def find(self, session: Path, key: str) -> dict[str, Any] | None:
        """The stored result of this session if it has this key, i.e. if nothing it depends on has changed."""
        try:
            text = read_bounded(self.file_of(session), MAX_BYTES).decode("utf-8")
            stored = parse_json(text, "a stored result")
        except (OSError, UnicodeDecodeError, DocumentError):
            return None  # none yet, or another program's file
        if not isinstance(stored, dict) or stored.get("key") != key:
            return None
        record = stored.get("result")
        return record if isinstance(record, dict) else None

    def keep(self, session: Path, key: str, record: dict[str, Any]) -> None:
        """Write a result, complete or not at all.

        Raises:
            ArchiveError: writing fails.
        """
        file = self.file_of(session)
        stored = {
            "key": key,
            "path": str(session.resolve()),
            "software": software(),
            "result": record,
        }
        draft = file.with_name(f".{file.name}.{os.getpid()}")
        try:
            draft.write_text(
                json.dumps(stored, allow_nan=False, ensure_ascii=False) + "\n",
                encoding="utf-8",
            )
            draft.replace(file)
        except OSError as error:
            raise ArchiveError(
                f"{file}: the result cannot be written ({error.strerror})"
            ) from error
        finally:
            with contextlib.suppress(OSError):
                draft.unlink()
