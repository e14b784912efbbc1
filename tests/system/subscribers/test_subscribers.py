"""Programs that are not ours read what the graph says."""

from __future__ import annotations

import importlib.util
import json
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.waiting import wait_for
from twinmatch.nodes import network
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.sessions import open_any, read_session

pytestmark = pytest.mark.ros

HERE = Path(__file__).resolve().parent
RATE = 80
SETTLED = 400
"""Sample from which on everybody has found everybody: five seconds after the first; three are needed."""
KEPT_IN = {
    **{name: str(profile) for name, profile in network.PROFILES.items()},
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
}
"""The variables that keep a subscriber of somebody else on this machine, as docs/subscribing.md says."""

LENGTHS = {"a": 120, "b": 200}
"""Samples of two rigs."""

needs_cyclone = pytest.mark.skipif(
    importlib.util.find_spec("cyclonedds") is None, reason="no cyclonedds here; pip install cyclonedds"
)


@pytest.fixture(scope="module")
def said(session: Path) -> list[dict[str, Any]]:
    """The verdicts of an offline run, as reader.py shows them."""
    from tests.system.subscribers import reader
    from twinmatch.nodes.messages import message_of

    stamps = {sample.index: sample.stamp for sample in read_session(session).samples}
    read = open_any(session)
    verdicts = judge(read, terms_from_files(read)).verdicts
    shown = [reader.plain(message_of(verdict, stamps[verdict.sample])) for verdict in verdicts]
    return [json.loads(json.dumps(score)) for score in shown]


def as_text(messages: Sequence[Any]) -> list[str]:
    """Comparable to the last bit, NaN and all."""
    return [json.dumps(message) for message in messages]


def assert_heard_from_then_on(heard: Sequence[Any], said: Sequence[Any]) -> None:
    """What is not latched is received from when its reader was found, then without a hole."""
    assert as_text(heard) == as_text(said[-len(heard) :])
    assert heard[0]["sample"] <= SETTLED < heard[-1]["sample"]


@dataclass
class Replayed:
    """What was received while the launch script played a session."""

    scores: dict[str, list[Any]]
    last_words: dict[str, str]
    elsewhere: dict[str, list[str]]
    cyclone: list[Any]


@pytest.fixture(scope="module")
def replayed(lasting_programs: Any, session: Path, project: Path) -> Replayed:
    """One run of launch_scripts/replay.py, with a reader without settings, one kept in, and Cyclone's.

    Two more hold nobody up: one hangs from the first verdict on, one dies there.
    """
    start = lasting_programs
    readers = {
        "no settings": start.start_reader("twinmatch_msgs/ModelScore", "twin/model_score"),
        "kept in": start.start_reader("twinmatch_msgs/ModelScore", "twin/model_score", **KEPT_IN),
    }
    hanging, dying = (
        start.start_reader("twinmatch_msgs/ModelScore", "twin/model_score", "everything") for _ in range(2)
    )
    cyclone = None
    if importlib.util.find_spec("cyclonedds") is not None:
        cyclone = start.start(HERE / "cyclone_reader.py")
        cyclone.said("^ready$")
    elsewhere = {name: network.sockets_elsewhere(reader.id) for name, reader in readers.items()}
    replay = start.start_ours(project / "launch_scripts" / "replay.py", session, "--rate", RATE)
    readers["no settings"].said("{")
    hanging.freeze()
    dying.kill()
    assert replay.wait() == 0, replay.text
    last = read_session(session).samples[-1].stamp
    if cyclone is not None:
        cyclone.said(rf'\["sample", {last},')
    time.sleep(0.5)  # for what is still on its way
    for reader in readers.values():
        assert reader.end() == 0, reader.text
    if cyclone is not None:
        assert cyclone.end() == 0, cyclone.text
    return Replayed(
        scores={name: reader.json for name, reader in readers.items()},
        last_words={name: reader.text.splitlines()[-1] for name, reader in readers.items()},
        elsewhere=elsewhere,
        cyclone=cyclone.json if cyclone else [],
    )


@pytest.mark.parametrize("name", ["no settings", "kept in"])
def test_verdicts_reach_a_stranger_to_the_last_bit(replayed: Replayed, said: list[Any], name: str) -> None:
    assert_heard_from_then_on(replayed.scores[name], said)
    assert replayed.scores[name][-1]["level_name"] == "trusted"


@pytest.mark.parametrize("name", ["no settings", "kept in"])
def test_stranger_needs_no_twinmatch(replayed: Replayed, name: str) -> None:
    assert replayed.last_words[name] == "imported []"


def test_two_variables_keep_a_stranger_in(replayed: Replayed) -> None:
    assert replayed.elsewhere["kept in"] == []
    assert replayed.elsewhere["no settings"], "without them it listens on the network: the page says so"


def test_shell_lines_are_of_those(stranger: dict[str, str]) -> None:
    """And the place of the wheels, for tools that look for packages."""
    command = [sys.executable, "-m", "twinmatch.nodes.network"]
    done = subprocess.run(command, env=stranger, capture_output=True, text=True, check=True)
    words = [shlex.split(line) for line in done.stdout.splitlines()]
    lines = dict(word.split("=", 1) for _, word in words)
    lines.pop("AMENT_PREFIX_PATH", None)
    assert {word for word, _ in words} == {"export"}
    assert lines.items() <= KEPT_IN.items()
    assert sorted(name in network.PROFILES for name in lines) == [False, True]  # of the one that is installed


def test_shell_lines_unset_what_would_lead_elsewhere() -> None:
    environment = {"HOME": "/", "ROS_STATIC_PEERS": "10.0.0.1", **KEPT_IN, "AMENT_PREFIX_PATH": "/here"}
    assert network.shell_lines(environment) == ["unset ROS_STATIC_PEERS"]


def test_shell_lines_refuse_what_the_nodes_refuse(stranger: dict[str, str]) -> None:
    command = [sys.executable, "-m", "twinmatch.nodes.network"]
    environment = {**stranger, "TWINMATCH_NETWORK": "wide"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "use 'loopback' (the default) or 'open'" in done.stderr
    assert done.stdout == ""


def of_topic(replayed: Replayed, name: str) -> list[list[Any]]:
    """What Cyclone's reader has received of a topic."""
    return [values for topic, *values in replayed.cyclone if topic == name]


@needs_cyclone
def test_cyclone_reads_the_temperatures(replayed: Replayed, session: Path) -> None:
    """Best effort: some may be missing, none may be changed or come twice or late."""
    samples = read_session(session).samples
    measured = {sample.stamp: sample.output for sample in samples}
    heard = [(stamp, temperature) for stamp, temperature in of_topic(replayed, "temperature")]
    assert all(measured[stamp] == temperature for stamp, temperature in heard)
    assert [stamp for stamp, _ in heard] == sorted({stamp for stamp, _ in heard})
    assert len(heard) > (len(samples) - SETTLED) / 2


@needs_cyclone
def test_cyclone_reads_every_sample(replayed: Replayed, session: Path) -> None:
    """Reliable: from when it has found the player on, all of them, to the last bit."""
    samples = read_session(session).samples
    heard = of_topic(replayed, "sample")
    assert heard == [[s.stamp, s.index, s.reference, s.output, s.input] for s in samples[-len(heard) :]]
    assert len(heard) >= len(samples) - SETTLED


@pytest.fixture(scope="module")
def last_verdict(lasting_programs: Any, session: Path) -> Any:
    """The last verdict on a session that was played to a twin, which is latched for late subscribers."""
    start = lasting_programs.start_ours
    scores = lasting_programs.start_reader(
        "twinmatch_msgs/ModelScore", "/late/twin/model_score", "everything"
    )
    namespace = ("-r", "__ns:=/late")
    start("-m", "twinmatch.nodes", "twin", "--ros-args", *namespace)
    # The player waits for the twin, nobody for the reader: at this rate it has seconds to find the twin.
    player = start(
        *("-m", "twinmatch.nodes", "player", "--ros-args", *namespace, "-p", f"session:={session}"),
        *("-p", "rate:=100.0", "-p", "wait_for:=2", "-p", "wait_timeout:=60.0", "-p", "clock:=false"),
    )
    assert player.wait() == 0, player.text
    last = 599  # the last sample on which there is something to say
    scores.wait_until(lambda: any(score["sample"] >= last for score in scores.json), f"the verdict on {last}")
    while True:  # and what comes within a second of it
        count = len(scores.json)
        time.sleep(1.0)
        if len(scores.json) == count:
            return scores.json[-1]


def test_late_reader_is_given_the_nominal(programs: Any, last_verdict: Any) -> None:
    """When it subscribes, publishing has ended: what it receives can only be what was latched."""
    late = programs.start_reader("twinmatch_msgs/Candidate", "/late/twin/nominal", "latched")
    late.said("{")
    (nominal,) = late.json
    (candidate,) = [c for c in last_verdict["candidates"] if c["name"] == last_verdict["nominal"]]
    identity = ("name", "first", "last", "parameters")
    assert {key: nominal[key] for key in identity} == {key: candidate[key] for key in identity}


def test_volatile_late_reader_is_given_nothing(programs: Any, last_verdict: Any) -> None:
    """The counterpart that shows what `latched` is needed for."""
    assert last_verdict["nominal"]
    late = programs.start_reader("twinmatch_msgs/Candidate", "/late/twin/nominal")
    latched = programs.start_reader("twinmatch_msgs/Candidate", "/late/twin/nominal", "latched")
    latched.said("{")
    assert late.json == []


def test_rigs_do_not_mix(programs: Any, session: Path, tmp_path: Path) -> None:
    """Two rigs at once, each in its namespace, with sessions of different lengths."""
    topics = {f"/rig_{rig}/plant/sample": LENGTHS[rig] for rig in "ab"}
    readers = {
        topic: programs.start_reader("twinmatch_msgs/LoopSample", topic, "everything") for topic in topics
    }
    outside = programs.start_reader("twinmatch_msgs/LoopSample", "plant/sample", "everything")
    from twinmatch.sessions import write_session

    players = []
    for rig in "ab":
        part = write_session(tmp_path / rig, read_session(session).samples[: LENGTHS[rig]])
        players.append(
            programs.start_ours(
                *("-m", "twinmatch.nodes", "player", "--ros-args", "-r", f"__ns:=/rig_{rig}"),
                *("-p", f"session:={part}", "-p", "rate:=200.0", "-p", "clock:=false"),
            )
        )
    for player in players:
        assert player.wait() == 0, player.text
    for topic, length in topics.items():
        reader = readers[topic]
        wait_for(lambda reader=reader, length=length: len(reader.json) >= length, f"{length} of {topic}")
        assert [message["index"] for message in readers[topic].json] == list(range(length))
    assert outside.json == []
