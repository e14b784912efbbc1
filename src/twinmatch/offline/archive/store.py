"""Keeps one JSON file per judged session, so that a run can continue where another ended."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from pathlib import Path
from typing import Any

from twinmatch.offline.archive.errors import ArchiveError
from twinmatch.offline.archive.fingerprint import software
from twinmatch.sessions.documents import DocumentError, parse_json
from twinmatch.sessions.files import read_bounded

__all__ = ["Store"]


MOST_BYTES = 1 << 28
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
            msg = f"{folder}: the folder for results cannot be created ({error.strerror})"
            raise ArchiveError(msg) from error

    def file_of(self, session: Path) -> Path:
        """File of this session's result; sessions of the same name in two folders have separate files."""
        place = hashlib.sha256(str(session.resolve()).encode()).hexdigest()[:8]
        return self.folder / f"{session.resolve().stem or 'session'}-{place}.json"

    def find(self, session: Path, key: str) -> dict[str, Any] | None:
        """The stored result of this session if it has this key, i.e. if nothing it depends on has changed."""
        try:
            text = read_bounded(self.file_of(session), MOST_BYTES).decode("utf-8")
            kept = parse_json(text, "a stored result")
        except (OSError, UnicodeDecodeError, DocumentError):
            return None  # none yet, or another program's file
        if not isinstance(kept, dict) or kept.get("key") != key:
            return None
        record = kept.get("result")
        return record if isinstance(record, dict) else None

    def keep(self, session: Path, key: str, record: dict[str, Any]) -> None:
        """Write a result, complete or not at all.

        Raises:
            ArchiveError: writing fails.
        """
        file = self.file_of(session)
        kept = {"key": key, "path": str(session.resolve()), "software": software(), "result": record}
        draft = file.with_name(f".{file.name}.{os.getpid()}")
        try:
            draft.write_text(json.dumps(kept, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
            draft.replace(file)
        except OSError as error:
            msg = f"{file}: the result cannot be written ({error.strerror})"
            raise ArchiveError(msg) from error
        finally:
            with contextlib.suppress(OSError):
                draft.unlink()
