"""Starting and ending processes of nodes."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.context import Context

from tests.support.processes import Start
from tests.support.shared_memory import (
    BEGINS,
    FOLDER,
    ports_of,
    remove_ports,
    remove_segments,
)
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.network import PROFILES, sockets_elsewhere
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.player import Player
from twinmatch.nodes.runner import Nodes, run

pytestmark = pytest.mark.ros

PROGRAM = """
import sys, time
from twinmatch.nodes import runner
from twinmatch.nodes.node import TwinmatchNode

class First(TwinmatchNode):
    NAME = "first"
    def open(self):
        self.create_timer(0.2, lambda: print("up", flush=True))
    def close(self):
        {closing}
        return True

class Second(TwinmatchNode):
    NAME = "second"

{before}
sys.exit(runner.run([First, Second], ["program"]))
"""


def program(closing: str = "pass", before: str = "") -> str:
    return PROGRAM.format(closing=closing, before=before)


WITHOUT_EVENTS = """
import sys
sys.modules["rclpy.experimental.events_executor"] = None  # as before rclpy 7.1.4
"""


def test_nodes_run_without_the_events_executor(start_script: Start) -> None:
    process = start_script(
        WITHOUT_EVENTS
        + program(before="print(runner.EventsExecutor.__name__, flush=True)"),
        cold=True,
    )
    process.said("^SingleThreadedExecutor$")
    process.said("^up$")
    process.send(signal.SIGINT)
    assert process.wait() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_with_zero_and_leaves_nothing(
    start_script: Start, number: signal.Signals
) -> None:
    # of other programs that it may meet
    foreign_files = set(Path("/dev/shm").glob("fastrtps_*"))
    process = start_script(program())
    process.said("^up$")
    files = [
        name for name in shared_memory(process.id) if Path(name) not in foreign_files
    ]
    assert files
    assert sockets_elsewhere(process.id) == []
    assert process.end(number) == 0
    assert not [name for name in files if Path(name).exists()]


def test_after_a_run_nothing_is_left_of_a_killed_node_and_a_running_one_keeps_its_files(
    start_script: Start, ros_domain: int
) -> None:
    """What the tests do at their end."""
    killed = start_script(program())
    killed.said("^up$")
    left = [Path(name) for name in shared_memory(killed.id)]
    killed.kill()
    node = start_script(program())
    node.said("^up$")
    kept = [Path(name) for name in shared_memory(node.id)]
    for segment in (*left, *kept):
        long_ago = time.time() - 2 * BEGINS
        os.utime(segment.with_name(f"{segment.name}_el"), (long_ago, long_ago))
    remove_segments()
    assert left
    assert not [path for path in left if path.exists()]
    assert kept
    assert all(path.exists() for path in kept)
    assert node.end() == 0
    ports = ports_of(ros_domain)
    for name in (f"fastrtps_port{ports[-1]}", f"sem.fastrtps_port{ports[-1]}_mutex"):
        (FOLDER / name).touch()
    remove_ports(ros_domain)
    assert not list(FOLDER.glob(f"*fastrtps_port{ports[-1]}*"))


@pytest.mark.parametrize("how", ["ended", "killed"])
def test_without_a_home_nothing_is_left_in_the_temporary_folder(
    start_script: Start, tmp_path: Path, how: str
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    without = {"HOME", "ROS_LOG_DIR", "ROS_HOME"}
    environment = {
        name: value for name, value in os.environ.items() if name not in without
    }
    process = start_script(
        program(), environment={**environment, "TMPDIR": str(temporary)}
    )
    process.said("^up$")
    if how == "killed":
        process.kill()
    else:
        assert process.end() == 0
    assert not list(temporary.iterdir())


def test_a_part_that_fails_at_the_end_is_reported_and_the_rest_ends(
    start_script: Start,
) -> None:
    foreign_files = set(Path("/dev/shm").glob("fastrtps_*"))
    process = start_script(program(closing="1 / 0"))
    process.said("^up$")
    files = [
        name for name in shared_memory(process.id) if Path(name) not in foreign_files
    ]
    assert process.end() == 1
    assert "ZeroDivisionError" in process.text
    assert not [name for name in files if Path(name).exists()]


def test_threads_end_before_the_executor_then_nodes_then_the_context() -> None:
    context = Context()
    nodes = Nodes(context)
    order: list[str] = []

    class Telling(TwinmatchNode):
        NAME = "telling"

        def close(self) -> bool:
            order.append(
                f"threads, executor {nodes.has_executor}, context {context.ok()}"
            )
            return super().close()

        def destroy_node(self) -> None:
            order.append(f"node, executor {nodes.has_executor}, context {context.ok()}")
            super().destroy_node()

    nodes.start([Telling], ["program"])
    assert nodes.close()
    assert order == [
        "threads, executor True, context True",
        "node, executor False, context True",
    ]
    assert not context.ok()


class First(TwinmatchNode):
    NAME = "first"


class Second(TwinmatchNode):
    """It does something when it is opened, or a moment later."""

    NAME = "second"

    def open(self) -> None:
        self.opening()
        self.create_timer(0.01, self.ticking)

    def opening(self) -> None: ...
    def ticking(self) -> None: ...


def wrong(_: Second) -> None:
    raise TwinmatchError("the rig is unplugged; plug it in")


def run_here(*words: str, **doing: Callable[[Second], object]) -> int:
    """The exit code of both nodes in this process."""
    return run([First, type("Doing", (Second,), doing)], ["program", *words])


def test_node_ends_its_process_with_its_code() -> None:
    assert run_here(ticking=lambda node: setattr(node, "exit_code", 7)) == 7


@pytest.mark.parametrize("place", ["opening", "ticking"])
def test_users_mistake_is_one_line(
    capfd: pytest.CaptureFixture[str], place: str
) -> None:
    assert run_here(**{place: wrong}) == 2
    printed = capfd.readouterr().err
    assert "the rig is unplugged; plug it in" in printed.splitlines()
    assert "Traceback" not in printed


def test_our_mistake_keeps_its_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_here(ticking=lambda _: 1 / 0) == 1
    printed = capfd.readouterr().err
    assert "Traceback" in printed
    assert "ZeroDivisionError" in printed


def test_end_that_hangs_is_cut_short(start_script: Start) -> None:
    process = start_script(
        program(closing="time.sleep(600)", before="runner.TEARDOWN = 1")
    )
    process.said("^up$")
    assert process.end() == -signal.SIGALRM


def test_end_may_take_as_long_as_a_node_says(start_script: Start) -> None:
    process = start_script(
        program(
            closing="time.sleep(1.5)", before="runner.TEARDOWN = 1; First.CLOSING = 20"
        )
    )
    process.said("^up$")
    assert process.end() == 0


def test_thread_that_continues_does_not_hold_the_end_up(start_script: Start) -> None:
    process = start_script(program(closing="return False"))
    process.said("^up$")
    assert process.end() == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["fast"], "program: unknown argument fast; see --help"),
        (["--ros-args", "-p"], "program: Couldn't parse trailing -p flag"),
        (
            ["--ros-args", "--params-file", "/nowhere.yaml"],
            "program: /nowhere.yaml: cannot be read: No such file or directory",
        ),
    ],
)
def test_a_wrong_command_line_is_one_line_and_exit_code_two(
    capfd: pytest.CaptureFixture[str], words: list[str], line: str
) -> None:
    assert run_here(*words) == 2
    printed = capfd.readouterr().err
    assert printed.splitlines()[-1].startswith(line)
    assert "Traceback" not in printed


REFUSED: tuple[tuple[str, str, str], ...] = (
    ("matcher", "sed:=3", "matcher: there is no parameter sed; did you mean seed?"),
    ("matcher", "seed:=-3", "matcher: parameter seed is -3; allowed: 0 to"),
    ("discriminator", "candidates:=/nowhere.yaml", "/nowhere.yaml: cannot be read"),
    ("twin_simulator", "schedule.span:=700 schedule.capacity:=600", "increasing order"),
    ("twin_simulator", "recent:=[]", "a parameter is empty"),
    (
        "controller",
        "profile.levels:=[120.0] profile.holds:=[9.0]",
        "level 1 is 120 °C; give one in the safe",
    ),
    ("controller", "profile.levels:=[30.0]", "1 levels and 4 times are given"),
    (
        "controller",
        "exit_at_end:=true",
        "with profile.repeat, exit_at_end would never take effect",
    ),
    ("controller", "exit_at_end:=true reference_source:=topic", "a topic has no end"),
    (
        "controller",
        "profile.lowest:=60.0 profile.highest:=50.0",
        "profile.lowest 60 must be below",
    ),
    (
        "controller",
        "reference_source:=moon",
        "reference_source is 'moon'; allowed: one of",
    ),
    ("controller", "pid.hihg:=3.0", "did you mean pid.high?"),
    (
        "pwm_bridge",
        "lowest:=120.0 highest:=100.0",
        "lowest 120.0 °C must be below highest 100.0 °C",
    ),
    (
        "pwm_bridge",
        "command_timeout:=0.0",
        "parameter command_timeout is 0.0; allowed: s, 0.1 to 10",
    ),
    (
        "pwm_bridge",
        "prot:=/dev/ttyACM1",
        "there is no parameter prot; did you mean port?",
    ),
    ("camera_bridge", "port:=0", "parameter port is 0; allowed: 1 to 65535"),
    (
        "camera_bridge",
        "roi.width:=0",
        "parameter roi.width is 0; allowed: pixels, 1 to 1024",
    ),
    ("camera_bridge", "hots:=pi", "there is no parameter hots; did you mean host?"),
    (
        "plant_clock",
        "",
        "clock address '': give HOST:PORT, as the virtual rig prints it",
    ),
    (
        "sampler",
        "source:=mqtt://127.0.0.1:1 map.output:=t map.input:=u",
        "no MQTT broker at 127.0.0.1:1",
    ),
    ("player", "", "player: the session is missing; give"),
    ("player", "session:=/nowhere", "session /nowhere: does not exist"),
    (
        "player",
        "session:=SESSION wait_timeout:=0.5",
        "player: /plant/sample has 0 of 1 subscribers",
    ),
    ("player", "session:=SESSION topics:=[thermal/]", "leave out plant/sample"),
    (
        "player",
        "session:=SESSION rate:=-1.0",
        "player: parameter rate is -1.0; allowed: 0 to",
    ),
)
"""Program, parameters, and what it says of them."""


@pytest.mark.parametrize(("name", "assignments", "line"), REFUSED)
def test_parameters_that_are_refused_are_one_line_and_exit_code_two(
    start: Start, session: Path, name: str, assignments: str, line: str
) -> None:
    words = assignments.replace("SESSION", str(session)).split()
    process = start(name, *(word for parameter in words for word in ("-p", parameter)))
    assert process.wait() == 2
    assert line in process.text
    assert len(process.text.splitlines()) == 1


def test_help_shows_the_parameters(capfd: pytest.CaptureFixture[str]) -> None:
    assert run([Player], ["player", "--help"]) == 0
    assert "rate: 1.0" in capfd.readouterr().out


def test_discovery_is_joined_on_loopback_alone(start_script: Start) -> None:
    """Counted over the whole machine, where others may come and go: so one undisturbed try is enough."""
    for _ in range(5):
        before = members("0100FFEF")  # 239.255.0.1
        process = start_script(program())
        process.said("^up$")
        joined = members("0100FFEF") - before
        process.end()
        if set(joined) == {"lo"}:
            return
    pytest.fail(f"every start joined the discovery on {set(joined)}")


def test_open_network_has_to_be_written_and_is_loud(
    start_script: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the range of one machine, so that this test sends nothing to the network either."""
    monkeypatch.setenv("TWINMATCH_NETWORK", "open")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name in PROFILES:
        monkeypatch.delenv(name, raising=False)
    process = start_script(program())
    process.said("^up$")
    assert "NETWORK OPEN" in process.text
    assert sockets_elsewhere(process.id)


def test_profile_that_is_not_read_stops_the_node(start_script: Start) -> None:
    """Sockets elsewhere in spite of the profile: a process with one of its own stands in for it."""
    holder = "import socket; held = socket.socket(type=socket.SOCK_DGRAM); held.bind(('', 0))"
    process = start_script(program(before=holder))
    assert process.wait() == 2
    assert "network: bound to udp 0.0.0.0:" in process.text


def shared_memory(process: int) -> set[str]:
    """Names of the files of Fast DDS in /dev/shm that belong to this process alone."""
    names = set()
    for line in Path(f"/proc/{process}/maps").read_text().splitlines():
        name = line.split()[-1]
        if (
            name.startswith(("/dev/shm/fastdds_", "/dev/shm/fastrtps_"))
            and "_port" not in name
        ):
            names.add(name)
    return names


def members(group: str) -> Counter[str]:
    """How many sockets of this machine have joined a group, by interface."""
    name = ""
    members_by_interface = Counter[str]()
    for line in Path("/proc/net/igmp").read_text().splitlines()[1:]:
        fields = line.split()
        if not line.startswith("\t"):
            name = fields[1]
        elif fields[0] == group:
            members_by_interface[name] += int(fields[1])
    return members_by_interface


def test_end_is_prompt_in_a_row_of_starts(start_script: Start) -> None:
    """A lost SIGTERM or a hanging end shows here as another code."""
    codes = []
    for _ in range(5):
        process = start_script(program())
        process.said("^up$")
        codes.append(process.end())
    assert codes == [0] * 5
