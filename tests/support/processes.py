"""Programs in processes of their own."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, TypeVar

from tests.support.places import LAUNCH_SCRIPTS
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.cli import main
from twinmatch.launching.forking import Forked, fork_server
from twinmatch.plants import files

T = TypeVar("T")


OUR_SCRIPTS = frozenset(LAUNCH_SCRIPTS.glob("*.py"))
LAUNCHING_COMMANDS = frozenset(("attach", "demo", "live", "play"))
VERDICT_LINE = r"^ *[\d.]+ +(unknown|doubtful|trusted|fault)"
"""How a line begins in which a command shows a verdict: its time, and its level."""
LAUNCHED = Path(__file__).with_name("launched.py")


def launches_others(words: Sequence[str]) -> bool:
    """Whether a program, `-m` and a module or a script with its arguments, starts a graph."""
    if words[:2] == ["-m", "twinmatch.cli"]:
        return bool(LAUNCHING_COMMANDS.intersection(words[2:3]))
    return (Path.cwd() / words[0]) in OUR_SCRIPTS


class Process:
    """A program whose output, errors included, is kept in a file."""

    def __init__(
        self,
        *command: object,
        output: Path,
        environment: Mapping[str, str] | None = None,
        folder: Path | None = None,
        forked: bool = False,
    ) -> None:
        """Start it; `environment` is the whole one, this process's by default, `folder` where it works.

        A module or script after `sys.executable` may be `forked`, as the launch scripts do it: most of a
        start is imports.
        """
        self.output = output
        variables = (
            {**os.environ, "PYTHONUNBUFFERED": "1"}
            if environment is None
            else environment
        )
        self.killed = False
        """Whether the test has killed it, so that its exit code says nothing."""
        words = [str(word) for word in command]
        self._process: Forked | subprocess.Popen[bytes]
        with output.open("w") as stream:
            if forked:
                launcher = [str(LAUNCHED)] if launches_others(words[1:]) else []
                self._process = fork_server().start(
                    *launcher,
                    *words[1:],
                    output=stream.fileno(),
                    environment=variables,
                    folder=folder,
                )
                return
            self._process = subprocess.Popen(
                words,
                env=variables,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
            )

    @property
    def id(self) -> int:
        return self._process.pid

    @property
    def text(self) -> str:
        """Everything it has said so far."""
        return self.output.read_text(errors="replace")

    @property
    def lines(self) -> list[str]:
        return self.text.splitlines()

    @property
    def json(self) -> list[Any]:
        """The whole lines that are JSON, as they came."""
        lines = (
            line for line in self.text.splitlines(keepends=True) if line[0] in "[{"
        )
        return [json.loads(line) for line in lines if line.endswith("\n")]

    @property
    def url(self) -> str:
        """The address that a server prints when it can be reached, as this machine reaches it."""
        return self.said(r"^\w+: ((?:http|ws)://\S+)$")[1].replace(
            "0.0.0.0", "127.0.0.1"
        )

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    @property
    def children(self) -> list[int]:
        """Process ids of what it has started."""
        return self.children_of(self.id)

    @staticmethod
    def children_of(process: int) -> list[int]:
        """Process ids of what a process has started."""
        children: list[int] = []
        for thread in Path(f"/proc/{process}/task").glob("*/children"):
            # A thread that ends in this moment has none left.
            with suppress(FileNotFoundError, ProcessLookupError):
                children += map(int, thread.read_text().split())
        return children

    def wait_until(
        self, condition: Callable[[], T], what: str, patience: float = PATIENCE
    ) -> T:
        """Wait for something that comes while it runs; the test fails at once if it has ended before."""

        def look() -> T | None:
            running = self.running
            outcome = condition()
            assert outcome or running, (
                f"ended with {self._process.returncode} before {what}:\n{self.text}"
            )
            return outcome

        return wait_for(look, lambda: f"{what}:\n{self.text}", patience=patience)  # type: ignore[return-value]

    def said(self, pattern: str, patience: float = PATIENCE) -> re.Match[str]:
        """Wait for a whole line in which the pattern is found."""

        def look() -> re.Match[str] | None:
            whole = (
                line
                for line in self.text.splitlines(keepends=True)
                if line.endswith("\n")
            )
            return next(
                (
                    matched
                    for line in whole
                    if (matched := re.search(pattern, line.rstrip("\n")))
                ),
                None,
            )

        line_match = self.wait_until(look, f"a line with {pattern!r}", patience)
        assert line_match is not None
        return line_match

    def wait(self, patience: float = PATIENCE) -> int:
        """Its exit code, once it has ended by itself."""
        try:
            return self._process.wait(patience)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f"still running after {patience:g} s:\n{self.text}"
            ) from None

    def send(self, number: signal.Signals) -> None:
        """Send a signal if it still runs."""
        if self.running:
            self._process.send_signal(number)

    def freeze(self) -> None:
        self.send(signal.SIGSTOP)

    def thaw(self) -> None:
        self.send(signal.SIGCONT)

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal and return the exit code; one that does not end is killed, and the test fails."""
        self.send(number)
        return self.finish()

    def finish(self) -> int:
        """Wait for the end that it was asked for."""
        self.thaw()
        try:
            return self.wait()
        finally:
            self._process.kill()
            self._process.wait()

    @staticmethod
    def well(code: int) -> bool:
        """Whether a node has ended as it should.

        By itself, or by the alarm with which its runner ends a Fast DDS that live-locks while it closes: one
        process in some hundreds, and all work is done by then.
        """
        return code in (0, -signal.SIGALRM)

    def kill(self) -> None:
        """Kill it."""
        self.killed = True
        self._process.kill()
        self._process.wait()


def kill_once_it_says(word: str, program: str, folder: Path) -> None:
    """Run a Python program, which is given a folder, and kill it when it has printed a line with a word."""
    script = folder.with_suffix(".py")
    script.write_text(textwrap.dedent(program))
    process = Process(
        sys.executable, script, folder, output=folder.with_suffix(".txt"), forked=True
    )
    try:
        process.said(word)
    finally:
        process.kill()


Start = Callable[..., Process]
"""Starts a node's program with ROS arguments, or a script."""


class Processes:
    """The processes of a fixture, which end with it."""

    def __init__(
        self, folder: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._environment = environment
        self._started: list[Process] = []

    def start(
        self,
        *command: object,
        environment: Mapping[str, str] | None = None,
        **settings: Any,
    ) -> Process:
        """Start a program; what it is given by name replaces what all have."""
        output = self._folder / f"{len(self._started)}.txt"
        variables = self._environment if environment is None else environment
        self._started.append(
            Process(*command, output=output, environment=variables, **settings)
        )
        return self._started[-1]

    def python(self, *words: object, **settings: Any) -> Process:
        """Start a Python program: `python("-m", "twinmatch.cli", "--version")`; our own are forked."""
        ours = (
            str(words[1]).startswith("twinmatch.")
            if words[0] == "-m"
            else words[0] in OUR_SCRIPTS
        )
        return self.start(sys.executable, *words, forked=ours, **settings)

    def end(self, number: signal.Signals = signal.SIGTERM) -> list[tuple[int, str]]:
        """End what still runs, all at once; exit code and words of each that was not killed."""
        for process in reversed(self._started):
            process.send(number)
        ended = [(process, process.finish()) for process in self._started]
        return [(code, process.text) for process, code in ended if not process.killed]

    def dismiss(self, patience: float = 15.0) -> None:
        """End what still runs and kill what does not end: for other people's programs, not under test."""
        for process in reversed(self._started):
            process.send(signal.SIGTERM)
            process.thaw()
        with suppress(AssertionError):
            for process in self._started:
                process.wait(patience)
        for process in self._started:
            process.kill()


@contextmanager
def no_plant_files() -> Iterator[None]:
    """Forget the plant files that this process has loaded, and know them again afterwards."""
    tables: list[dict[Any, Any]] = list(files.LOADED)
    copies = [dict(table) for table in tables]
    modules = {
        name: module
        for name, module in sys.modules.items()
        if name.startswith(files.MODULE_PREFIX)
    }
    for table in tables:
        table.clear()
    try:
        yield
    finally:
        for table, copied_table in zip(tables, copies, strict=True):
            table.clear()
            table.update(copied_table)
        sys.modules.update(modules)


def run_twinmatch(
    *arguments: object, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in this process, in a folder: what it prints, and its exit code.

    Like a new process, it knows no plant file that another command has loaded.
    """
    words = [str(word) for word in arguments]
    out = io.StringIO()
    err = io.StringIO()
    before = Path.cwd()
    os.chdir(folder or before)
    try:
        with no_plant_files(), redirect_stdout(out), redirect_stderr(err):
            code = main(words)
    except SystemExit as ended:  # argparse
        code = ended.code if isinstance(ended.code, int) else 1
    finally:
        os.chdir(before)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())
