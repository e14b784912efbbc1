"""Hashes of everything a result depends on: the session's content, the terms, the software."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import twinmatch

__all__ = ["content_of", "key_of", "software"]

LIBRARIES = ("numpy", "scipy", "numba")
BLOCK = 1 << 20


def content_of(path: Path) -> str:
    """A hash of a recording, or of the MCAP files and metadata of a session folder.

    Raises:
        OSError: it does not exist or cannot be read.
    """
    if not path.is_dir():
        return _hash([path], path.parent)
    files = [*path.glob("*.mcap"), *path.glob("metadata.yaml")]
    return _hash(sorted(files), path)


def key_of(content: str, terms: str) -> str:
    """One hash of everything a result depends on.

    Args:
        content: from `content_of`.
        terms: settings and candidates, as text.
    """
    return hashlib.sha256("\0".join((content, terms, software())).encode()).hexdigest()


@cache
def software() -> str:
    """Version and code hash of this package, and versions of the numerical libraries.

    The last bits of a result may depend on any of them.
    """
    root = Path(twinmatch.__file__).parent
    code = _hash(sorted(root.rglob("*.py")), root)[:12]
    found = [f"twinmatch {twinmatch.__version__} (code {code})"]
    for library in LIBRARIES:
        try:
            found.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            found.append(f"{library} unknown")
    return ", ".join(found)


def _hash(files: Iterable[Path], root: Path) -> str:
    digest = hashlib.sha256()
    for file in files:
        size = file.stat().st_size
        digest.update(f"{file.relative_to(root)}\0{size}\0".encode())
        with file.open("rb") as stream:
            while block := stream.read(BLOCK):
                digest.update(block)
    return digest.hexdigest()
