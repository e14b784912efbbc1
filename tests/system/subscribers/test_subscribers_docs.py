"""What docs/subscribing.md tells people to write works as it stands there."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from twinmatch.nodes import network
from twinmatch.sessions import read_session, write_session

pytestmark = pytest.mark.ros

PAGE = Path(__file__).resolve().parents[3] / "docs" / "subscribing.md"
KEPT_IN = {
    **{name: str(profile) for name, profile in network.PROFILES.items()},
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
}
"""The page's other table."""
LIVE = (
    "/thermal/",
    *(f"/plant/{name}" for name in ("pwm", "uniformity", "reading", "command", "applied")),
)
"""Topics that only a live rig has."""
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| `([/\w]+)` \| `(\w+)/(\w+)` \|([^|]*)\|([^|]*)\|[^|]*\|$", re.MULTILINE)


def blocks(kind: str) -> list[str]:
    return [text for language, text in BLOCK.findall(PAGE.read_text()) if language == kind]


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A folder with the page's programs, under the names in their first lines."""
    folder = tmp_path / "page"
    folder.mkdir()
    for text in blocks("python"):
        (folder / text.split()[1]).write_text(text)
    return folder


def start_shell(programs: Any, page: Path, text: str, more: str = "", **variables: str) -> Any:
    """Run a block of the page in its folder, with this interpreter as `python`."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    # exec: a signal has to reach the program and not the shell around it
    script = re.sub(r"^python (?!-m)", "exec python ", text, flags=re.MULTILINE) + more
    return programs.start("-c", f"cd {page}\n{script}", python="bash", PATH=path, **variables)


def start_player(programs: Any, session: Path, *more: str, rate: float = 80.0, **variables: str) -> Any:
    options = ("-p", f"session:={session}", "-p", f"rate:={rate}", "-p", "wait_timeout:=60.0", *more)
    return programs.start_ours("-m", "twinmatch.nodes", "player", "--ros-args", *options, **variables)


def start_twin(programs: Any, *more: str) -> Any:
    return programs.start_ours("-m", "twinmatch.nodes", "twin", *(["--ros-args", *more] if more else []))


WAITING = """import rclpy, sys, time
rclpy.init()
node = rclpy.create_node("waiting")
while not node.count_subscribers(sys.argv[1]):
    time.sleep(0.1)
"""


def wait_for_reader(programs: Any, topic: str) -> None:
    """Until a program reads a topic; by one of its own, as ROS in this process is not for this network."""
    assert programs.start("-c", WAITING, topic).wait() == 0


def test_page_has_the_blocks_that_are_run_here() -> None:
    names = ["verdicts.py", "nominal.py", "forecasts.py", "what_if.py", "temperatures.py"]
    assert [text.split()[1] for text in blocks("python")] == names
    assert len(blocks("sh")) == 3
    assert len(blocks("python")[0].splitlines()) <= 20


def test_verdicts_nominal_forecasts_and_what_if(programs: Any, page: Path, session: Path) -> None:
    """A question is asked before there is a candidate, and when the recording has been played."""
    twin = start_twin(programs)
    early = programs.start(page / "what_if.py", **KEPT_IN)
    verdicts = start_shell(programs, page, blocks("sh")[0])
    forecasts = programs.start(page / "forecasts.py", **KEPT_IN)
    early.said("^forecast: there is no candidate yet; the first comes with the first match")
    for topic in ("twin/model_score", "twin/forecast"):
        wait_for_reader(programs, topic)
    player = start_player(programs, session, "-p", "wait_for:=2")
    assert player.wait() == 0, player.text
    verdicts.said("sample 600: trusted, 70 °C")
    assert network.sockets_elsewhere(verdicts.id) == []
    last = read_session(session).samples[-1].index
    forecasts.said(rf"^sample {last}: -?\d+\.\d °C in a minute \(-?\d+\.\d to -?\d+\.\d\)$")
    nominal, late = programs.start(page / "nominal.py"), programs.start(page / "what_if.py", **KEPT_IN)
    nominal.said(r"^70 °C: α \d+\.\d mV/K, C \d+\.\d J/K$")
    late.said(rf", from sample {last} on$")
    late.said(r"^60 °C: \d+ s \(\d+ to \d+ s\)$")
    late.said(r"^stays there from \d+ s on; \|u\| up to \d+$")
    assert late.wait() == 0
    assert verdicts.end(signal.SIGINT) == 0, verdicts.text
    assert "Traceback" not in verdicts.text
    assert twin.end() == 0


def test_namespace(programs: Any, page: Path, session: Path, tmp_path: Path) -> None:
    beside = programs.start(page / "verdicts.py", "--ros-args", "-r", "__ns:=/rig_b")
    verdicts = start_shell(programs, page, blocks("sh")[1])
    start_twin(programs, "-r", "__ns:=/rig_a")
    part = write_session(tmp_path / "part", read_session(session).samples[:370])
    wait_for_reader(programs, "/rig_a/twin/model_score")
    player = start_player(programs, part, "-p", "wait_for:=2", "-r", "__ns:=/rig_a")
    assert player.wait() == 0, player.text
    verdicts.said(r"^sample \d+: ")
    assert beside.text == ""


@pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="no cyclonedds here")
def test_temperatures(programs: Any, page: Path, session: Path) -> None:
    program = programs.start(page / "temperatures.py")
    reader = programs.start_reader("twinmatch_msgs/LoopSample", "plant/sample")
    wait_for_reader(programs, "plant/temperature")
    player = start_player(programs, session)
    assert player.wait() == 0, player.text
    samples = {s.stamp // 10**9: s.output for s in read_session(session).samples}
    heard = re.findall(r"^(\d+) s: (-?[\d.]+) °C\n", program.text, re.MULTILINE)
    assert len(heard) > 100
    assert all(value == f"{samples[int(second)]:.2f}" for second, value in heard)
    assert reader.end() == 0


def test_open_network(programs: Any, page: Path, session: Path, project: Path) -> None:
    """The page's words for it, with the player instead of the whole graph."""
    export, command = blocks("sh")[2].splitlines()
    assert command == "python launch_scripts/replay.py bags/four_setpoints"
    assert (project / command.split()[1]).is_file()
    assert (project / command.split()[2]).is_dir()
    player = f"\npython -m twinmatch.nodes player --ros-args -p session:={session} -p paused:=true"
    opened = start_shell(programs, page, export, "\nexec" + player.replace("\n", " "))
    opened.said("NETWORK OPEN")
    closed = start_player(programs, session, "-p", "paused:=true")
    found = programs.start(Path(__file__).with_name("graph.py"))
    found.said('"/plant/sample"')
    opened.wait_until(lambda: network.sockets_elsewhere(opened.id), "a socket elsewhere")
    assert network.sockets_elsewhere(closed.id) == []
    assert "NETWORK OPEN" not in closed.text


def test_table_of_topics(programs: Any, session: Path) -> None:
    """Type, reliability and durability of every topic that a replay has."""
    table = {
        name: (f"{package}/msg/{kind}", reliability.strip(), latched.strip() == "yes")
        for name, package, kind, reliability, latched in ROW.findall(PAGE.read_text())
    }
    table = {name if name.startswith("/") else f"/{name}": row for name, row in table.items()}
    assert len(table) == PAGE.read_text().count("\n| `") - len(KEPT_IN)
    start_twin(programs)
    start_player(programs, session, "-p", "paused:=true")
    graph = programs.start(Path(__file__).with_name("graph.py"))
    due = {name for name in table if not name.startswith(LIVE)}
    graph.wait_until(lambda: graph.json and due <= set(graph.json[-1]), "every topic")
    topics = {name: end for name, end in graph.json[-1].items() if name.startswith(("/twin", "/plant"))}
    topics |= {name: graph.json[-1][name] for name in due}
    for name, (kind, reliability, durability) in topics.items():
        shown = (kind, reliability.lower().replace("_", " "), durability == "TRANSIENT_LOCAL")
        assert shown == table[name], name
    for kind, *_ in table.values():
        package, _, name = kind.split("/")
        assert hasattr(importlib.import_module(f"{package}.msg"), name)
