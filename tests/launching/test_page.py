"""The live page beside the launch scripts."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")
pytest.importorskip("bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'")

from twinmatch.launching.page import Page, add_page_options, page_of
from twinmatch.sessions import write_session
from twinmatch.signals import Sample

PROJECT = Path(__file__).resolve().parents[2]


def children() -> int:
    """Pages that this process started."""
    command = ["ps", "-o", "args=", "--ppid", str(os.getpid())]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return sum("-m twinmatch.cli dashboard --port 0 --control" in line for line in found.splitlines())


def test_it_is_there_within_and_gone_after(ros_domain: int) -> None:  # noqa: ARG001
    told: list[str] = []
    with Page(0, control=True, show=told.append):
        deadline = time.monotonic() + 40
        while not any(re.search(r"page: http://127.0.0.1:\d+/$", line) for line in told):
            assert time.monotonic() < deadline, told
            time.sleep(0.05)
        assert children() == 1
    assert children() == 0


def test_without_the_option_there_is_none() -> None:
    with Page(None) as page:
        page.stay()  # returns at once


def parsed(*words: str) -> Page:
    parser = argparse.ArgumentParser()
    add_page_options(parser, control=True)
    return page_of(parser.parse_args(words), parser)


@pytest.mark.parametrize(
    "words", [("--control",), ("--dashboard", "70000"), ("--dashboard", "-1"), ("--dashboard", "x")]
)
def test_options_that_make_no_sense_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as left:
        parsed(*words)
    assert left.value.code == 2


@pytest.mark.parametrize("script", ["live.py", "replay.py", "demo.py"])
def test_every_launch_script_has_it(script: str) -> None:
    command = [sys.executable, str(PROJECT / "launch_scripts" / script), "--help"]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert "--dashboard" in told
    assert ("--control" in told) == (script == "live.py")


def test_after_a_replay_it_stays_until_ctrl_c(ros_domain: int, tmp_path: Path) -> None:  # noqa: ARG001
    samples = [Sample(k, 10**18 + k * 10**9, 50.0, 49.0, 20.0) for k in range(30)]
    session, output = write_session(tmp_path / "short", samples), tmp_path / "output.txt"
    command = [sys.executable, str(PROJECT / "launch_scripts" / "replay.py"), str(session)]
    with output.open("w") as stream:
        process = subprocess.Popen(
            [*command, "--rate", "0", "--dashboard", "0"],
            stdout=stream,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "ROS_LOG_DIR": str(tmp_path)},
        )
    try:
        deadline = time.monotonic() + 90
        while "the page stays until Ctrl-C" not in output.read_text():
            assert process.poll() is None, output.read_text()
            assert time.monotonic() < deadline, output.read_text()
            time.sleep(0.1)
        found = re.search(r"page: (\S+)", output.read_text())
        assert found, output.read_text()
        with urllib.request.urlopen(found[1]) as answer:
            assert b"twinmatch" in answer.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0, output.read_text()
        with pytest.raises(OSError, match="refused"):
            urllib.request.urlopen(found[1])
    finally:
        process.kill()
        process.wait()
