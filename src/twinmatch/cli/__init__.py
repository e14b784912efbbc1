"""The command line of `twinmatch`: one module per command.

Each module declares its options with `add_arguments` and does its work in `run`. Slow imports belong in
`run`: the parser calls `add_arguments` of every command, whichever command is called.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from twinmatch import __version__
from twinmatch.cli import (
    attach,
    backtest,
    check_plant,
    dashboard,
    demo,
    fmu,
    forecast,
    foxglove,
    import_,
    live,
    new_plant,
    play,
    prepare,
    repair,
    replay,
    report,
    verify,
    virtual_rig,
)
from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError

__all__ = ["main"]

EXIT_INTERRUPTED = 130


class _Command(Protocol):
    """Interface of a command's module."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the options."""

    def run(self, options: argparse.Namespace) -> int:
        """Do the work; returns the exit code."""


_COMMANDS: Final[tuple[tuple[str, _Command, str], ...]] = (
    ("demo", demo, "see twinmatch work, on a virtual rig or a recorded session"),
    ("live", live, "run the twin beside a plant: bridges, controller, twin and recorder"),
    ("attach", attach, "run the twin beside a rig that is already running; nothing is commanded"),
    ("play", play, "play a recorded session through the ROS graph"),
    ("import", import_, "turn a recording (.csv, .mat or a ROS bag) into an MCAP session"),
    ("replay", replay, "judge recorded sessions offline, as fast as possible"),
    ("forecast", forecast, "forecast from chosen samples of a session, with a prediction band"),
    ("verify", verify, "judge a recorded session again and compare the verdicts, bit for bit"),
    (
        "backtest",
        backtest,
        "score the twin's forecasts of recorded sessions against the measurements and against other methods",
    ),
    ("repair", repair, "repair a session whose recorder was killed"),
    ("report", report, "write a report on a session: one HTML file with figures and tables"),
    ("dashboard", dashboard, "show the running graph on a live page in the browser"),
    ("foxglove", foxglove, "serve the graph to Foxglove and Lichtblick"),
    ("virtual-rig", virtual_rig, "emulate a rig: the Peltier rig's board, camera and plate, or the kit"),
    ("fmu", fmu, "list an FMU's variables and draft the map that makes it a structure of a plant"),
    ("new-plant", new_plant, "write a first file for your own plant, with its test and configuration"),
    ("check-plant", check_plant, "report what is wrong with a plant's file, and what to change"),
    ("prepare", prepare, "derive and compile the plants' equations now, so that the first run need not"),
)
"""Name, module and help text of each command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 2 an error the user can correct, 130 interrupted."""
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
        sys.stderr.close()  # the reader has closed the pipe; Python would report the failed flush at exit
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        # A path from any option: the file system rejects the name, or a folder may not be entered.
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
