"""The command line of `twinmatch`: a module for each command that no room of the house brings itself.

Each declares its options with `add_arguments` and does its work in `run`, and only there imports what is
slow: the command line asks all of them for their options, whichever command is called.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from twinmatch import __version__
from twinmatch.cli import (
    attaching,
    backtesting,
    checking,
    demonstrating,
    fmus,
    forecasting,
    importing,
    living,
    planting,
    playing,
    preparing,
    repairing,
    replaying,
    verifying,
)
from twinmatch.dashboard import command as dashboard
from twinmatch.emulation import virtual_rig_program as virtual_rig
from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.foxglove import command as foxglove
from twinmatch.reporting import command as reporting

__all__ = ["main"]

EXIT_INTERRUPTED = 130


class _Command(Protocol):
    """What a command's module has."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the options."""

    def run(self, options: argparse.Namespace) -> int:
        """Do the work; returns the exit code."""


_COMMANDS: Final[tuple[tuple[str, _Command, str], ...]] = (
    ("demo", demonstrating, "see twinmatch work, on a virtual rig or a recorded session"),
    ("live", living, "run the twin beside a plant: bridges, controller, twin and recorder"),
    ("attach", attaching, "run the twin beside a rig that runs already; nothing is commanded"),
    ("play", playing, "play a recorded session through the ROS graph"),
    ("import", importing, "turn a recording (.mat or .csv) into an MCAP session"),
    ("replay", replaying, "judge recorded sessions offline, as fast as it goes"),
    ("forecast", forecasting, "say what comes after chosen samples of a session, with a band"),
    ("verify", verifying, "judge a recorded session again and compare the verdicts, bit for bit"),
    (
        "backtest",
        backtesting,
        "the twin's forecasts of recorded sessions, against what came and against others'",
    ),
    ("repair", repairing, "make a session whole whose recorder was killed"),
    ("report", reporting, "write a session up as one HTML file, with its figures and tables"),
    ("dashboard", dashboard, "the live page: what the graph says, in a browser"),
    ("foxglove", foxglove, "serve the graph to Foxglove and Lichtblick"),
    ("virtual-rig", virtual_rig, "the Peltier rig without the rig: board, camera and plate emulated"),
    ("fmu", fmus, "say what an FMU has, and draft the map that makes it a structure of a plant"),
    ("new-plant", planting, "write a first file of a plant of yours, with its test and configuration"),
    ("check-plant", checking, "say in plain words what is wrong with a plant's file"),
    ("prepare", preparing, "derive and compile the plants' equations now, so that no first run waits"),
)
"""Name, module, and what it is for."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 2 a mistake the user can mend, 130 interrupted."""
    parser = _parser()
    options = parser.parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        if getattr(options, "allow_fmu", None) is not None:
            from twinmatch.fmu import adopt_fmus  # noqa: PLC0415 — keeps --help fast

            adopt_fmus(options.allow_fmu)
        return command(options)
    except TwinmatchError as error:
        print(f"twinmatch: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        print("twinmatch: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()  # the reader has gone; Python would complain about the flush at exit
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        # Whichever option named it: the file system does not take the name, or a folder may not be entered.
        print(f"twinmatch: {error.filename}: cannot be used ({error.strerror})", file=sys.stderr)
        return EXIT_USER_ERROR


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="twinmatch", description="Which digital twin to trust, and how far, while the plant runs."
    )
    parser.add_argument("--version", action="version", version=f"twinmatch {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, command, words in _COMMANDS:
        one = commands.add_parser(name, help=words)
        command.add_arguments(one)
        one.set_defaults(command=command.run, parser=one)
    return parser
