"""What commands share: options for the terms of a judgement, output files, progress, and Ctrl-C."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from twinmatch.errors import TwinmatchError

if TYPE_CHECKING:
    from rich import progress


def add_terms(parser: argparse.ArgumentParser) -> None:
    """Add the options for candidates, plant, FMUs and parameters."""
    parser.add_argument("--candidates", type=Path, metavar="FILE", help="initial candidates (.yaml)")
    add_plant(parser)
    add_fmus(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="parameters (.yaml), in the format of the nodes"
    )


def add_fmus(parser: argparse.ArgumentParser) -> None:
    """Add the option for FMUs as structures of the plant."""
    parser.add_argument(
        "--allow-fmu",
        metavar="FILE",
        type=Path,
        help="use the FMUs listed in this file (.yaml) as structures of the plant; their code is executed",
    )


def add_plant(parser: argparse.ArgumentParser) -> None:
    """Add the option for the plant, for sessions that do not name it."""
    parser.add_argument(
        "--plant",
        metavar="NAME|FILE.py",
        help="the plant, if the session does not name it, or your plant file, which is executed",
    )


def check_writable(*outputs: Path | None, example: str = "") -> None:
    """Check the output paths before a minute of work, not after; `example` is the name of such a file.

    Raises:
        TwinmatchError: the folder of an output does not exist, or the output is itself a folder.
    """
    for output in outputs:
        if output is None:
            continue
        if not output.absolute().parent.is_dir():
            msg = f"{output}: the folder {output.parent} does not exist; create it first"
            raise TwinmatchError(msg)
        if output.is_dir():
            such = f", such as {output / example}" if example else ""
            msg = f"{output}: is a folder; give the file to write{such}"
            raise TwinmatchError(msg)


class Progress:
    """A context manager with a progress bar on standard error, shown from the first call of `advance`.

    Without a terminal, or on a dumb one, nothing is shown.
    """

    def __init__(self, doing: str = "judging") -> None:
        """Set the label of the bar."""
        self._doing = doing
        self._bar: progress.Progress | None = None
        self._shown = False

    def __enter__(self) -> Progress:
        self._shown = sys.stderr.isatty() and os.environ.get("TERM", "").lower() not in {"dumb", "unknown"}
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, done: int, total: int) -> None:
        """Show that `done` of `total` are done."""
        self._show(self._doing, done, total)

    def reading(self, done: int, total: int) -> None:
        """Show that `done` of `total` bytes of the file are read, before the work itself."""
        self._show("reading", done, total)

    def _show(self, doing: str, done: int, total: int) -> None:
        if self._bar is None and self._shown:
            self._begin()
        if self._bar is not None:
            self._bar.update(self._task, description=doing, completed=done, total=total)

    def _begin(self) -> None:
        from rich.console import Console  # noqa: PLC0415 — needed only for the bar
        from rich.progress import Progress as Bar  # noqa: PLC0415

        self._bar = Bar(console=Console(stderr=True), transient=True, redirect_stdout=False)
        self._task = self._bar.add_task(self._doing, total=None)
        self._bar.start()


@contextmanager
def held_interrupts() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C; the yielded function raises the deferred `KeyboardInterrupt`, if any.

    Python may raise it while a compiled loop converts its arguments or its result, where it is not handled:
    the loop then fails with another error, or the process crashes.
    """
    held = threading.Event()

    def check() -> None:
        if held.is_set():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only the main thread receives signals
        yield check
        return
    before = signal.signal(signal.SIGINT, lambda *_: held.set())
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
    check()
