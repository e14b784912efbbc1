"""The ZIP file that an FMU is, unpacked where it can do no harm."""

from __future__ import annotations

import hashlib
import stat
import zipfile
from pathlib import Path, PurePosixPath
from typing import Final

__all__ = ["MOST_BYTES", "ArchiveError", "digest_of", "unpack"]

MOST_BYTES: Final = 512 * 1024 * 1024
"""Of the file, and of all that is in it."""
MOST_FILES: Final = 20_000
_BLOCK: Final = 1 << 20


class ArchiveError(Exception):
    """The file is no FMU, or one that is not unpacked."""


def digest_of(file: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while block := opened.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def unpack(file: Path, folder: Path, only: str = "") -> list[str]:
    """Write what is in the FMU into a folder, or `only` one file of it; returns the names of all.

    Raises:
        ArchiveError: it is no ZIP file, or one of a kind that nobody means well with.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            for info in _checked(archive):
                if not only or info.filename == only:
                    _write(archive, info, folder / info.filename)
            if only and only not in archive.namelist():
                raise ArchiveError(f"is no FMU: it has no {only}")
            return archive.namelist()
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise ArchiveError(f"is no FMU: {error}") from error


def _checked(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    infos = archive.infolist()
    if len(infos) > MOST_FILES:
        raise ArchiveError(f"holds {len(infos)} files; more than {MOST_FILES} are not unpacked")
    for info in infos:
        name = PurePosixPath(info.filename)
        if name.is_absolute() or ".." in name.parts or "\\" in info.filename or ":" in info.filename:
            raise ArchiveError(f"holds {info.filename!r}, which leads out of it; it is not unpacked")
        if stat.S_ISLNK(info.external_attr >> 16):
            raise ArchiveError(f"holds the link {info.filename!r}; it is not unpacked")
    total = sum(info.file_size for info in infos)
    if total > MOST_BYTES:
        size, most = total / 2**20, MOST_BYTES // 2**20
        raise ArchiveError(f"holds {size:.0f} MiB; more than {most} MiB are not unpacked")
    return infos


def _write(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> None:
    """One file, no longer than it was said to be."""
    if info.is_dir():
        path.mkdir(parents=True, exist_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    left = info.file_size
    with archive.open(info) as packed, path.open("wb") as file:
        while block := packed.read(_BLOCK):
            left -= len(block)
            if left < 0:
                raise ArchiveError(f"holds {info.filename!r}, which is longer than it says")
            file.write(block)
    path.chmod(0o700)
