"""`twinmatch repair`: repair a session whose recorder was killed."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import add_options
from twinmatch.sessions.recording import repair_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "session", help="session folder")


def run(options: argparse.Namespace) -> int:
    """Repair; returns the exit code."""
    repaired = repair_session(options.session)
    contents = f"{repaired.messages} messages over {repaired.duration:.1f} s"
    if not repaired.faults:
        print(f"{options.session}: complete, {contents}; nothing to repair")
        return 0
    print(
        f"{options.session}: repaired ({'; '.join(repaired.faults)}); {contents} were saved"
    )
    if repaired.original is not None:
        print(
            f"The file was damaged before its end, so the original was kept: {repaired.original}"
        )
    return 0
