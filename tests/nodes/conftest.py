"""Nodes as processes, and a listener in the test's own process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from twinmatch.nodes import network
from twinmatch.plant import Camera, RigParameters, simulate_closed_loop
from twinmatch.sessions import samples_of, write_session
from twinmatch.signals import Sample, Window

PATIENCE = 30.0
"""Seconds after which a test gives up on something that should come within one."""


class Process:
    """A node in a process of its own."""

    def __init__(self, command: list[str], folder: Path) -> None:
        self.output = folder / f"{len(list(folder.iterdir()))}.txt"
        with self.output.open("w") as stream:
            self._process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)

    @property
    def id(self) -> int:
        return self._process.pid

    @property
    def text(self) -> str:
        return self.output.read_text()

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def wait_for_text(self, text: str, patience: float = PATIENCE) -> None:
        """Wait until the process has written something; the test fails if it does not."""
        deadline = time.monotonic() + patience
        while text not in self.text:
            assert time.monotonic() < deadline, f"{text!r} did not come within {patience} s: {self.text}"
            time.sleep(0.02)

    def wait(self, patience: float = PATIENCE) -> int:
        return self._process.wait(patience)

    def ask_to_end(self, number: signal.Signals = signal.SIGTERM) -> None:
        if self.running:
            self._process.send_signal(number)

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal and return the exit code."""
        self.ask_to_end(number)
        try:
            return self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise

    def shared_memory(self) -> set[str]:
        """Names of the files of Fast DDS in /dev/shm that belong to this process alone."""
        names = set()
        for line in Path(f"/proc/{self.id}/maps").read_text().splitlines():
            name = line.split()[-1]
            if name.startswith("/dev/shm/fastdds_") and "_port" not in name:
                names.add(name)
        return names


@pytest.fixture(scope="session", autouse=True)
def ros(ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> None:  # noqa: ARG001
    """The environment of all ROS in this process and its children, in the domain of this worker."""
    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros_log"))
    os.environ.pop(network.VARIABLE, None)
    network.prepare()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Start a node: `start("matcher", "-p", "seed:=3")`; its process ends with the test."""
    processes: list[Process] = []
    folder = tmp_path / "output"
    folder.mkdir()

    def start_node(name: str, *ros_arguments: str) -> Process:
        command = [sys.executable, "-m", f"twinmatch.nodes.{name}"]
        if ros_arguments:
            command += ["--ros-args", *ros_arguments]
        processes.append(Process(command, folder))
        return processes[-1]

    yield start_node
    for process in processes:
        process.ask_to_end()
    codes = [(process.end(), process.text) for process in processes]
    assert all(code >= 0 for code, _ in codes), codes


@pytest.fixture
def start_script(tmp_path: Path) -> Iterator[Callable[[str], Process]]:
    """Start a Python program given as text."""
    processes: list[Process] = []
    folder = tmp_path / "scripts"
    folder.mkdir()

    def start_text(text: str) -> Process:
        processes.append(Process([sys.executable, "-c", text], folder))
        return processes[-1]

    yield start_text
    for process in processes:
        process.end()


class Listener:
    """A node in this process that keeps what it hears."""

    def __init__(self, context: Context) -> None:
        self.node = Node("listener", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def hear(self, kind: Any, topic: str, qos: Any) -> list[Any]:
        """The messages of a topic, growing as they come."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def spin_until(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < deadline, f"{what} did not come within {patience} s"
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def listener() -> Iterator[Listener]:
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    made = Listener(context)
    yield made
    made.close()
    rclpy.try_shutdown(context=context)


@pytest.fixture(scope="session")
def steps() -> list[Sample]:
    """A quarter of an hour of a simulated rig: one set-point step that shows nothing, two that do."""
    reference = np.repeat([25.0, 40.0, 60.0, 45.0], [60, 300, 300, 260])
    parameters = RigParameters(seebeck=0.08, conductance=0.4, heat_capacity=30.0)
    camera = Camera().realise(reference.size, 1.0, 7)
    response = simulate_closed_loop(parameters, reference, plate=296.0, camera=camera)
    return samples_of(Window(reference=reference, output=response.output, input=response.input))


@pytest.fixture(scope="session")
def session(steps: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Those samples as a session."""
    return write_session(tmp_path_factory.mktemp("sessions") / "steps", steps)
