"""The virtual rig in a process of its own, at its real port and stream."""

from __future__ import annotations

import itertools
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.processes import run_twinmatch
from tests.support.waiting import wait_for
from twinmatch.emulation.clock import parse_address
from twinmatch.emulation.faults import RigControlError
from twinmatch.links.pwm_link import (
    PwmLatchedError,
    PwmPortLostError,
    PwmPortMissingError,
    PwmResetError,
)
from twinmatch.links.thermal_client import LinkState

Start = Callable[..., Any]
SIMULATOR = (
    shutil.which("avr-g++") is not None
    and Path("/usr/include/simavr/sim_avr.h").exists()
)
BOARD = "simavr" if SIMULATOR else "python"
"""The board that is to be had here that is nearest to the real one; both keep what it promises."""


def lives(process: int) -> bool:
    try:
        return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except FileNotFoundError:
        return False


def test_a_loop_closed_through_port_and_stream_reaches_its_set_point_and_a_pulled_cable_comes_back_latched(
    rig: Start, controller: Start
) -> None:
    running = rig("--speed", "20", "--board", BOARD, "--seed", "5")
    assert running.address("board").startswith(BOARD)
    loop = controller(running)
    last = [tick.temperature for tick in loop.hold(24.0, 42.0)][-10:]
    # The rig's PID approaches with P/I = 26 s: 42 s leave 0.2 of 1 K. An image's noise is 0.08 K.
    assert np.mean(last) == pytest.approx(24.0, abs=0.3)
    state = running.state()
    assert 0 < state["speed"] < 21
    # What the eye sees is the plate's mean, a little colder than its middle.
    assert state["plate"] == pytest.approx(24.0, abs=0.6)
    running.tell("cable-pulled")
    wait_for(lambda: not Path(running.address("serial")).exists(), "the port's end")
    with pytest.raises((PwmPortLostError, PwmPortMissingError)):
        loop.link.command(10)
    wait_for(lambda: not running.state()["enabled"], "the board's deadline")
    running.tell("end cable-pulled")
    loop.link.reopen()
    with pytest.raises(PwmLatchedError, match="received no command"):
        loop.link.command(10)
    loop.link.clear()
    assert running.process.end(signal.SIGINT) == 0


def test_noise_on_the_line_is_survived_and_a_hung_board_is_restarted_by_its_watchdog(
    rig: Start, controller: Start
) -> None:
    running = rig("--speed", "5", "--board", BOARD)
    loop = controller(running)
    running.tell("garbage-serial+10")
    loop.hold(30.0, 12.0)
    assert loop.errors
    wait_for(lambda: not running.state()["faults"], "the end of the fault")
    loop.link.reopen()
    loop.link.clear()
    assert loop.link.command(7).pwm == 7  # the line is as good as before
    running.tell("board-hung+1")
    wait_for(lambda: not running.state()["enabled"], "the restart")
    time.sleep(0.5)
    loop.link.reopen()
    with pytest.raises((PwmLatchedError, PwmResetError)):
        loop.link.command(10)
    assert running.process.end(signal.SIGHUP) == 0


def test_a_signal_ends_it_and_nothing_is_left(rig: Start, tmp_path: Path) -> None:
    running = rig()
    children = running.process.children
    assert children
    for process in (running.process.id, *children):
        # it needs no shared memory, so it leaves none
        shared = [
            mapping
            for mapping in Path(f"/proc/{process}/maps").read_text().splitlines()
            if "/dev/shm" in mapping
        ]
        assert all(
            "lttng" in mapping for mapping in shared
        )  # of the tracer that ROS loads, for all processes
    assert Path(running.address("serial")).exists()
    assert running.process.end(signal.SIGTERM) == 0
    assert not any(map(lives, children))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(parse_address(running.address("camera")))


def test_killed_they_leave_no_orphans_and_the_next_one_tidies_up_and_leaves_others_alone(
    rig: Start, tmp_path: Path
) -> None:
    rigs = [rig("--board", board) for board in ("python", "auto")]
    children = [running.process.children for running in rigs]
    assert [len(ids) for ids in children] == [1, 2 if SIMULATOR else 1]
    other_rig = rig("--board", "python")
    for running in rigs:
        assert running.process.end(signal.SIGKILL) == -signal.SIGKILL
    wait_for(
        lambda: not any(map(lives, itertools.chain(*children))),
        "the end of the children",
    )
    left_folders = {Path(running.address("control")).parent for running in rigs}
    assert all(folder.exists() for folder in left_folders)
    following = rig("--board", "python")
    assert left_folders.isdisjoint(tmp_path.iterdir())
    assert following.process.end() == 0
    assert Path(other_rig.address("serial")).exists()
    other_rig.state()
    assert other_rig.process.end() == 0
    assert list(tmp_path.iterdir()) == []


def test_it_ends_with_the_reader_of_its_output(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "twinmatch.cli",
        "virtual-rig",
        "--board",
        "python",
    ]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=environment
    ) as running:
        assert running.stdout is not None
        assert "ready\n" in iter(running.stdout.readline, "")
        running.stdout.close()
        assert running.wait(20) == 0
    assert list(tmp_path.iterdir()) == []


def test_the_clock_tells_plant_time_and_never_runs_ahead_and_ends_with_the_duration(
    rig: Start,
) -> None:
    running = rig("--speed", "10", "--board", "python", "--duration", "30")
    with socket.create_connection(
        parse_address(running.address("clock"))
    ) as connection:
        lines = connection.makefile("rb")
        first = int(lines.readline())
        start = time.monotonic()
        stamps = [int(line) for line in lines]
        wall = time.monotonic() - start
    assert all(a < b for a, b in itertools.pairwise(stamps))
    # 0.2 s of plant time may be made up for, and one slice.
    assert (stamps[-1] - first) / 1e9 <= 10 * wall + 0.3
    assert abs(first / 1e9 - time.time()) < 3600
    assert running.said("ended:").startswith("30.0 s of plant time")
    assert running.process.wait() == 0


def test_a_broken_wire_lets_the_plate_go_while_the_board_continues(
    rig: Start, controller: Start
) -> None:
    running = rig("--speed", "20", "--board", "python", "--fault", "drive-lost@40")
    loop = controller(running)
    loop.hold(45.0, 35.0)
    assert loop.current > 0.1
    ticks = loop.hold(45.0, 40.0)
    assert running.said("fault:") == "drive-lost begins at 40.00 s"
    state = running.state()
    assert state["plate"] < 40
    assert state["faults"] == ["drive-lost"]
    assert loop.current == pytest.approx(0, abs=0.02)  # two counts of the converter
    assert ticks[-1].pwm > 200  # the controller does what it can


def test_faults_of_the_camera_end_and_the_rig_ends_with_its_camera(
    rig: Start, controller: Start
) -> None:
    running = rig("--speed", "20", "--board", "python")
    thermal = controller(running).thermal
    wait_for(thermal.news, "an image")
    running.tell("sensor-frozen")  # it keeps sending, but has no news
    wait_for(lambda: running.state()["faults"], "the fault")
    time.sleep(0.1)
    last = thermal.news()
    frames = thermal.status.frames
    wait_for(lambda: thermal.status.frames > frames + 5, "more frames")
    assert thermal.news() is last
    running.tell("end sensor-frozen")
    wait_for(lambda: thermal.news() is not last, "the end of the fault")
    running.tell("camera-gone")  # comes back at its address
    wait_for(lambda: thermal.status.state is LinkState.WAITING, "the loss")
    wait_for(lambda: thermal.status.failures > 1, "another attempt")
    running.tell("end camera-gone")
    wait_for(lambda: thermal.status.restarts == 1, "the new camera")
    running.tell("garbage-camera+40")  # is refused
    wait_for(
        lambda: any("Frame" in name for name in thermal.status.errors), "the refusal"
    )
    wait_for(lambda: thermal.status.restarts == 2, "the camera again")
    (camera,) = running.process.children
    os.kill(camera, signal.SIGKILL)
    assert "its program has ended unexpectedly" in running.said("twinmatch:")
    assert running.process.wait() == 1


def test_a_fault_of_the_driver_trips_the_board_and_commands_are_checked(
    rig: Start, controller: Start
) -> None:
    # At real time, and commanded without a pause: else the board may trip because of silence first.
    running = rig("--speed", "1", "--board", "python")
    loop = controller(running)
    loop.hold(30.0, 1.0)
    running.tell("driver-fault")
    with pytest.raises(PwmLatchedError, match="driver"):
        wait_for(lambda: loop.link.command(10) is None, "the trip")
    assert not running.state()["enabled"]
    with pytest.raises(RigControlError, match="did you mean drive-lost"):
        running.tell("drive-last")
    with pytest.raises(RigControlError, match="empty command"):
        running.tell("")
    running.tell("stop")
    assert running.process.finish() == 0, (
        "it ends by itself; a signal might meet it on its way out"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fault", "drive-last@3"], "did you mean drive-lost?"),
        (["--speed", "0"], "the speed is 0.0; give 0.01 to 1000"),
        (["--duration", "0"], "the duration is 0.0 s; it must be positive"),
        (["--seed", "-1"], "the seed is -1; give 0 or more"),
        (
            ["--board", "esp32"],
            "board 'esp32' does not exist; choose one of auto, simavr, python",
        ),
    ],
)
def test_what_cannot_be_is_said_in_one_line(arguments: list[str], message: str) -> None:
    refused = run_twinmatch("virtual-rig", *arguments)
    assert refused.returncode == 2
    assert message in refused.stderr
    assert refused.stderr.count("\n") == 1
