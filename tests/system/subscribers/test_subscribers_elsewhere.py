"""A subscriber in a virtual environment of its own: ROS from its wheels, our messages, nothing else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.system.subscribers.keeping import depends_on, key_of, locked
from twinmatch.sessions import read_session, write_session

pytestmark = [
    pytest.mark.ros,
    pytest.mark.long("installs another environment and builds the messages in it"),
]

NO_NETWORK = (
    "NewConnectionError",
    "Temporary failure in name resolution",
    "Network is unreachable",
)
OPTIONS = (
    "--quiet",
    "--disable-pip-version-check",
    "--prefer-binary",
    "--progress-bar",
    "off",
)


def run(command: list[str], environment: dict[str, str]) -> None:
    """Run a step of the preparation; the test fails with the step's own words, or skips without a network."""
    completed = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False
    )
    if completed.returncode != 0 and any(
        words in completed.stderr for words in NO_NETWORK
    ):
        pytest.skip("no network to install the ROS wheels from")
    assert completed.returncode == 0, completed.stderr


def wheel_of(
    sources: Path, built: Path, folder: Path, environment: dict[str, str]
) -> Path:
    """The messages as a wheel: that of `make setup`, or one built from a copy if they have changed since."""
    newest = max(path.stat().st_mtime for path in depends_on(sources))
    for wheel in built.glob(
        f"twinmatch_msgs-*-cp{sys.version_info[0]}{sys.version_info[1]}-*.whl"
    ):
        if wheel.stat().st_mtime > newest:
            return wheel
    copy = folder / "sources"
    shutil.copytree(sources, copy, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    options = [
        *OPTIONS,
        "--no-build-isolation",
        "--no-deps",
        "--wheel-dir",
        str(folder),
    ]
    run([sys.executable, "-m", "pip", "wheel", *options, str(copy)], environment)
    (wheel,) = folder.glob("twinmatch_msgs-*.whl")
    return wheel


@pytest.fixture(scope="module")
def other_python(
    project: Path,
    bare_python: str,
    stranger: dict[str, str],
    tmp_path_factory: pytest.TempPathFactory,
) -> str:
    """The interpreter of that environment, which is kept in build/ until the messages change."""
    if not (Path(sys.prefix) / "share" / "rclpy").is_dir():
        pytest.skip("ROS 2 does not come from wheels here")
    sources = project / "src" / "twinmatch_msgs"
    folder = project / "build" / "subscriber_venv"
    key = key_of(sources)
    stamp = folder / "complete"
    python = folder / "bin" / "python"
    # pip keeps what it has downloaded in the caller's home, not in the stranger's empty one.
    environment = {**stranger, "HOME": os.environ.get("HOME", stranger["HOME"])}
    with locked(project / "build" / "subscriber_venv.lock"):
        if not stamp.exists() or stamp.read_text() != key:
            shutil.rmtree(folder, ignore_errors=True)
            folders = project / "build" / "messages", tmp_path_factory.mktemp("wheel")
            wheel = wheel_of(sources, *folders, environment)
            run([bare_python, "-m", "venv", str(folder)], environment)
            install = ["sh", str(project / ".ci" / "install.sh"), str(python)]
            run([*install, str(wheel), "ros-jazzy-rclpy>=7.1,<8"], environment)
            stamp.write_text(key)
    return str(python)


def test_no_twinmatch_over_there(other_python: str, stranger: dict[str, str]) -> None:
    code = "import importlib.util, twinmatch_msgs.msg; print(importlib.util.find_spec('twinmatch'))"
    completed = subprocess.run(
        [other_python, "-c", code],
        env=stranger,
        capture_output=True,
        text=True,
        check=True,
    )
    assert completed.stdout == "None\n"


def test_environment_of_a_running_node_has_to_be_stripped(
    other_python: str, stranger: dict[str, str]
) -> None:
    """What the wheels of one environment set for its Python makes that of another fail to find its own."""
    inherited = {
        **stranger,
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
        "LD_LIBRARY_PATH": "",
    }
    command = [other_python, "-c", "import rclpy; rclpy.init()"]
    completed = subprocess.run(
        command, env=inherited, capture_output=True, text=True, check=False
    )
    assert completed.returncode != 0
    assert "cannot open shared object file" in completed.stderr


def test_it_reads_the_verdicts(
    programs: Any, other_python: str, session: Path, project: Path, tmp_path: Path
) -> None:
    verdicts = programs.start_reader(
        "twinmatch_msgs/ModelScore", "twin/model_score", python=other_python
    )
    samples = programs.start_reader(
        "twinmatch_msgs/LoopSample", "plant/sample", python=other_python
    )
    part = read_session(session).samples[:460]
    replay = programs.start_ours(
        project / "launch_scripts" / "replay.py",
        write_session(tmp_path / "part", part),
        "--rate",
        80,
    )
    assert replay.wait() == 0, replay.text
    last = part[-1]
    samples.said(f'"index": {last.index},')
    assert samples.json[-1]["output"] == [last.output]
    assert verdicts.json[-1]["nominal"]
    parameters = verdicts.json[-1]["candidates"][-1]["parameters"]
    assert (
        dict(zip(parameters["names"], parameters["values"], strict=True))[
            "heat_capacity"
        ]
        > 0
    )
    for reader in (verdicts, samples):
        assert reader.end() == 0
        assert reader.text.splitlines()[-1] == "imported []"
