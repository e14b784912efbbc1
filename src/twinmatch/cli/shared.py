"""What commands share: options, checks of them, progress, and what they write."""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.shipped_code import why_not_used

if TYPE_CHECKING:
    from rich import progress

    from twinmatch.sampling.sources import SignalMap
    from twinmatch.sessions import Session
    from twinmatch.showing.console import Console
    from twinmatch.showing.page.goal import Goal

EXIT_PARTLY: Final = 3
"""Exit code: some of several sessions were used and some skipped."""


def exit_code(used: int, skipped: int) -> int:
    """The exit code of a command for several sessions."""
    if not skipped:
        return 0
    return EXIT_PARTLY if used else EXIT_USER_ERROR


def speed(text: str) -> float:
    """A speed from the command line: a number, or `max`."""
    return math.inf if text == "max" else float(text)


PEERS: Final = ("persistence", "arx")
_FILE: Final = {"type": Path, "metavar": "FILE"}
_OUT: Final = {"type": Path, "metavar": "OUT"}
_FLAG: Final = {"action": "store_true"}
OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "session": {
        "type": Path,
        "help": "session folder, .mcap file or recording (.mat, .csv)",
    },
    "sessions": {
        **{"type": Path, "nargs": "+", "metavar": "SESSION"},
        "help": "session folder, .mcap file, recording (.mat, .csv), folder of any of these, or pattern",
    },
    "--candidates": {**_FILE, "help": "initial candidates (.yaml)"},
    "--config": {**_FILE, "help": "parameters (.yaml), in the format of the nodes"},
    "--twin-config": {**_FILE, "help": "parameters of the twin's nodes"},
    "--plant": {
        "metavar": "NAME|FILE.py",
        "help": "the plant, if the session does not name it, or your plant file, which is executed",
    },
    "--allow-fmu": {
        **_FILE,
        "help": "use the FMUs listed in this file (.yaml) as structures of the plant; their code is executed",
    },
    "--memory": {
        **_FILE,
        "help": "the memory (default: one per plant and rig in the user's data folder)",
    },
    "--rig": {
        "default": "",
        "metavar": "NAME",
        "help": "which of several plants of this kind it is",
    },
    "--json": {**_OUT, "help": "write every verdict to this file"},
    "--figure": {**_OUT, "help": "draw the verdict (.png, .svg or .pdf)"},
    "--map": {"nargs": "+", "default": [], "metavar": "SIGNAL=COLUMN"},
    "--map-file": {**_FILE, "help": "the same as YAML; --map takes precedence"},
    "--peers": {
        **{"nargs": "*", "choices": PEERS, "default": list(PEERS)},
        "help": "methods to compare the twin with; without a value: none (default: all)",
    },
    "--period": {"type": float, "metavar": "S"},
    "--bridge": {
        **{"type": float, "metavar": "S"},
        "help": "longest gap to interpolate across (default: three rows)",
    },
    "--gaps": {
        **{"choices": ("refuse", "split"), "default": "refuse"},
        "help": "what to do with longer gaps: refuse them (default), or split the recording there, so that "
        "no window reaches across",
    },
    "--session": {
        "type": Path,
        "metavar": "FOLDER",
        "help": "record here (default: sessions/<time>)",
    },
    "--speed": {
        **{"type": speed, "default": 1.0, "metavar": "N"},
        "help": "highest speed of the virtual rig, times real time, or max (default: 1)",
    },
    "--fault": {
        **{"action": "append", "default": [], "metavar": "KIND@S[+S],…"},
        "help": "faults of the virtual rig with their start and duration; repeatable",
    },
    "--board": {
        **{"default": "auto", "metavar": "KIND"},
        "help": "board of the virtual Peltier rig: simavr: the firmware image on a simulated processor; "
        "python: a stand-in; auto (default): simavr if available",
    },
    "--seed": {
        "type": int,
        "default": 0,
        "help": "seed of the virtual sensor's noise (default: 0)",
    },
    "--no-record": {**_FLAG, "help": "record nothing"},
}
"""Arguments that several commands have, with their usual help texts."""
TERMS: Final = (
    "--candidates",
    "--memory",
    "--rig",
    "--plant",
    "--allow-fmu",
    "--config",
)
"""Options for the terms of a judgement."""


def add_options(
    parser: argparse._ActionsContainer, *names: str, **changed: Any
) -> None:
    """Add arguments of `OPTIONS`, with these changes of their settings."""
    for name in names:
        parser.add_argument(name, **OPTIONS[name] | changed)


def open_shown(path: Path, plant: str | None = None) -> Session:
    """Read a session of any kind, with a progress bar, and say what is missing of it."""
    from twinmatch.importing import open_any  # noqa: PLC0415

    with Progress("reading") as progress:
        session = open_any(path, progress=progress.advance, plant=plant)
    say_missing(session.name, session.missing)
    return session


def say_missing(name: str, missing: Sequence[str]) -> None:
    """Say on standard error what a session lacks, or what of it may be wrong."""
    for lack in missing:
        print(f"twinmatch: session {name} is not complete: {lack}", file=sys.stderr)


def judging(options: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Arguments of whatever reads a session and judges it: the options of `TERMS`, and its progress."""
    arguments = {
        name: getattr(options, name) for name in ("config", "candidates", "plant")
    }
    return {
        **arguments,
        "watch": progress.advance,
        "progress": partial(progress.show, "reading"),
    }


def column_map(options: argparse.Namespace) -> SignalMap:
    """The map in `--map-file`, updated with `--map`.

    Raises:
        TwinmatchError: one of them is not a map.
    """
    from twinmatch.importing.column_map import read_map  # noqa: PLC0415
    from twinmatch.sampling.sources import SignalMap, parse_map  # noqa: PLC0415

    written = read_map(options.map_file) if options.map_file else SignalMap()
    return written.joined(parse_map(options.map))


def positive_period(options: argparse.Namespace, command: str) -> float | None:
    """The value of `--period`, s.

    Raises:
        TwinmatchError: it is not positive.
    """
    period: float | None = options.period
    if period is not None and not period > 0:
        raise TwinmatchError(
            f"{command}: --period is {period:g}; give a positive number of seconds"
        )
    return period


def positive(kind: Callable[[str], float], expected: str) -> Callable[[str], float]:
    """A parser of positive finite numbers; the error says that the text is not what is `expected`."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = 0.0
        if not 0.0 < value < float("inf"):
            raise argparse.ArgumentTypeError(f"{text!r} is not {expected}")
        return value

    return parse


def check_writable(*outputs: Path | None, example: str = "") -> None:
    """Check the output paths before a minute of work, not after; `example` is the name of such a file.

    Raises:
        TwinmatchError: the folder of an output does not exist, or the output is itself a folder.
    """
    for output in outputs:
        if output is None:
            continue
        if not output.absolute().parent.is_dir():
            raise TwinmatchError(
                f"{output}: the folder {output.parent} does not exist; create it first"
            )
        if output.is_dir():
            hint = f", such as {output / example}" if example else ""
            raise TwinmatchError(f"{output}: is a folder; give the file to write{hint}")


def write_json(path: Path | None, content: Callable[[], Any]) -> None:
    """Write a document as strict JSON, if a file is given.

    Raises:
        TwinmatchError: the file cannot be written.
    """
    if path is None:
        return
    import msgspec  # noqa: PLC0415

    value = content()
    try:
        text = msgspec.json.format(
            msgspec.json.encode(value, enc_hook=methodcaller("item")), indent=1
        )
    except UnicodeEncodeError:  # a path that is not UTF-8: its bytes become escapes
        text = json.dumps(
            value, indent=1, default=methodcaller("item"), allow_nan=False
        ).encode("ascii")
    try:
        path.write_bytes(text + b"\n")
    except OSError as error:
        raise TwinmatchError(f"{path}: cannot be written ({error.strerror})") from error


def console_for(width: int) -> Console:
    """A console for tables, of this width, in characters, where the output is not a terminal."""
    from twinmatch.showing.console import Console  # noqa: PLC0415

    console = Console()
    if not console.is_terminal:
        console.width = width
    return console


class Progress:
    """A context manager with a progress bar on standard error, shown from the first call of `advance`.

    Without a terminal, or on a dumb one, work that takes longer than `SILENCE` is reported in lines, and
    compilation, for which a first run waits a minute or more, as soon as it begins.
    """

    SILENCE: ClassVar = 10.0
    """Longest time without a line, s, where nobody sees a bar."""

    def __init__(self, doing: str = "judging") -> None:
        """Set the label of the bar."""
        self._doing = doing
        self._printed_at = time.monotonic()
        self._bar: progress.Progress | None = None
        self._shown = False
        self._progress = 0, 0
        self._compiled = 0
        """Kernels that have been compiled for this work, the one in progress included."""

    def __enter__(self) -> Progress:
        from twinmatch.compiled import told  # noqa: PLC0415

        told.append(self._compile)
        self._shown = sys.stderr.isatty() and os.environ.get(
            "TERM", ""
        ).lower() not in {"dumb", "unknown"}
        return self

    def __exit__(self, *_: object) -> None:
        from twinmatch.compiled import told  # noqa: PLC0415

        told.remove(self._compile)
        if self._bar is not None:
            self._bar.stop()

    def _compile(self, compiled: str) -> None:
        if not self._compiled:
            self._printed_at -= self.SILENCE  # the next line is due
            self._remark(why_not_used())
        self._compiled += 1
        doing = f"{self._doing}, compiling {compiled} once on this machine ({self._compiled} so far)"
        self.show(doing, *self._progress)

    def _remark(self, remark: str) -> None:
        """Show a line that stays."""
        if remark and self._bar is not None:
            self._bar.console.print(f"twinmatch: {remark}", markup=False)
        elif remark:
            print(f"twinmatch: {remark}", file=sys.stderr, flush=True)

    def advance(self, parts_done: int, total: int) -> None:
        """Show that `parts_done` of `total` are done."""
        self.show(self._doing, parts_done, total)

    def show(self, doing: str, parts_done: int, total: int) -> None:
        """Show what is being done, and that `parts_done` of its `total` parts are; 0 parts: nobody knows."""
        self._progress = parts_done, total
        if self._bar is None and self._shown:
            from rich.progress import Progress as Bar  # noqa: PLC0415

            from twinmatch.showing.console import Console  # noqa: PLC0415

            self._bar = Bar(
                console=Console(stderr=True), transient=True, redirect_stdout=False
            )
            self._task = self._bar.add_task(doing, total=None)
            self._bar.start()
        if self._bar is not None:
            self._bar.update(
                self._task, description=doing, completed=parts_done, total=total or None
            )
        elif not self._shown and time.monotonic() - self._printed_at > self.SILENCE:
            self._printed_at = time.monotonic()
            share = f", {parts_done / total:.0%} done" if total else ""
            print(f"twinmatch: {doing}{share}", file=sys.stderr, flush=True)


def add_serving_options(parser: argparse.ArgumentParser, port: int) -> None:
    """Add the options for the address, the port (default `port`), the names and the namespace of a server."""
    address = "serve on this address; any but 127.0.0.1 is open to other machines"
    parser.add_argument("--address", default="127.0.0.1", help=address)
    port_words = f"TCP port (default: {port}); 0: any free port"
    parser.add_argument("--port", type=int, default=port, help=port_words)
    host_help = "a name it answers to, besides localhost and its address, or whose pages may use it; repeatable"
    parser.add_argument(
        "--host", action="append", metavar="NAME", dest="hosts", help=host_help
    )
    parser.add_argument(
        "--namespace", default="", metavar="/RIG", help="namespace of the plant to show"
    )


def serving_words(
    command: str, options: argparse.Namespace, library: str, **parameters: Any
) -> list[str]:
    """The command line of a server's node: address, port, names, namespace, these parameters; None left out.

    Raises:
        ServingError: an option has an invalid value, or `library` (of the extra named `command`) is not
            installed.
    """
    from twinmatch.showing.serving import ServingError  # noqa: PLC0415

    if not 0 <= options.port <= 65535:
        raise ServingError(
            f"{command}: --port is {options.port}; give a port from 0 to 65535"
        )
    if importlib.util.find_spec(library) is None:
        raise ServingError(
            f"{command}: {library} is not installed; pip install 'twinmatch[{command}]'"
        )
    if (
        options.namespace
        and re.fullmatch(r"(/?[A-Za-z_][A-Za-z0-9_]*)+", options.namespace) is None
    ):
        raise ServingError(
            f"{command}: {options.namespace!r} is not a namespace; give one such as /rig_a"
        )
    shared_options = {
        name: getattr(options, name) for name in ("address", "port", "hosts")
    }
    words = node_words(command, {**shared_options, **parameters})
    return (
        [*words, "-r", f"__ns:=/{options.namespace.removeprefix('/')}"]
        if options.namespace
        else words
    )


def add_goal_options(parser: argparse._ActionsContainer) -> None:
    """Add `--reach` and `--by` of a running plant."""
    reach = (
        "say when the output is at this level, and when it is there if one begins now"
    )
    parser.add_argument("--reach", type=float, metavar="LEVEL", help=reach)
    by = "with --reach: say when to begin to be there by this time of day"
    parser.add_argument("--by", metavar="HH:MM", help=by)


def goal_of(options: argparse.Namespace) -> Goal:
    """The goal that `--reach` and `--by` name.

    Raises:
        ClockTimeError: the level or the time cannot be used.
    """
    from twinmatch.showing.page.goal import Goal  # noqa: PLC0415

    return Goal(options.reach, options.by or "")


def node_words(name: str, parameters: Mapping[str, Any]) -> list[str]:
    """The command line of a node with these parameters; None: left out."""
    words = [name, "--ros-args"]
    for key, value in parameters.items():
        if value is not None:
            text = json.dumps(
                str(value) if isinstance(value, Path) else value, ensure_ascii=False
            )
            words += ["-p", f"{key}:={text}"]
    return words


def session_to_record(options: argparse.Namespace) -> Path | None:
    """The new folder that the options `--session` and `--no-record` name; None: record nothing."""
    from twinmatch.launching.processes import refuse_existing  # noqa: PLC0415

    session = options.session or Path("sessions") / time.strftime("%Y-%m-%d_%H-%M-%S")
    session = None if options.no_record else session
    refuse_existing(session)
    return session
