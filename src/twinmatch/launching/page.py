"""The live page of a launch script: it starts and ends with the script and cannot make it fail."""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from twinmatch.launching.processes import Processes

__all__ = ["PORT", "Page", "add_page_options", "page_of"]

PORT = 5006
POLL = 0.2


class Page:
    """The page's process; without a port there is none. Losing it affects nothing else."""

    def __init__(
        self,
        port: int | None,
        *,
        control: bool = False,
        config: Path | None = None,
        show: Callable[[str], None] = print,
    ) -> None:
        """Serve on this local port; the page's output, with its address, goes to `show`.

        `config` is the parameter file of the twin's nodes.
        """
        self._port, self._show = port, show
        self._options = ["--control"] if control else []
        self._options += ["--config", str(config)] if config is not None else []
        self._processes = Processes(show)

    def __enter__(self) -> Page:
        if self._port is not None:
            options = ["--port", str(self._port), *self._options]
            self._processes.start_module("dashboard", "twinmatch.cli", "dashboard", *options)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._processes.stop()

    def stay(self) -> None:
        """Keep the page open until Ctrl-C, so that the results can be inspected."""
        if self._port is None or self._processes.ended:
            return

        def stop(*_: object) -> None:
            raise KeyboardInterrupt

        for number in (signal.SIGINT, signal.SIGTERM):  # the nodes' runner leaves them ignored
            signal.signal(number, stop)
        self._show("the page stays open until Ctrl-C")
        try:
            while not self._processes.ended:
                time.sleep(POLL)
        except KeyboardInterrupt:
            return


def add_page_options(parser: argparse.ArgumentParser, *, control: bool = False) -> None:
    """Declare `--dashboard`, and `--control` where there is something to control."""
    parser.add_argument(
        "--dashboard",
        type=int,
        nargs="?",
        const=PORT,
        metavar="PORT",
        help=f"serve the live page on this machine (default port: {PORT}; 0: any free port)",
    )
    if control:
        parser.add_argument(
            "--control", action="store_true", help="let the page change the set-point, clear faults and stop"
        )


def page_of(options: argparse.Namespace, parser: argparse.ArgumentParser, config: Path | None = None) -> Page:
    """The page that the command line requests; exits with a usage error if the options contradict."""
    control = bool(getattr(options, "control", False))
    if control and options.dashboard is None:
        parser.error("--control needs the page: give --dashboard too")
    if options.dashboard is not None and not 0 <= options.dashboard <= 65535:
        parser.error(f"--dashboard is {options.dashboard}; give a port from 0 to 65535")
    return Page(options.dashboard, control=control, config=config)
