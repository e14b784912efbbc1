"""Programs that are not ours read what the graph says, those of docs/subscribing.md as they stand there: a
session is played once, to all of them."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Process
from tests.support.waiting import wait_for
from twinmatch.importing import open_any
from twinmatch.nodes import network
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.sessions import read_session, write_session

pytestmark = pytest.mark.ros

HERE = Path(__file__).resolve().parent
PAGE = (HERE.parents[2] / "docs" / "subscribing.md").read_text("utf-8")
SETTLED = 400
"""Sample from which on everybody has found everybody: five seconds after the first; three are needed."""
KEPT_IN = {
    **{name: str(profile) for name, profile in network.PROFILES.items()},
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
}
"""The variables that keep a subscriber of somebody else on this machine, as the page says."""
LENGTHS = {"a": 70, "b": 40}
"""Samples of two rigs; those of the first are enough for a verdict: that there is no candidate yet."""
LIVE = (
    "/thermal/",
    *(
        f"/plant/{name}"
        for name in ("pwm", "uniformity", "reading", "command", "applied", "law")
    ),
)
"""Topics that only a live rig has."""
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ROW = re.compile(
    r"^\| `([/\w]+)` \| `(\w+)/(\w+)` \|([^|]*)\|([^|]*)\|[^|]*\|$", re.MULTILINE
)
TWIN = ("-p", "readers:=twin_simulator discriminator")
"""For a player that waits for a twin."""
CYCLONE = importlib.util.find_spec("cyclonedds") is not None
needs_cyclone = pytest.mark.skipif(
    not CYCLONE, reason="no cyclonedds here; pip install cyclonedds"
)


def blocks(kind: str) -> list[str]:
    return [text for language, text in BLOCK.findall(PAGE) if language == kind]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page's programs, under the names in their first lines."""
    folder = tmp_path_factory.mktemp("page")
    for text in blocks("python"):
        (folder / text.split()[1]).write_text(text)
    return folder


def start_shell(programs: Any, page: Path, text: str, more: str = "") -> Process:
    """Run a block of the page in its folder, with this interpreter as `python`."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    # exec: a signal has to reach the program and not the shell around it
    script = re.sub(r"^python (?!-m)", "exec python ", text, flags=re.MULTILINE) + more
    started: Process = programs.start(
        "-c", f"cd {page}\n{script}", python="bash", PATH=path
    )
    return started


def start_player(programs: Any, session: Path, *more: str) -> Process:
    options = (
        "-p",
        f"session:={session}",
        "-p",
        "rate:=80.0",
        "-p",
        "wait_timeout:=60.0",
        *more,
    )
    started: Process = programs.start_ours(
        "-m", "twinmatch.nodes", "player", "--ros-args", *options
    )
    return started


WAITING = """import rclpy, sys, time
rclpy.init()
node = rclpy.create_node("waiting")
while any(node.count_subscribers(topic) < int(n) for topic, n in zip(sys.argv[1::2], sys.argv[2::2])):
    time.sleep(0.1)
"""


def wait_for_readers(programs: Any, **counts: int) -> None:
    """Until so many read a topic; by a program of its own, as ROS in this process is not for this network."""
    words = [
        w
        for name, count in counts.items()
        for w in (f"/{name.replace('__', '/')}", f"{count}")
    ]
    assert programs.start("-c", WAITING, *words).wait() == 0


@pytest.fixture(scope="module")
def offline_verdicts(session: Path) -> list[dict[str, Any]]:
    """The verdicts of an offline run, as reader.py shows them."""
    from tests.system.subscribers import reader
    from twinmatch.nodes.messages import message_of

    stamps = {sample.index: sample.stamp for sample in read_session(session).samples}
    read = open_any(session)
    verdicts = judge(read, terms_from_files(read)).verdicts
    shown = [
        reader.plain(message_of(verdict, stamps[verdict.sample]))
        for verdict in verdicts
    ]
    return [json.loads(json.dumps(score)) for score in shown]


def as_text(messages: Sequence[Any]) -> list[str]:
    """Comparable to the last bit, NaN and all."""
    return [json.dumps(message) for message in messages]


@dataclass
class Played:
    """What was received while a session was played to a twin, which still runs."""

    scores: dict[str, list[Any]]
    last_words: dict[str, str]
    elsewhere: dict[str, list[str]]
    samples: list[Any]
    """What Cyclone's reader has received."""
    topics: dict[str, list[str]]
    programs: dict[str, Process]
    """Those of the page."""


@pytest.fixture(scope="module")
def played(
    lasting_programs: Any,
    page: Path,
    session: Path,
    offline_verdicts: list[dict[str, Any]],
) -> Played:
    """To the programs of the page, which are kept in, to a reader without settings, and to Cyclone's.

    Two more hold nobody up: one hangs from the first verdict on, one dies there. The page's question is asked
    before there is a candidate.
    """
    start = lasting_programs
    start.start_ours("-m", "twinmatch.nodes", "twin")
    early = start.start(page / "what_if.py", **KEPT_IN)
    graph = start.start(HERE / "graph.py")
    programs = {
        "verdicts": start_shell(start, page, blocks("sh")[0]),
        "forecasts": start.start(page / "forecasts.py", **KEPT_IN),
    }
    if CYCLONE:
        programs["temperatures"] = start.start(page / "temperatures.py")
        cyclone = start.start(HERE / "cyclone_reader.py")
        cyclone.said("^ready$")
    scores = ("twinmatch_msgs/ModelScore", "twin/model_score")
    readers = {"no settings": start.start_reader(*scores)}
    hanging, dying = (start.start_reader(*scores, "everything") for _ in range(2))
    early.said(
        "^forecast: there is no candidate yet; the first comes with the first match"
    )
    wait_for_readers(
        start, twin__model_score=4, twin__forecast=1, plant__temperature=int(CYCLONE)
    )
    programs |= readers
    elsewhere = {
        name: network.sockets_elsewhere(program.id)
        for name, program in programs.items()
    }
    player = start_player(start, session, *TWIN)
    due = {name for name in table_of_topics() if not name.startswith(LIVE)}
    graph.wait_until(
        lambda: any(due <= set(line) for line in graph.json), "every topic"
    )
    readers["no settings"].said("{")
    hanging.freeze()
    dying.kill()
    assert player.wait() == 0, player.text
    last = read_session(session).samples[-1]
    if CYCLONE:
        cyclone.said(rf"^\[{last.stamp},")
    for reader in readers.values():
        reader.said(f"^{re.escape(json.dumps(offline_verdicts[-1]))}$")
        assert reader.end() == 0, reader.text
    return Played(
        scores={name: reader.json for name, reader in readers.items()},
        last_words={
            name: reader.text.splitlines()[-1] for name, reader in readers.items()
        },
        elsewhere=elsewhere,
        samples=cyclone.json if CYCLONE else [],
        topics=next(line for line in graph.json if due <= set(line)),
        programs=programs,
    )


def test_verdicts_reach_a_stranger_to_the_last_bit(
    played: Played, offline_verdicts: list[Any]
) -> None:
    """From when its reader was found, without a hole; and it needs no twinmatch."""
    heard = played.scores["no settings"]
    assert as_text(heard) == as_text(offline_verdicts[-len(heard) :])
    assert heard[0]["sample"] <= SETTLED < heard[-1]["sample"]
    assert heard[-1]["level_name"] == "trusted"
    assert played.last_words["no settings"] == "imported []"


def test_two_variables_keep_a_stranger_in(played: Played) -> None:
    assert played.elsewhere["forecasts"] == played.elsewhere["verdicts"] == []
    assert played.elsewhere["no settings"], (
        "without them it listens on the network: the page says so"
    )


def test_shell_lines_set_the_variables_of_the_page_and_one_profile(
    stranger: dict[str, str],
) -> None:
    """And the place of the wheels, for tools that look for packages."""
    command = [sys.executable, "-m", "twinmatch.nodes.network"]
    completed = subprocess.run(
        command, env=stranger, capture_output=True, text=True, check=True
    )
    words = [shlex.split(line) for line in completed.stdout.splitlines()]
    lines = dict(word.split("=", 1) for _, word in words)
    lines.pop("AMENT_PREFIX_PATH", None)
    assert {word for word, _ in words} == {"export"}
    assert lines.items() <= KEPT_IN.items()
    # of the one that is installed
    assert sorted(name in network.PROFILES for name in lines) == [False, True]


def test_shell_lines_unset_what_would_lead_elsewhere() -> None:
    environment = {
        "HOME": "/",
        "ROS_STATIC_PEERS": "10.0.0.1",
        **KEPT_IN,
        "AMENT_PREFIX_PATH": "/here",
    }
    assert network.shell_lines(environment) == ["unset ROS_STATIC_PEERS"]


def test_shell_lines_refuse_what_the_nodes_refuse(stranger: dict[str, str]) -> None:
    command = [sys.executable, "-m", "twinmatch.nodes.network"]
    environment = {**stranger, "TWINMATCH_NETWORK": "wide"}
    completed = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False
    )
    assert completed.returncode == 2
    assert "use 'loopback' (the default) or 'open'" in completed.stderr
    assert completed.stdout == ""


@needs_cyclone
def test_cyclone_reads_every_sample(played: Played, session: Path) -> None:
    """Reliable: from when it has found the player on, all of them, to the last bit."""
    samples = read_session(session).samples
    heard = played.samples
    assert heard == [
        [s.stamp, s.index, s.reference, s.output, s.input]
        for s in samples[-len(heard) :]
    ]
    assert len(heard) >= len(samples) - SETTLED


@needs_cyclone
def test_the_pages_cyclone_reader_shows_the_temperatures(
    played: Played, session: Path
) -> None:
    """Best effort: some may be missing, none may be changed or come twice or late."""
    samples = {s.stamp // 10**9: s.output for s in read_session(session).samples}
    text = played.programs["temperatures"].text
    heard = [
        (int(second), value)
        for second, value in re.findall(r"^(\d+) s: (-?[\d.]+) °C\n", text, re.M)
    ]
    assert len(heard) > (len(samples) - SETTLED) / 2
    assert [second for second, _ in heard] == sorted({second for second, _ in heard})
    assert all(value == f"{samples[second]:.2f}" for second, value in heard)


def test_page_has_the_blocks_that_are_run_here() -> None:
    names = [
        "verdicts.py",
        "nominal.py",
        "forecasts.py",
        "what_if.py",
        "temperatures.py",
    ]
    assert [text.split()[1] for text in blocks("python")] == names
    assert len(blocks("sh")) == 3
    assert len(blocks("python")[0].splitlines()) <= 20


def test_the_pages_verdicts_nominal_forecasts_and_what_if(
    programs: Any, played: Played, page: Path, session: Path
) -> None:
    """Nominal and answers come when publishing has ended."""
    verdicts = played.programs["verdicts"]
    verdicts.said("sample 600: trusted, 70 °C")
    last = read_session(session).samples[-1].index
    forecast_line = (
        rf"^sample {last}: -?\d+\.\d °C in a minute \(-?\d+\.\d to -?\d+\.\d\)$"
    )
    played.programs["forecasts"].said(forecast_line)
    nominal = programs.start(page / "nominal.py")
    late = programs.start(page / "what_if.py", **KEPT_IN)
    nominal.said(r"^70 °C: α \d+\.\d mV/K, C \d+\.\d J/K$")
    late.said(rf", from sample {last} on$")
    late.said(r"^60 °C: \d+ s \(\d+ to \d+ s\)$")
    late.said(r"^stays there from \d+ s on; \|u\| up to \d+$")
    assert late.wait() == 0
    assert verdicts.end(signal.SIGINT) == 0, verdicts.text
    assert "Traceback" not in verdicts.text


def test_a_late_reader_is_given_the_nominal_if_it_asks_for_what_is_latched(
    programs: Any, played: Played, offline_verdicts: list[Any]
) -> None:
    """When it subscribes, publishing has ended: what it receives can only be what was latched."""
    assert played.scores
    volatile = programs.start_reader("twinmatch_msgs/Candidate", "twin/nominal")
    late = programs.start_reader("twinmatch_msgs/Candidate", "twin/nominal", "latched")
    late.said("{")
    (nominal,) = late.json
    (candidate,) = [
        c
        for c in offline_verdicts[-1]["candidates"]
        if c["name"] == offline_verdicts[-1]["nominal"]
    ]
    identity = ("name", "first", "last", "parameters")
    assert {key: nominal[key] for key in identity} == {
        key: candidate[key] for key in identity
    }
    assert volatile.json == []


def table_of_topics() -> dict[str, tuple[str, str, bool]]:
    """Type, reliability and whether it is latched, of every topic of the page."""
    rows = [
        (name, (f"{package}/msg/{kind}", reliability.strip(), latched.strip() == "yes"))
        for name, package, kind, reliability, latched in ROW.findall(PAGE)
    ]
    assert len(rows) == PAGE.count("\n| `") - len(KEPT_IN)
    return {name if name.startswith("/") else f"/{name}": row for name, row in rows}


def test_the_page_names_type_and_quality_of_service_of_every_topic(
    played: Played,
) -> None:
    table = table_of_topics()
    topics = {
        n: end
        for n, end in played.topics.items()
        if n in table or n.startswith(("/twin", "/plant"))
    }
    for name, (kind, reliability, durability) in topics.items():
        shown = (
            kind,
            reliability.lower().replace("_", " "),
            durability == "TRANSIENT_LOCAL",
        )
        assert shown == table[name], name
    for kind, *_ in table.values():
        package, _, name = kind.split("/")
        assert hasattr(importlib.import_module(f"{package}.msg"), name)


def test_only_an_opened_network_has_sockets_that_other_machines_reach(
    programs: Any, page: Path, session: Path, project: Path
) -> None:
    """The page's words for it, with the player instead of the whole graph."""
    export, command = blocks("sh")[2].splitlines()
    assert command == "python launch_scripts/replay.py bags/four_setpoints"
    assert all((project / word).exists() for word in command.split()[1:])
    player = f"\npython -m twinmatch.nodes player --ros-args -p session:={session} -p paused:=true"
    opened = start_shell(programs, page, export, "\nexec" + player.replace("\n", " "))
    opened.said("NETWORK OPEN")
    closed = start_player(programs, session, "-p", "paused:=true")
    programs.start(HERE / "graph.py").said('"/plant/sample"')
    opened.wait_until(
        lambda: network.sockets_elsewhere(opened.id), "a socket elsewhere"
    )
    assert network.sockets_elsewhere(closed.id) == []
    assert "NETWORK OPEN" not in closed.text


def test_rigs_do_not_mix(
    programs: Any, page: Path, session: Path, tmp_path: Path
) -> None:
    """Two at once, each in its namespace, with sessions of different lengths, and a twin beside the first."""
    readers = {
        name: programs.start_reader(
            "twinmatch_msgs/LoopSample", f"{name}plant/sample", "everything"
        )
        for name in ("", "/rig_a/", "/rig_b/")
    }
    verdicts = start_shell(programs, page, blocks("sh")[1])
    programs.start_ours(
        "-m", "twinmatch.nodes", "twin", "--ros-args", "-r", "__ns:=/rig_a"
    )
    wait_for_readers(programs, rig_a__twin__model_score=1)
    players = []
    for rig, length in LENGTHS.items():
        part = write_session(tmp_path / rig, read_session(session).samples[:length])
        options = (
            "-r",
            f"__ns:=/rig_{rig}",
            "-p",
            "clock:=false",
            *((*TWIN, "-p", "wait_for:=3") if rig == "a" else ()),
        )
        players.append(start_player(programs, part, *options))
    for player in players:
        assert player.wait() == 0, player.text
    for rig, length in LENGTHS.items():
        reader = readers[f"/rig_{rig}/"]
        wait_for(
            lambda reader=reader, length=length: len(reader.json) >= length,
            f"{length} of {rig}",
        )
        assert [message["index"] for message in reader.json] == list(range(length))
    verdicts.said(r"^sample \d+: ")
    assert readers[""].json == []
