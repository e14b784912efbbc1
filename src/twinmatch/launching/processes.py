"""Child processes: started, watched, ended in a safe order, never left behind.

Each child gets its own process group, so that Ctrl-C reaches only the parent, which then ends the children
in the safe order. If the parent is killed (kill -9), the kernel sends each child SIGTERM. The live page is
such a child too: it starts and ends with the script and cannot make it fail.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from twinmatch.errors import TwinmatchError
from twinmatch.launching.forking import Forked, fork_server

PORT = 5006
"""Usual port of the live page."""
TELL = "let the page publish what it shows to an MQTT broker, such as mqtt://HOST or mqtts://USER@HOST"
"""Help of `--tell`."""

EXIT_NOT_RECORDED = 1
"""Exit code if the session could not be written to the end, and the run was not to continue without it."""


class LaunchError(TwinmatchError):
    """A process could not be started, or ended when it should not have."""


class Processes:
    """The children of one launch script; each line that one prints is shown with its name as prefix."""

    PATIENCE: Final = 12.0
    """Time between SIGTERM and SIGKILL, s."""

    def __init__(self, show: Callable[[str], None] = print) -> None:
        """Start without children; their output goes to `show`, line by line."""
        self._show = show
        self.environment: dict[str, str] = {}
        """Variables for the children that are started from now on, in addition to ours."""
        # with the reader of its output
        self._children: dict[str, tuple[Forked, threading.Thread]] = {}

    def start_module(self, name: str, module: str, *arguments: str) -> None:
        """Start `python -m module arguments` as a child of this name.

        Raises:
            LaunchError: no process can be made.
        """
        reading_end, writing_end = os.pipe()
        words = ("-m", module, *arguments)
        environment = {**os.environ, **self.environment}
        try:
            process = fork_server().start(
                *words, output=writing_end, environment=environment
            )
        except OSError as error:
            os.close(reading_end)
            raise LaunchError(
                f"{name}: cannot be started ({error.strerror})"
            ) from error
        finally:
            os.close(writing_end)
        reader = threading.Thread(
            target=self._pass_on, args=(name, reading_end), daemon=True
        )
        reader.start()
        self._children[name] = process, reader

    @property
    def ended(self) -> Mapping[str, int]:
        """Exit codes of the children that have ended; negative: the signal that ended one."""
        codes = {name: process.poll() for name, (process, _) in self._children.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def forget(self, name: str) -> None:
        """Take a child that has ended as if it had not been started."""
        del self._children[name]

    def stop(self, order: Sequence[str] = ()) -> list[str]:
        """End all children: those in `order` first, then the others, the latest started first.

        Returns:
            The names of those that had to be killed.
        """
        in_order = [name for name in order if name in self._children]
        in_order += [name for name in reversed(self._children) if name not in order]
        killed = []
        for name in in_order:
            process, reader = self._children[name]
            # as good as SIGINT to our nodes, and quiet while they import
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(self.PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                killed.append(name)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(self.PATIENCE)
            reader.join(1.0)  # its last lines have then been shown
        return killed

    def wait_for_line(self, name: str, ready: threading.Event, seconds: float) -> None:
        """Wait until `ready` is set, which the reader of the child's output does.

        Raises:
            LaunchError: the child ended first, or the time has run out.
        """
        deadline = time.monotonic() + seconds
        while not ready.wait(0.05):
            if (code := self.ended.get(name)) is not None:
                raise LaunchError(
                    f"{name} ended with code {code} before it was ready; see its output above"
                )
            if time.monotonic() > deadline:
                raise LaunchError(
                    f"{name} was not ready after {seconds:g} s; see its output above"
                )

    def _pass_on(self, name: str, output: int) -> None:
        with open(output, errors="replace") as stream:
            for line in stream:
                self._show(f"[{name}] {line.rstrip()}")


class Page:
    """The page's process; without a port there is none. Losing it affects nothing else."""

    POLL: Final = 0.2
    """Interval at which the page is watched once everything else has ended, s."""

    def __init__(
        self,
        port: int | None,
        *,
        control: bool = False,
        config: Path | None = None,
        tell: str | None = None,
        show: Callable[[str], None] = print,
    ) -> None:
        """Serve on this local port; the page's output, with its address, goes to `show`.

        `config` is the parameter file of the twin's nodes; `tell` the broker that it publishes to.
        """
        self._port = port
        self._show = show
        self._options = ["--control"] if control else []
        self._options += ["--config", str(config)] if config is not None else []
        self._options += ["--tell", tell] if tell else []
        self._processes = Processes(show)

    def __enter__(self) -> Page:
        if self._port is not None:
            options = ["--port", str(self._port), *self._options]
            self._processes.start_module(
                "dashboard", "twinmatch.cli", "dashboard", *options
            )
        return self

    def __exit__(self, *_: object) -> None:
        self._processes.stop()

    def stay(self) -> None:
        """Keep the page open until Ctrl-C, so that the results can be inspected."""
        if self._port is None or self._processes.ended:
            return

        def stop(*_: object) -> None:
            raise KeyboardInterrupt

        for number in (signal.SIGINT, signal.SIGTERM):
            # the nodes' runner leaves them ignored
            signal.signal(number, stop)
        self._show("the page stays open until Ctrl-C")
        try:
            while not self._processes.ended:
                time.sleep(self.POLL)
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
    parser.add_argument("--tell", metavar="URL", help=TELL)
    if control:
        parser.add_argument(
            "--control",
            action="store_true",
            help="let the page change the set-point, clear faults and stop",
        )


def check_page_options(
    options: argparse.Namespace, parser: argparse.ArgumentParser
) -> None:
    """Exit with a usage error if the options of the page contradict."""
    control = bool(getattr(options, "control", False))
    if control and options.dashboard is None:
        parser.error("--control needs the page: give --dashboard too")
    if options.tell and options.dashboard is None:
        parser.error("--tell is done by the page: give --dashboard too")
    if options.dashboard is not None and not 0 <= options.dashboard <= 65535:
        parser.error(f"--dashboard is {options.dashboard}; give a port from 0 to 65535")


def page_of(
    options: argparse.Namespace,
    parser: argparse.ArgumentParser,
    config: Path | None = None,
) -> Page:
    """The page that the command line requests; exits with a usage error if the options contradict."""
    check_page_options(options, parser)
    control = bool(getattr(options, "control", False))
    fork_server()  # imports while this process does
    return Page(options.dashboard, control=control, config=config, tell=options.tell)


def refuse_existing(session: Path | None) -> None:
    """Refuse to record over an existing session.

    Raises:
        LaunchError: the folder exists already.
    """
    if session is not None and session.exists():
        raise LaunchError(
            f"{session} exists already; give another folder with --session"
        )
