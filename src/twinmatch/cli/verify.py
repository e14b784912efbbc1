"""`twinmatch verify`: judge a recorded session again and compare."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.offline.command_line import Progress, add_fmus, add_plant


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("session", type=Path, help="session folder or .mcap file")
    parser.add_argument(
        "--topic", metavar="TOPIC", help="topic of the samples, if the session has several rigs"
    )
    add_plant(parser)
    add_fmus(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="parameters (.yaml) instead of the recorded ones"
    )
    parser.add_argument(
        "--candidates", type=Path, metavar="FILE", help="candidates (.yaml) instead of the recorded ones"
    )


def run(options: argparse.Namespace) -> int:
    """Judge again and compare; returns the exit code: 0 identical, 1 different."""
    from twinmatch.offline.verification import verify_session  # noqa: PLC0415 — keeps --help fast

    with Progress() as progress:
        found = verify_session(
            options.session,
            topic=options.topic,
            config=options.config,
            candidates=options.candidates,
            plant=options.plant,
            watch=progress.advance,
            progress=progress.reading,
        )
    for note in found.notes:
        print(f"Note: {note}")
    compared = f"{found.verdicts} verdicts and {found.matches} matches on {found.samples} samples"
    if found.identical:
        print(f"{found.name}: {compared} are identical, bit for bit")
        return 0
    print(f"{found.name}: {compared} are not identical. First difference: {found.difference}")
    return 1
