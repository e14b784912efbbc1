"""A command that starts a graph begins again as the process that its fork server is forked from."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")

from tests.support.processes import Process
from twinmatch.errors import EXIT_USER_ERROR
from twinmatch.launching import launcher
from twinmatch.launching.forking import fork_server

CONTINUING = """
import os
from twinmatch.launching.launcher import continue_as_launcher
print("process", os.getpid(), flush=True)
continue_as_launcher()
print("not reached")
"""


def test_a_command_continues_in_the_same_process(tmp_path: Path) -> None:
    """It begins once more, with its own words, exit code and folder; a second time it has its server already."""
    script = tmp_path / "continuing.py"
    script.write_text(CONTINUING)
    process = Process(
        sys.executable,
        script,
        "play",
        "nothing_here",
        output=tmp_path / "output",
        folder=tmp_path,
    )
    assert process.wait() == EXIT_USER_ERROR, process.text
    first, *later = process.lines
    assert first == f"process {process.id}"
    assert len(later) == 1
    assert later[0].startswith("twinmatch: nothing_here")


SHARING = """
import colorsys, json, sys
from twinmatch.launching.forking import fork_server
from twinmatch.launching.launcher import fork_server_from_here

fork_server_from_here()
forked = fork_server().start(*sys.argv[1:], output=1, environment={"A": "b"})
print(forked.wait(), fork_server().pid, flush=True)
"""
PROGRAM = """
import json, os, sys
has_memory = "colorsys" in sys.modules
print(json.dumps([sys.argv[1:], dict(os.environ), os.getppid(), os.getsid(0), has_memory, sys.stdin.read()]))
sys.exit(3)
"""


def test_programs_have_the_memory_of_the_launcher(tmp_path: Path) -> None:
    """And are its children, in sessions of their own, without its terminal; the server ends with it."""
    script = tmp_path / "sharing.py"
    script.write_text(SHARING)
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    process = Process(
        sys.executable, script, program, "word", output=tmp_path / "output"
    )
    assert process.wait() == 0, process.text
    told, result = process.lines
    words, environment, parent, session, has_memory, stdin = json.loads(told)
    assert (words, environment) == (["word"], {"A": "b"})
    assert parent == process.id
    assert session not in (os.getsid(0), process.id)
    assert has_memory
    assert stdin == ""
    code, server = map(int, result.split())
    assert code == 3
    assert not Path(f"/proc/{server}").exists()


def test_a_process_with_a_fork_server_does_not_begin_again() -> None:
    """Else it would never come to its work."""
    fork_server()
    launcher.continue_as_launcher()
