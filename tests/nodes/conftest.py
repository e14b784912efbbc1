"""Nodes in the test's own process and in others, and a listener.

What measures the flow between processes, or computes verdicts while it receives, has processes of its own.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from tests.support.processes import Process, Processes, Start
from tests.support.ros import Inside, Listener, listening
from tests.support.steps import quarter_of_an_hour
from twinmatch.nodes import node
from twinmatch.nodes.runner import EXIT_DEFECT
from twinmatch.sessions import write_session
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin, TwinSettings


@pytest.fixture(scope="session", autouse=True)
def _environment(ros: None) -> None:
    """Every test here is in the domain of this worker."""


@pytest.fixture(scope="session", autouse=True)
def _reports() -> Iterator[None]:
    """Nodes in this process report five times a second, so that nobody waits for what they say."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(node, "PERIOD", 0.2)
        yield


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    """Processes that end with the test, none of them by a signal that nobody sent."""
    started = Processes(tmp_path / "output")
    yield started
    ended = started.end()
    assert all(code > 0 or Process.well(code) for code, _ in ended), ended


@pytest.fixture
def start() -> Iterator[Callable[..., Inside]]:
    """Start a program of nodes in this process: `start("matcher", "-p", "seed:=3")`."""
    programs: list[Inside] = []

    def start_inside(name: str, *ros_arguments: str) -> Inside:
        programs.append(Inside(name, *ros_arguments))
        return programs[-1]

    yield start_inside
    asked = [program for program in programs if program.asked]
    assert all(
        program.end() != EXIT_DEFECT or program in asked
        for program in reversed(programs)
    ), [m.text for m in programs]


@pytest.fixture
def start_process(processes: Processes) -> Start:
    """The same in a process of its own, which can be sent signals."""

    def start_node(name: str, *ros_arguments: str) -> Process:
        words = ["--ros-args", *ros_arguments] if ros_arguments else []
        return processes.python("-m", "twinmatch.nodes", name, *words)

    return start_node


@pytest.fixture
def start_script(tmp_path: Path) -> Iterator[Start]:
    """Start a Python program given as text; what nodes need is imported already, unless it is `cold`."""
    started = Processes(tmp_path / "scripts")
    script = tmp_path / "program.py"

    def begin(
        text: str, *, cold: bool = False, environment: Mapping[str, str] | None = None
    ) -> Process:
        script.write_text(text)
        return started.start(
            sys.executable, script, forked=not cold, environment=environment
        )

    yield begin
    started.end()


@pytest.fixture
def listener() -> Iterator[Listener]:
    with listening() as opened:
        yield opened


@pytest.fixture(scope="session")
def steps() -> list[Sample]:
    """The steps of a simulated rig, until shortly after its second match."""
    return quarter_of_an_hour()[:680]


@pytest.fixture(scope="session")
def offline(steps: list[Sample]) -> list[Outcome]:
    """What the core makes of them."""
    twin = Twin(TwinSettings())
    return [twin.push(sample) for sample in steps]


@pytest.fixture(scope="session")
def session(steps: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Those samples as a session."""
    return write_session(tmp_path_factory.mktemp("sessions") / "steps", steps)
