"""Child processes: started, watched, ended in a safe order, never left behind.

Each child gets its own process group, so that Ctrl-C reaches only the parent, which then ends the children
in the safe order. If the parent is killed (kill -9), the kernel sends each child SIGTERM. The live page is
such a child too: it starts and ends with the script and cannot make it fail.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO

from twinmatch.errors import TwinmatchError

PORT = 5006
"""Usual port of the live page."""
POLL = 0.2
"""Interval at which the page is watched once everything else has ended, s."""

PATIENCE = 12.0
"""Time between SIGTERM and SIGKILL, s."""

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


class LaunchError(TwinmatchError):
    """A process could not be started, or ended when it should not have."""


class Child:
    """One child process; each line of its output is shown with its name as prefix."""

    def __init__(
        self, name: str, command: Sequence[str], show: Callable[[str], None], environment: Mapping[str, str]
    ) -> None:
        """Start it; `environment` is added to ours.

        Raises:
            LaunchError: the program cannot be started.
        """
        self.name = name
        parent = os.getpid()

        def follow_parent() -> None:
            if _LIBC is not None:
                _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
            if os.getppid() != parent:  # the parent died before the line above
                os._exit(1)

        try:
            self.process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                # Unbuffered, so that lines arrive when they are written.
                env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
                start_new_session=True,
                preexec_fn=follow_parent,  # noqa: PLW1509 — one prctl, nothing that takes a lock
            )
        except OSError as error:
            msg = f"{name}: {command[0]} cannot be started ({error.strerror})"
            raise LaunchError(msg) from error
        self._reader = threading.Thread(target=self._pass_on, args=(show,), daemon=True)
        self._reader.start()

    @property
    def code(self) -> int | None:
        """Exit code once it has ended; negative: the signal that ended it."""
        return self.process.poll()

    def ask(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.code is None:
            self.process.send_signal(number)

    def wait(self, seconds: float) -> bool:
        """Whether it ended within the time; its last lines have then been shown."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        self._reader.join(1.0)
        return True

    def _pass_on(self, show: Callable[[str], None]) -> None:
        stream: IO[str] | None = self.process.stdout
        for line in stream or ():
            show(f"[{self.name}] {line.rstrip()}")
        if stream is not None:
            stream.close()


class Processes:
    """The children of one launch script."""

    def __init__(self, show: Callable[[str], None] = print) -> None:
        """Start without children; their output goes to `show`, line by line."""
        self._show = show
        self.environment: dict[str, str] = {}
        """Variables for the children that are started from now on."""
        self._children: dict[str, Child] = {}

    def start(self, name: str, command: Sequence[str]) -> Child:
        """Start a child under a name; raises as `Child`."""
        child = Child(name, command, self._show, self.environment)
        self._children[name] = child
        return child

    def start_module(self, name: str, module: str, *arguments: str) -> Child:
        """Start `python -m module arguments` with this interpreter."""
        return self.start(name, [sys.executable, "-m", module, *arguments])

    def __getitem__(self, name: str) -> Child:
        """The child of that name."""
        return self._children[name]

    @property
    def ended(self) -> Mapping[str, int]:
        """Exit codes of the children that have ended."""
        codes = {name: child.code for name, child in self._children.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def stop(self, order: Sequence[str] = (), patience: float = PATIENCE) -> list[str]:
        """End all children: those in `order` first, then the others, the latest started first.

        Returns:
            The names of those that had to be killed.
        """
        rest = [name for name in reversed(self._children) if name not in order]
        killed = []
        for name in [*(n for n in order if n in self._children), *rest]:
            child = self._children[name]
            child.ask(signal.SIGTERM)  # as good as SIGINT to our nodes, and quiet while they import
            if child.wait(patience):
                continue
            child.ask(signal.SIGKILL)
            child.wait(patience)
            killed.append(name)
        return killed

    def wait_for_line(self, name: str, ready: threading.Event, seconds: float) -> None:
        """Wait until `ready` is set, which the reader of the child's output does.

        Raises:
            LaunchError: the child ended first, or the time has run out.
        """
        deadline = time.monotonic() + seconds
        while not ready.wait(0.05):
            if self[name].code is not None:
                msg = f"{name} ended with code {self[name].code} before it was ready; see its output above"
                raise LaunchError(msg)
            if time.monotonic() > deadline:
                msg = f"{name} was not ready after {seconds:g} s; see its output above"
                raise LaunchError(msg)


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

    def __exit__(self, *_: object) -> None:
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
