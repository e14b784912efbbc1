"""The command lines of the servers: the live page and Foxglove's."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)
pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)
pytest.importorskip(
    "foxglove", reason="foxglove-sdk is not installed; it is in the extra 'foxglove'"
)

from tests.support.processes import Process, Processes
from twinmatch.showing.serving import ServingError

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros")]


@pytest.mark.parametrize(
    ("words", "warning"),
    [
        (("dashboard",), "PAGE OPEN: anyone who can reach 0.0.0.0 may read this page;"),
        (
            ("dashboard", "--control"),
            "0.0.0.0 may read this page and command the plant;",
        ),
        (
            ("foxglove",),
            "FOXGLOVE OPEN: anyone who can reach 0.0.0.0 may read this graph;",
        ),
    ],
)
def test_an_open_server_says_so(
    tmp_path: Path, words: tuple[str, ...], warning: str
) -> None:
    processes = Processes(tmp_path / "servers")
    server = processes.python(
        "-m", "twinmatch.cli", *words, "--port", "0", "--address", "0.0.0.0"
    )
    assert server.url
    assert warning in server.text
    [(code, text)] = processes.end()
    assert Process.well(code), text
    assert "Traceback" not in text


@pytest.mark.parametrize(("command", "port"), [("dashboard", 5006), ("foxglove", 8765)])
def test_an_address_of_another_machine_is_one_line(
    tmp_path: Path, command: str, port: int
) -> None:
    words = (sys.executable, "-m", "twinmatch.cli", command, "--address", "203.0.113.7")
    process = Process(*words, output=tmp_path / "said.txt", forked=True)
    assert process.wait() == 2, process.text
    assert (
        f"{command}: 203.0.113.7:{port} cannot be used: Cannot assign" in process.text
    )
    assert len(process.lines) == 1


@pytest.mark.parametrize(
    ("command", "name"), [("dashboard", "bokeh"), ("foxglove", "foxglove")]
)
def test_what_is_not_installed_is_named_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, command: str, name: str
) -> None:
    module = import_module(f"twinmatch.cli.{command}")
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not there
    with pytest.raises(
        ServingError, match=rf"{name} is not installed; pip install 'twinmatch\["
    ):
        module.run(parser.parse_args([]))
