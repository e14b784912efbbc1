"""Both packages built by colcon: the messages by CMake, the nodes into lib/twinmatch, and they talk.

Debian's colcon and ament_cmake are used together with the ROS wheels (see wheels_shim.py).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.system.subscribers.keeping import key_of, locked
from tests.system.subscribers.wheels_shim import write_parser, write_shim
from twinmatch.sessions import read_session

pytestmark = [
    pytest.mark.ros,
    pytest.mark.long("builds a colcon workspace with all messages"),
]

HERE = Path(__file__).resolve().parent
IGNORED = shutil.ignore_patterns("__pycache__", "build", "*.egg-info", "twinmatch_msgs")
DEBIAN = Path("/usr/lib/python3/dist-packages/ament_package")


@pytest.fixture(scope="module")
def installed(project: Path, stranger: dict[str, str]) -> Path:
    """The install space of a workspace with both packages.

    The built messages are kept in build/ until they or what builds them change; nodes are built every time.
    """
    ament_cmake = Path("/usr/share/ament_cmake/cmake").is_dir()
    if shutil.which("colcon") is None or not DEBIAN.is_dir() or not ament_cmake:
        pytest.skip("no colcon with ament_cmake: sh .ci/debian_tools.sh workspace")
    if not (Path(sys.prefix) / "share" / "rosidl_generator_py").is_dir():
        pytest.skip("ROS 2 does not come from wheels here")
    messages = project / "src" / "twinmatch_msgs"
    folder = project / "build" / "workspace"
    stamp = folder / "complete"
    key = key_of(messages, HERE / "wheels_shim.py", Path(__file__))
    with locked(folder.with_suffix(".lock")):
        if not stamp.exists() or stamp.read_text() != key:
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(messages, folder / "twinmatch_msgs", ignore=IGNORED)
            build(folder, stranger, "twinmatch_msgs")
            stamp.write_text(key)
        for earlier in ("twinmatch", "build/twinmatch", "install/twinmatch"):
            shutil.rmtree(folder / earlier, ignore_errors=True)
        (folder / "twinmatch").mkdir()
        for name in (
            "setup.py",
            "setup.cfg",
            "pyproject.toml",
            "package.xml",
            "README.md",
        ):
            shutil.copy(project / name, folder / "twinmatch")
        for name in ("src", "config", "resource"):
            shutil.copytree(project / name, folder / "twinmatch" / name, ignore=IGNORED)
        build(folder, stranger, "twinmatch")
    return folder / "install"


def build(folder: Path, stranger: dict[str, str], package: str) -> None:
    """Build a package of the workspace."""
    if not (folder / "shim").exists():
        write_shim(folder / "shim")
        write_parser(folder / "python")
        (folder / "python" / "ament_package").symlink_to(DEBIAN)
    paths = (folder / "shim", sys.prefix, "/usr")
    cmake = [
        f"-DCMAKE_PREFIX_PATH={';'.join(map(str, paths))}",
        f"-DPython3_EXECUTABLE={sys.executable}",
        "-DBUILD_SHARED_LIBS=ON",
        "-DCMAKE_C_FLAGS=-O0",
        "-DCMAKE_CXX_FLAGS=-O0",
    ]
    environment = {
        **{
            name: value
            for name, value in stranger.items()
            if not name.startswith("ROS_")
        },
        "PATH": "/usr/bin:/bin",
        "AMENT_PREFIX_PATH": sys.prefix,
        "PYTHONPATH": str(folder / "python"),
    }
    # Graphs that run at real time beside it need the processors more.
    command = [
        "nice",
        "-n",
        "10",
        "colcon",
        "build",
        "--paths",
        package,
        "--cmake-args",
        *cmake,
    ]
    completed = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=1800,
    )
    assert completed.returncode == 0, completed.stdout + completed.stderr


def start(programs: Any, installed: Path, *command: object) -> Any:
    """Start a Python program after the install space was sourced, as ROS 2 people do."""
    words = " ".join(map(str, command))
    script = f". {installed}/setup.sh && exec {sys.executable} {words}"
    return programs.start("-c", script, python="sh", AMENT_PREFIX_PATH=sys.prefix)


def test_nodes_and_messages_of_the_install_space(
    programs: Any, installed: Path, session: Path
) -> None:
    where = start(
        programs,
        installed,
        "-c",
        "'import twinmatch, twinmatch_msgs as m; print(twinmatch, m)'",
    )
    assert where.wait() == 0, where.text
    assert where.text.count(str(installed)) == 2

    ours = start(
        programs,
        installed,
        HERE / "reader.py",
        "twinmatch_msgs/LoopSample",
        "plant/sample",
    )
    ours.said("^ready$")
    theirs = programs.start_reader("twinmatch_msgs/LoopSample", "plant/sample")
    player = installed / "twinmatch" / "lib" / "twinmatch" / "player"
    assert os.access(player, os.X_OK)
    options = (
        "--ros-args",
        "-p",
        f"session:={session}",
        "-p",
        "rate:=200.0",
        "-p",
        "wait_for:=2",
        "-p",
        "wait_timeout:=60.0",
    )
    played = start(programs, installed, player, *options)
    assert played.wait() == 0, played.text
    last = read_session(session).samples[-1]
    for reader in (ours, theirs):
        reader.said(f'"index": {last.index},')
        assert reader.json[-1]["output"] == [last.output]
