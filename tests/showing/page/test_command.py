"""The command line of the page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")
pytest.importorskip("bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'")

from tests.support.processes import Process
from twinmatch.cli.dashboard import add_arguments, run
from twinmatch.showing.serving import ServingError

pytestmark = pytest.mark.ros


def test_it_prints_its_address_and_stays_on_this_machine(page_process: Callable[..., Any]) -> None:
    page = page_process()
    assert page.url.startswith("http://127.0.0.1:")
    assert "PAGE OPEN" not in page.text


@pytest.mark.parametrize(
    ("options", "able"), [((), "read this page"), (("--control",), "read this page and command the plant")]
)
def test_an_open_page_says_so(page_process: Callable[..., Any], options: tuple[str, ...], able: str) -> None:
    page = page_process("--address", "0.0.0.0", *options)
    assert page.url
    assert f"PAGE OPEN: anyone who can reach 0.0.0.0 may {able};" in page.text


def test_an_address_of_another_machine_is_one_line(ros: None, tmp_path: Path) -> None:  # noqa: ARG001
    command = (sys.executable, "-m", "twinmatch.cli", "dashboard", "--address", "203.0.113.7")
    done = Process(*command, output=tmp_path / "said.txt", forked=True)
    assert done.wait() == 2, done.text
    assert "dashboard: 203.0.113.7:5006 cannot be used" in done.text
    assert len(done.lines) == 1


@pytest.mark.parametrize("name", ["bokeh", "rclpy"])
def test_what_is_not_installed_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not there
    with pytest.raises(ServingError, match=rf"{name} is not installed; pip install 'twinmatch\["):
        run(parser.parse_args([]))
