"""`twinmatch import`: a recording becomes a session."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "recording", type=Path, help=".mat with a matrix 'simout', or .csv with named columns"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SESSION", help="folder to write")
    parser.add_argument("--overwrite", action="store_true", help="replace a session that is already there")


def run(options: argparse.Namespace) -> int:
    """Write the session; returns the exit code.

    Raises:
        TwinmatchError: the recording cannot be used, or the session cannot be written.
    """
    from twinmatch.judging.progress import Progress  # noqa: PLC0415
    from twinmatch.sessions import read_recording, samples_of, write_session  # noqa: PLC0415 — keeps --help fast

    with Progress("reading") as progress:
        window = read_recording(options.recording, progress.advance)
    with Progress("writing") as progress:
        write_session(options.output, samples_of(window), overwrite=options.overwrite, told=progress.advance)
    print(
        f"{options.output}: {len(window)} samples, {len(window) * window.period:.0f} s, "
        f"from {options.recording.name}"
    )
    return 0
