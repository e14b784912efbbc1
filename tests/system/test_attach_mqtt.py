"""What docs/mqtt.md tells people to write works as it stands there, without ROS and with it."""

from __future__ import annotations

import re
import signal
import socket
import sys
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.broker import RunningBroker, require
from tests.support.places import PROJECT
from tests.support.processes import (
    VERDICT_LINE,
    Process,
    Processes,
    no_plant_files,
    run_twinmatch,
)
from tests.support.waiting import wait_for
from twinmatch.links.mqtt_client import Broker
from twinmatch.offline.verification import verify_session
from twinmatch.sessions import read_session
from twinmatch.sessions.metadata import parameters_of
from twinmatch.sessions.recording import repair_session

PAGE = (PROJECT / "docs" / "mqtt.md").read_text(encoding="utf-8")
FILES = dict(
    re.findall(
        r"^```(?:python|yaml) (\w+\.\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL
    )
)
BLOCKS = re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
COMMANDS = [
    line.removeprefix("twinmatch ")
    for line in "".join(BLOCKS).splitlines()
    if "pip" not in line
]
HURRY = 0.04
"""Seconds between two steps of the home, and between two samples: a verdict needs hundreds of them."""


def without(*packages: str) -> str:
    """A program that is twinmatch where these are not installed."""
    gone = f"import sys; sys.modules.update(dict.fromkeys({packages!r}))"
    return f"{gone}; from twinmatch.cli import main; sys.exit(main(sys.argv[1:]))"


WITHOUT_ROS = without("rclpy", "twinmatch_msgs", "diagnostic_msgs", "std_msgs")


def write_files(folder: Path, broker: RunningBroker) -> None:
    """Write the page's files into a folder, for this broker and in a hurry."""
    for name, text in FILES.items():
        content = text.replace("mqtt://127.0.0.1", broker.url)
        content = content.replace("1883", str(broker.port))
        content = content.replace("time.sleep(0.1)", f"time.sleep({HURRY})")
        (folder / name).write_text(content, encoding="utf-8")


@dataclass
class Home:
    """A broker with the page's home behind it, and the page's files in a folder."""

    folder: Path
    broker: RunningBroker
    processes: Processes

    def attach(
        self, *options: object, without_ros: bool = False, dashboard: bool = True
    ) -> Process:
        """The page's command, in the hurry of its home; one that has no ROS cannot be forked, and takes as
        long to start as the rest of a test."""
        served = "--dashboard 0" if dashboard else ""
        words = COMMANDS[1].replace("--dashboard", served).split()
        program = ["-c", WITHOUT_ROS] if without_ros else ["-m", "twinmatch.cli"]
        return self.processes.python(
            *program, *words, "--period", HURRY, *options, folder=self.folder
        )


class House:
    """The broker of all tests, and the page's home."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes = Processes(folder / "output")
        self.broker = RunningBroker(folder / "broker", require("amqtt"))
        write_files(folder, self.broker)
        self._play()

    def mend(self) -> None:
        """Start both again if the broker was killed: a home that has looked for it for long looks rarely."""
        if not self.broker.process.running:
            self._home.kill()
            self.broker.start()
            self._play()

    def close(self) -> None:
        self._processes.dismiss()
        self.broker.close()

    def _play(self) -> None:
        self._home = self._processes.python("home.py", folder=self._folder)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    lasting_house = House(tmp_path_factory.mktemp("house"))
    yield lasting_house
    lasting_house.close()


@pytest.fixture
def home(tmp_path: Path, processes: Processes, house: House) -> Iterator[Home]:
    house.mend()
    write_files(tmp_path, house.broker)
    with no_plant_files():
        yield Home(tmp_path, house.broker, processes)


def samples_in(folder: Path) -> int:
    return len(read_session(folder).samples)


def test_the_page_leads_from_a_room_to_a_verdict_without_ros(
    home: Home, tmp_path: Path
) -> None:
    """That all brokers serve it alike is shown below, by the source's own tests."""
    listed = run_twinmatch(
        *COMMANDS[0].replace("mqtt://127.0.0.1", home.broker.url).split(),
        folder=tmp_path,
    )
    assert "ha/climate/living_room/current_temperature  " in listed.stdout
    assert "ha/climate/living_room/hvac_action  'heating'" in listed.stdout
    payloads: dict[str, bytes] = {}
    reader = Broker.parse(home.broker.url).connected(
        lambda client: client.subscribe("twinmatch/#") and None,
        lambda message: payloads.update({message.topic: bytes(message.payload)}),
    )
    run = home.attach("--tell", home.broker.url, without_ros=True)
    run.said(VERDICT_LINE)
    [address] = re.findall(r"page: (http\S+)", run.text)
    with urllib.request.urlopen(f"{address}metrics") as answer:
        assert 'twinmatch_trust_level{level="unknown"} 1.0' in answer.read().decode()
    wait_for(
        lambda: b'"level": "unknown"' in payloads.get("twinmatch/warm_room/state", b""),
        "the state",
    )
    assert run.end(signal.SIGINT) == 0
    wait_for(lambda: payloads["twinmatch/warm_room/status"] == b"offline", "the status")
    reader.disconnect()
    reader.loop_stop()
    assert re.search(r"ended: \d+ samples, [1-9]\d* verdicts", run.text)
    with no_plant_files():
        verification = verify_session(
            tmp_path / "first", plant=str(tmp_path / "room.py")
        )
    assert verification.identical, verification.difference
    assert verification.verdicts


@pytest.mark.long("a whole graph beside a broker until it has a twin")
@pytest.mark.ros
def test_where_ros_is_installed_the_graph_listens_to_the_broker(home: Home) -> None:
    pytest.importorskip(
        "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
    )
    run = home.attach()
    run.said(VERDICT_LINE)
    home.broker.kill()
    run.said(
        r"sampler: health: .*the connection to the broker at 127.0.0.1:\d+ is lost"
    )
    assert run.end(signal.SIGINT) == 0
    session = read_session(home.folder / "first")
    assert {"/twin/model_score", "/twin/forecast", "/plant/sample", "/diagnostics"} <= {
        *session.counts
    }
    assert not session.has_reference, "the thermostat publishes none"
    twin = parameters_of(session.records, "/discriminator")
    assert twin is not None
    assert twin["loop"] == "unknown", "the twin is driven"


def test_a_broker_that_is_gone_is_a_gap_and_a_run_that_is_killed_leaves_a_session_that_is_repaired(
    home: Home, house: House
) -> None:
    """The gap is reported, and what was recorded on both its sides is there.

    A broker that is killed forgets what it kept, and the page's home says only what is new: with it, it begins
    again.
    """
    run = home.attach("--alone", dashboard=False)
    run.said(r"^t / s")
    home.broker.kill()
    run.said(r"output: .*the connection to the broker at 127.0.0.1:\d+ is lost")
    house.mend()
    run.said(r"output: there are values again")
    folder = home.folder / "first"
    wait_for(
        lambda: any(f.stat().st_size > 20_000 for f in folder.glob("*.mcap")),
        lambda: f"samples on the disk: {run.text}",
    )
    run.kill()
    assert repair_session(folder).messages > 20
    assert samples_in(folder) > 20


def test_a_full_disk_ends_the_run_and_says_so(home: Home) -> None:
    with (home.folder / "room.yaml").open("a") as config:
        config.write("recorder:\n  ros__parameters:\n    min_free_mb: 1000000000.0\n")
    run = home.attach("--alone", dashboard=False)
    assert run.wait() == 1, run.text
    assert re.search(r"no space left in .*MB must stay free", run.text)
    assert "Traceback" not in run.text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--source", "opcua://host"), "has no known beginning; write"),
        (("--source", "mqtt://127.0.0.1:1"), "no MQTT broker at 127.0.0.1:1"),
        (
            ("--source", "mqtt://127.0.0.1", "--map", "output=home/#", "input=a"),
            "is a filter for many topics",
        ),
        (("--source", "mqtt://127.0.0.1", "--map", "output=a"), "map.input is missing"),
        (("--list",), "--list shows a source: give --source URL"),
        (
            ("--alone", "--map", "output=/t", "input=/u"),
            "--alone takes no topics of ROS; give --source URL",
        ),
        (
            ("--source", "mqtt://127.0.0.1", "--tell", "mqtt://h"),
            "--tell is done by the page",
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(
    options: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    mapped = (
        ()
        if "--map" in options or "--list" in options
        else ("--map", "output=a", "input=b")
    )
    completed = run_twinmatch(
        "attach", "--alone", "--no-record", *options, *mapped, folder=tmp_path
    )
    assert completed.returncode == 2
    assert words in completed.stderr
    assert "Traceback" not in completed.stderr


def test_no_protocol_but_mqtt_needs_its_library(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"mqtt://127.0.0.1:{free.getsockname()[1]}"
    words = f"attach --alone --source {url} --map output=a input=b".split()
    output = tmp_path / "said.txt"
    process = Process(
        sys.executable, "-c", without("paho"), *words, output=output, folder=tmp_path
    )
    assert process.wait() == 2
    assert "mqtt:// needs paho, which is not installed" in process.text
    assert "pip install 'twinmatch[mqtt]'" in process.text
