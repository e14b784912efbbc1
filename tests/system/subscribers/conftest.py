"""Programs of other people beside the graph: how they are started, and what they are to receive."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from tests.support.places import PROJECT
from tests.support.processes import Process, Processes
from twinmatch.kept import cache_folder
from twinmatch.sessions import read_session, write_session

HERE = Path(__file__).resolve().parent
LENGTH = 640
"""Samples of the session: enough for two nominal candidates."""
WHEELS = {
    n: os.environ[n]
    for n in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    if n in os.environ
}
"""Where the libraries of wheels are found by a process that was forked."""


def domain() -> int:
    """The ROS domain of this worker, which nobody else on this machine has."""
    return int(os.environ["ROS_DOMAIN_ID"])


class Programs:
    """The processes of one test or of several, which end with it; each in a stranger's environment."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._folder = folder
        self._environment = environment
        self._processes = Processes(folder / "output")

    def start(
        self, *command: object, python: str = sys.executable, **variables: str
    ) -> Process:
        """Start a Python program with a stranger's environment and these variables."""
        environment = {**self._environment, **variables}
        return self._processes.start(
            python, *command, environment=environment, folder=self._folder
        )

    def start_ours(self, *command: object, **variables: str) -> Process:
        """Start a program of twinmatch beside them, with these variables: its start is not what is tested."""
        environment = {**self._environment, **WHEELS, **variables}
        return self._processes.python(
            *command, environment=environment, folder=self._folder
        )

    def start_reader(
        self, *arguments: str, python: str = sys.executable, **variables: str
    ) -> Process:
        """Start reader.py and wait until it has subscribed."""
        program = self.start(HERE / "reader.py", *arguments, python=python, **variables)
        program.said("^ready$")
        return program

    def end(self) -> None:
        self._processes.dismiss()


@pytest.fixture(scope="session")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of somebody who has done nothing for twinmatch.

    Where ROS 2 was sourced and not installed with pip, what sourcing has set belongs to it. Our own nodes
    find the equations that were prepared here: deriving them again takes a minute.
    """
    inherited_names = ["PATH", "LANG"]
    if not (Path(sys.prefix) / "share" / "rclpy").is_dir():
        inherited_names += [
            "PYTHONPATH",
            "LD_LIBRARY_PATH",
            "AMENT_PREFIX_PATH",
            "ROS_DISTRO",
        ]
    environment = {
        name: os.environ[name] for name in inherited_names if name in os.environ
    }
    home = tmp_path_factory.mktemp("home")
    prepared = {"TWINMATCH_CACHE": str(cache_folder()), "OMP_NUM_THREADS": "1"}
    return {
        **environment,
        **prepared,
        "HOME": str(home),
        "ROS_DOMAIN_ID": str(domain()),
    }


@pytest.fixture
def programs(tmp_path: Path, stranger: dict[str, str]) -> Iterator[Programs]:
    """Programs that end with the test."""
    started = Programs(tmp_path, stranger)
    yield started
    started.end()


@pytest.fixture(scope="module")
def lasting_programs(
    tmp_path_factory: pytest.TempPathFactory, stranger: dict[str, str]
) -> Iterator[Programs]:
    """Programs that end with the module."""
    started = Programs(tmp_path_factory.mktemp("programs"), stranger)
    yield started
    started.end()


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
    interpreter = getattr(sys, "_base_executable", None) or shutil.which("python3")
    assert interpreter
    return interpreter
