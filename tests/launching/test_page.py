"""The live page beside the launch scripts."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")
pytest.importorskip("bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'")

from tests.support.places import LAUNCH_SCRIPTS
from tests.support.processes import Process
from tests.support.waiting import wait_for
from twinmatch.launching.processes import Page, add_page_options, page_of
from twinmatch.sessions import write_session
from twinmatch.signals import Sample


def children() -> int:
    """Pages that this process started."""
    command = ["ps", "-ww", "-o", "args=", "--ppid", str(os.getpid())]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return sum("-m twinmatch.cli dashboard --port 0 --control" in line for line in found.splitlines())


def test_it_is_there_within_and_gone_after(ros_domain: int) -> None:  # noqa: ARG001
    told: list[str] = []
    with Page(0, control=True, show=told.append):
        page = re.compile(r"page: http://127.0.0.1:\d+/$")
        wait_for(lambda: any(page.search(line) for line in told), "the page's address")
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
def test_options_that_contradict_each_other_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as left:
        parsed(*words)
    assert left.value.code == 2


@pytest.mark.parametrize("script", ["live.py", "replay.py", "demo.py"])
def test_every_launch_script_has_it(script: str) -> None:
    command = [sys.executable, LAUNCH_SCRIPTS / script, "--help"]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=360).stdout
    assert "--dashboard" in told
    assert ("--control" in told) == (script == "live.py")


def test_after_a_replay_it_stays_until_ctrl_c(ros_domain: int, tmp_path: Path) -> None:  # noqa: ARG001
    samples = [Sample(k, 10**18 + k * 10**9, 50.0, 49.0, 20.0) for k in range(30)]
    session = write_session(tmp_path / "short", samples)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "ROS_LOG_DIR": str(tmp_path)}
    command = [sys.executable, LAUNCH_SCRIPTS / "replay.py", session, "--rate", "0", "--dashboard", "0"]
    replay = Process(*command, output=tmp_path / "output.txt", environment=environment)
    try:
        replay.said("the page stays open until Ctrl-C")
        address = replay.said(r"page: (\S+)")[1]
        with urllib.request.urlopen(address) as answer:
            assert b"twinmatch" in answer.read()
        assert replay.end(signal.SIGINT) == 0, replay.text
        with pytest.raises(OSError, match="refused"):
            urllib.request.urlopen(address)
    finally:
        replay.kill()
