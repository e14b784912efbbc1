"""Programs of other people beside the graph: how they are started, and what they are to hear."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.sessions import read_session, write_session

PROJECT = Path(__file__).resolve().parents[3]
HERE = Path(__file__).resolve().parent
PATIENCE = 60.0
"""Seconds after which a test gives up on something that should come within a few."""
LENGTH = 640
"""Samples of the session: enough for two nominal candidates."""


def domain() -> int:
    """The ROS domain of this worker, which nobody else on this machine has."""
    return int(os.environ["ROS_DOMAIN_ID"])


class Program:
    """A process whose output is kept."""

    def __init__(self, command: list[str], environment: Mapping[str, str], output: Path) -> None:
        self._output = output
        with output.open("w") as stream:
            self.process = subprocess.Popen(
                command, env=environment, cwd=output.parent, stdout=stream, stderr=subprocess.STDOUT
            )

    @property
    def text(self) -> str:
        return self._output.read_text(errors="replace")

    @property
    def json(self) -> list[Any]:
        """The lines that are JSON, as they came."""
        lines = (line for line in self.text.splitlines(keepends=True) if line[0] in "[{")
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def wait_for(self, condition: Callable[[str], object], patience: float = PATIENCE) -> None:
        """Wait for something in the output; the test fails if it does not come."""
        deadline = time.monotonic() + patience
        while not condition(self.text):
            assert self.process.poll() is None, f"ended with {self.process.returncode}: {self.text}"
            assert time.monotonic() < deadline, f"not within {patience} s: {self.text}"
            time.sleep(0.05)

    def wait(self, patience: float = PATIENCE) -> int:
        return self.process.wait(patience)

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal; the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
            self.process.send_signal(signal.SIGCONT)
        try:
            return self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


class Programs:
    """The processes of one test or of several, which end with it."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._folder = folder
        self._environment = environment
        self._started: list[Program] = []

    def start(self, *command: object, python: str = sys.executable, **variables: str) -> Program:
        """Start a Python program with a stranger's environment and these variables."""
        output = self._folder / f"{len(self._started)}.txt"
        environment = {**self._environment, **variables}
        self._started.append(Program([python, *map(str, command)], environment, output))
        return self._started[-1]

    def start_reader(self, *arguments: str, python: str = sys.executable, **variables: str) -> Program:
        """Start reader.py and wait until it has subscribed."""
        program = self.start(HERE / "reader.py", *arguments, python=python, **variables)
        program.wait_for(lambda text: "ready" in text)
        return program

    def end(self) -> None:
        for program in reversed(self._started):
            program.end()


@pytest.fixture(scope="session")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of somebody who has done nothing for twinmatch.

    Where ROS 2 was sourced and not installed with pip, what sourcing has set belongs to it.
    """
    kept = ["PATH", "LANG"]
    if not (Path(sys.prefix) / "share" / "rclpy").is_dir():
        kept += ["PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "ROS_DISTRO"]
    environment = {name: os.environ[name] for name in kept if name in os.environ}
    home = tmp_path_factory.mktemp("home")
    return {**environment, "HOME": str(home), "ROS_DOMAIN_ID": str(domain()), "OMP_NUM_THREADS": "1"}


@pytest.fixture
def programs(tmp_path: Path, stranger: dict[str, str]) -> Iterator[Programs]:
    """Programs that end with the test."""
    made = Programs(tmp_path, stranger)
    yield made
    made.end()


@pytest.fixture(scope="module")
def lasting_programs(
    tmp_path_factory: pytest.TempPathFactory, stranger: dict[str, str]
) -> Iterator[Programs]:
    """Programs that end with the module."""
    made = Programs(tmp_path_factory.mktemp("programs"), stranger)
    yield made
    made.end()


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The beginning of the sample session."""
    samples = read_session(PROJECT / "bags" / "four_setpoints").samples[:LENGTH]
    return write_session(tmp_path_factory.mktemp("sessions") / "beginning", samples)


@pytest.fixture(scope="session")
def project() -> Path:
    """The project's folder."""
    return PROJECT


@pytest.fixture(scope="session")
def bare_python() -> str:
    """A Python outside every environment."""
    found = getattr(sys, "_base_executable", None) or shutil.which("python3")
    assert found
    return found
