"""The command line of `twinmatch`: one module per command, imported when its command is called.

Each module declares its options with `add_arguments` and does its work in `run`. What needs ROS, matplotlib
or a terminal is imported in functions: the rest must do without.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import signal
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Final

from twinmatch import __version__
from twinmatch.cli.starting import started
from twinmatch.errors import EXIT_INTERRUPTED, EXIT_USER_ERROR, TwinmatchError
from twinmatch.linear_algebra import start_one_thread
from twinmatch.nodes import require_ros
from twinmatch.offline.processes import GARBAGE, LASTING_GARBAGE
from twinmatch.printing import printable_output

__all__ = ["main"]

_COMMANDS: Final[dict[str, str]] = {
    "demo": "see twinmatch work, on a virtual rig or a recorded session",
    "live": "run the twin beside a plant: bridges, controller, twin and recorder",
    "attach": "run the twin beside a rig that is already running; nothing is commanded",
    "play": "play a recorded session through the ROS graph",
    "import": "turn a recording (.csv, .mat or a ROS bag) into an MCAP session",
    "replay": "judge recorded sessions offline, as fast as possible",
    "forecast": "forecast from chosen samples of a session, with a prediction band",
    "try-controller": "may a controller be run? answered from recorded sessions, before it runs",
    "retune": "better gains for the PID of a recorded session, with a margin on every twin",
    "apply": "have the running controller try another law, watched within predicted bands, with a way back",
    "experiment": "what next? the shortest safe course after which most is known, from a recorded session",
    "verify": "judge a recorded session again and compare the verdicts, bit for bit",
    "backtest": "score the twin's forecasts of recorded sessions against the measurements and against other "
    "methods",
    "repair": "repair a session whose recorder was killed",
    "remember": "learn from recorded sessions: what they determine is kept for the next ones",
    "memory": "show what is remembered of your rigs, and what has changed on them",
    "forget": "take sessions out of a memory",
    "report": "write a report on a session: one HTML file with figures and tables",
    "dashboard": "show the running graph on a live page in the browser",
    "foxglove": "serve the graph to Foxglove and Lichtblick",
    "virtual-rig": "emulate a rig: the Peltier rig's board, camera and plate, or the kit",
    "fmu": "list an FMU's variables and draft the map that makes it a structure of a plant",
    "new-plant": "write a first file for your own plant, with its test and configuration",
    "check-plant": "report what is wrong with a plant's file, and what to change",
    "prepare": "derive and compile the plants' equations now, so that the first run need not",
}
"""Help text of each command."""
_OF_ROS: Final = frozenset({"demo", "live", "play", "dashboard", "foxglove", "apply"})
"""Commands that run, show or ask the graph; `attach` does with other sources than ROS, and `experiment` asks
it with `--live` only."""
_LAUNCHING: Final = frozenset({"attach", "live", "play"})
"""Commands that start processes, which a signal that comes meanwhile must not leave behind."""
_LASTING: Final = frozenset(
    {"attach", "dashboard", "demo", "foxglove", "live", "play", "virtual_rig"}
)
"""Commands that may run for days, by the names of their modules: their garbage is not left to add up."""
_EXTRAS: Final = {
    "bokeh": "dashboard",
    "distributed": "cluster",
    "fmpy": "fmu",
    "foxglove": "foxglove",
    "paho": "mqtt",
    "prometheus_client": "outlets",
    "pymodbus": "modbus",
    "rosbags": "bags",
    "tclab": "tclab",
}
"""The extra of each optional package, by the name it is imported by."""


class _Parser(argparse.ArgumentParser):
    """The parser of the program, or that of a command, which gets its options when the command is called."""

    command = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, with the options of the command's module."""
        if self.command:
            # `import` is a keyword, so its module has a trailing underscore.
            name = {"import": "import_"}.get(
                self.command, self.command.replace("-", "_")
            )
            module = import_module(f"twinmatch.cli.{name}")
            self.command = ""
            module.add_arguments(self)
            self.set_defaults(command=module.run, parser=self)
        return super().parse_known_args(args, namespace)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 2 an error the user can correct, 130 interrupted.

    Args:
        arguments: the command and its arguments; None: those of this process, which does nothing else.
    """
    if arguments is None:
        start_one_thread()
    gc.set_threshold(GARBAGE)
    # Python would look for cycles among all objects once more before it ends: a twentieth of a replay's time.
    atexit.register(gc.freeze)
    with printable_output():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    try:
        options = command_parser().parse_args(arguments)
        options.is_program = arguments is None
        command: Callable[[argparse.Namespace], int] = options.command
        if (name := command.__module__.rpartition(".")[2]) in _OF_ROS:
            require_ros(name)
        if name in _LASTING:
            gc.set_threshold(LASTING_GARBAGE)
        if name in _LAUNCHING and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, signal.default_int_handler)
        if getattr(options, "allow_fmu", None) is not None:
            from twinmatch.fmu import adopt_fmus  # noqa: PLC0415

            adopt_fmus(options.allow_fmu)
        with started(options):
            return command(options)
    except TwinmatchError as error:
        printable = "".join(
            c if c.isprintable() else ascii(c)[1:-1] for c in str(error)
        )  # it may quote a file
        print(f"twinmatch: {printable}", file=sys.stderr)
        return EXIT_USER_ERROR
    except ModuleNotFoundError as error:
        return _without(error, command)
    except KeyboardInterrupt:
        print("twinmatch: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # the reader has closed the pipe; Python would report the failed flush at exit
        sys.stderr.close()
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        # A path from any option: the file system rejects the name, or a folder may not be entered.
        print(
            f"twinmatch: {error.filename}: cannot be used ({error.strerror})",
            file=sys.stderr,
        )
        return EXIT_USER_ERROR


def _without(
    error: ModuleNotFoundError, command: Callable[[argparse.Namespace], int]
) -> int:
    """Say which optional package a command lacks; returns the exit code. Any other import is a defect."""
    package = (error.name or "").partition(".")[0]
    if package not in _EXTRAS:
        raise error
    name = command.__module__.rpartition(".")[2]
    install = f"pip install 'twinmatch[{_EXTRAS[package]}]'"
    print(
        f"twinmatch: {name} needs {package}, which is not installed; {install}",
        file=sys.stderr,
    )
    return EXIT_USER_ERROR


def command_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = _Parser(
        prog="twinmatch",
        description="Which digital twin to trust, and how far, while the plant runs.",
    )
    parser.add_argument(
        "--version", action="version", version=f"twinmatch {__version__}"
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, words in _COMMANDS.items():
        commands.add_parser(name, help=words).command = name
    return parser
