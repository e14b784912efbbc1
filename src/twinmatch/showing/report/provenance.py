"""Provenance of a report: program versions, files, parameters."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import twinmatch
from twinmatch.errors import TwinmatchError
from twinmatch.parameters.twin import twin_table, values_of
from twinmatch.twin import TwinSettings

_LIBRARIES = ("numpy", "scipy", "numba", "control", "mcap", "matplotlib", "Jinja2")
_CHUNK = 1 << 20


class FileHash(NamedTuple):
    """One file of the session."""

    name: str
    size: int
    """Bytes."""
    sha256: str


class RecordedSetting(NamedTuple):
    """One parameter."""

    name: str
    value: str
    unit: str
    meaning: str
    changed: bool
    """Whether it differs from the default."""


@dataclass(frozen=True)
class Provenance:
    """Everything needed to repeat a report."""

    made: str
    """Date and time, with the offset from UTC."""
    command: str
    """The command line, or a description of the call."""
    versions: tuple[tuple[str, str], ...]
    files: tuple[FileHash, ...]
    settings: tuple[RecordedSetting, ...]


def provenance(path: Path, settings: TwinSettings, command: str, made: datetime) -> Provenance:
    """Collect the provenance.

    Args:
        path: the session: a file, or a folder with all its files.
        settings: the settings the session was judged with.
        command: the command line.
        made: date and time of the report, with time zone.
    """
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    return Provenance(
        made=made.isoformat(sep=" ", timespec="seconds"),
        command=command,
        versions=_versions(),
        files=tuple(_hash(file, path) for file in files),
        settings=settings_of(settings),
    )


def settings_of(settings: TwinSettings) -> tuple[RecordedSetting, ...]:
    """Every parameter with unit and meaning, under its name in a parameter file."""
    values, model = values_of(settings), settings.start.model
    return tuple(
        RecordedSetting(p.name, _text(values[p.name]), p.unit, p.description, values[p.name] != p.default)
        for p in twin_table(model.plant, model.structure_name)
        if p.name in values
    )


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(_text(v) for v in value) or "none"
    if isinstance(value, float):
        return f"{value:g}".replace("inf", "∞").replace("-", "−")
    return str(value)


def _versions() -> tuple[tuple[str, str], ...]:
    found = [("twinmatch", twinmatch.__version__), ("Python", platform.python_version())]
    for name in _LIBRARIES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            found.append((name, "installed without metadata"))
    return (*found, ("system", f"{platform.system()} {platform.machine()}"))


def _hash(file: Path, path: Path) -> FileHash:
    digest = hashlib.sha256()
    try:
        with file.open("rb") as stream:
            while chunk := stream.read(_CHUNK):
                digest.update(chunk)
            size = stream.tell()
    except OSError as error:
        raise TwinmatchError(f"{file}: cannot be read ({error.strerror})") from error
    name = str(file.relative_to(path)) if file != path else file.name
    return FileHash(name, size, digest.hexdigest())
