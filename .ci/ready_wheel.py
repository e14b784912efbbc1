"""Adds machine code to a wheel of twinmatch: that of its kernels and of its plants.

The kernels are compiled by `twinmatch prepare`, run from what the wheel holds. numba keeps them beside the
sources, where it also looks for them in an installation.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

from twinmatch.shipped_code import MADE_WITH, versions

OWN_FOLDERS = ("NUMBA_CACHE_DIR", "NUMBA_CACHE_LOCATOR_CLASSES", "NUMBA_CPU_NAME")
"""Settings of numba that would have it keep kernels elsewhere, or for another processor."""


def main(path: str, compiled: Path | None = None) -> int:
    """Add machine code to this wheel; returns the exit code.

    Args:
        path: the wheel.
        compiled: a folder of the package that has kernels already; those that are still right are taken.
    """
    wheel = Path(path)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)
        if compiled is not None:
            copy_kernels(compiled, folder / "twinmatch")
        prepare(folder)
        made_with = folder / "twinmatch" / "machine_code" / MADE_WITH.name
        made_with.write_text(json.dumps(versions()), "utf-8")
        files = {
            str(file.relative_to(folder)): file.read_bytes()
            for file in machine_code(folder / "twinmatch")
        }
    add(wheel, files)
    size = sum(map(len, files.values()))
    print(f"dist: {wheel}: {len(files)} files of machine code, {size / 1e6:.1f} MB")
    return 0


def copy_kernels(package: Path, to: Path) -> None:
    """Copy the kernels beside the sources of one package to those of another."""
    for file in package.rglob("__pycache__/*.nb[ic]"):
        copy = to / file.relative_to(package)
        copy.parent.mkdir(exist_ok=True)
        shutil.copy(file, copy)


def prepare(folder: Path) -> None:
    """Compile what the package in this folder would compile at its first use."""
    environment = {
        name: value for name, value in os.environ.items() if name not in OWN_FOLDERS
    }
    environment["PYTHONPATH"] = str(folder)
    environment["TWINMATCH_CACHE"] = str(folder / "twinmatch" / "machine_code")
    command = [sys.executable, "-m", "twinmatch.cli", "prepare"]
    subprocess.run(
        command, check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL
    )


def machine_code(package: Path) -> Iterator[Path]:
    """The files to add: kernels with their indices, plants, and what they were made with.

    Plants of users are found by their equations, those of the package by their sources alone.
    """
    yield from sorted(package.rglob("__pycache__/*.nb[ic]"))
    for file in sorted(package.glob("machine_code/*.code")):
        if not file.name.startswith("equations_"):
            yield file
    yield from package.glob(f"machine_code/{MADE_WITH.name}")


def add(wheel: Path, files: dict[str, bytes]) -> None:
    """Write files into a wheel and its list of files.

    The format of wheels: https://packaging.python.org/en/latest/specifications/binary-distribution-format/
    """
    with zipfile.ZipFile(wheel) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    (record,) = (name for name in contents if name.endswith(".dist-info/RECORD"))
    listed = io.StringIO(contents.pop(record).decode())
    rows = [row for row in csv.reader(listed) if row[0] != record]
    for name, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest())
        rows.append([name, f"sha256={digest.rstrip(b'=').decode()}", str(len(content))])
    rows.append([record, "", ""])
    written = io.StringIO()
    csv.writer(written, lineterminator="\n").writerows(rows)
    contents |= files
    contents[record] = written.getvalue().encode()
    draft = wheel.with_suffix(".draft")
    with zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    draft.replace(wheel)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
