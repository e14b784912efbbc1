"""`twinmatch verify`: judge a recorded session again and compare."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import Progress, add_options, judging
from twinmatch.offline.verification import verify_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "session", help="session folder or .mcap file")
    topic = "topic of the samples, if the session has several rigs"
    parser.add_argument("--topic", metavar="TOPIC", help=topic)
    add_options(parser, "--plant", "--allow-fmu")
    add_options(
        parser, "--config", help="parameters (.yaml) instead of the recorded ones"
    )
    add_options(
        parser, "--candidates", help="candidates (.yaml) instead of the recorded ones"
    )


def run(options: argparse.Namespace) -> int:
    """Judge again and compare; returns the exit code: 0 identical, 1 different."""
    with Progress() as progress:
        result = verify_session(
            options.session, topic=options.topic, **judging(options, progress)
        )
    for note in result.notes:
        print(f"Note: {note}")
    compared = f"{result.verdicts} verdicts and {result.matches} matches on {result.samples} samples"
    if result.identical:
        print(f"{result.name}: {compared} are identical, bit for bit")
        return 0
    print(
        f"{result.name}: {compared} are not identical. First difference: {result.difference}"
    )
    return 1
