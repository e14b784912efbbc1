"""Safe unpacking of an FMU, which is a ZIP file."""

from __future__ import annotations

import hashlib
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final

__all__ = ["MOST_BYTES", "ArchiveError", "digest_of", "unpack"]

MOST_BYTES: Final = 512 * 1024 * 1024
"""Largest file, and largest total size of its content, bytes."""
MOST_FILES: Final = 20_000
_BLOCK: Final = 1 << 20


class ArchiveError(Exception):
    """The file is not an FMU, or exceeds a limit."""


def digest_of(file: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while block := opened.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def unpack(file: Path, folder: Path, only: str = "") -> list[str]:
    """Unpack an FMU into a folder, or `only` one of its files; returns the names of all files in it.

    Raises:
        ArchiveError: it is not a ZIP file, or has suspicious content.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            for info in _checked(archive):
                if not only or info.filename == only:
                    _write(archive, info, folder / info.filename)
            if only and only not in archive.namelist():
                raise ArchiveError(f"is not an FMU: it has no {only}")
            return archive.namelist()
    except (
        zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError,
    ) as error:  # fmt: skip
        raise ArchiveError(f"is not an FMU, or is damaged: {error}") from error


def _checked(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    infos = archive.infolist()
    if len(infos) > MOST_FILES:
        raise ArchiveError(f"has {len(infos)} files; the limit is {MOST_FILES}")
    for info in infos:
        name = PurePosixPath(info.filename)
        if name.is_absolute() or ".." in name.parts or "\\" in info.filename or ":" in info.filename:
            raise ArchiveError(f"has {info.filename!r}, a path outside its folder; it is not unpacked")
        if stat.S_ISLNK(info.external_attr >> 16):
            raise ArchiveError(f"has the link {info.filename!r}; it is not unpacked")
    total = sum(info.file_size for info in infos)
    if total > MOST_BYTES:
        size, most = total / 2**20, MOST_BYTES // 2**20
        raise ArchiveError(f"has {size:.0f} MiB; the limit is {most} MiB")
    return infos


def _write(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> None:
    """Unpack one file, up to its stated size."""
    if info.is_dir():
        path.mkdir(parents=True, exist_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    left = info.file_size
    with archive.open(info) as packed, path.open("wb") as file:
        while block := packed.read(_BLOCK):
            left -= len(block)
            if left < 0:
                raise ArchiveError(f"has {info.filename!r}, which is longer than its stated size")
            file.write(block)
    path.chmod(0o700)
