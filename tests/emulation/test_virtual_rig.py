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

from tests.support.waiting import wait_for
from twinmatch.emulation.clock import parse_address
from twinmatch.links.pwm_link import PwmLatchedError, PwmPortLostError, PwmPortMissingError, PwmResetError
from twinmatch.links.thermal_client import LinkState

Start = Callable[..., Any]
BOARDS = [
    "python",
    pytest.param(
        "simavr",
        marks=pytest.mark.skipif(
            shutil.which("avr-g++") is None or not Path("/usr/include/simavr/sim_avr.h").exists(),
            reason="no simavr here: apt install gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev",
        ),
    ),
]


def lives(process: int) -> bool:
    try:
        return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("board", BOARDS)
def test_a_loop_closed_through_port_and_stream_reaches_its_set_point(
    rig: Start, controller: Start, board: str
) -> None:
    running = rig("--speed", "20", "--board", board, "--seed", "5")
    assert running.address("board").startswith(board)
    loop = controller(running)
    last = [tick.temperature for tick in loop.hold(32.0, 120.0)][-20:]
    # The rig's PID approaches with P/I = 26 s: two minutes leave 0.1 of 10 K. An image's noise is 0.08 K.
    assert np.mean(last) == pytest.approx(32.0, abs=0.3)
    state = running.state()
    assert 0 < state["speed"] < 21
    # What the eye sees is the plate's mean, a little colder than its middle.
    assert state["plate"] == pytest.approx(32.0, abs=0.6)
    assert running.process.end() == 0
    print(f"\n{board} board: {running.said('ended:')}; {len(loop.errors)} errors of the link")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_and_nothing_is_left(rig: Start, number: signal.Signals, tmp_path: Path) -> None:
    running = rig()
    children = running.process.children
    assert children
    for process in (running.process.id, *children):  # it needs no shared memory, so it leaves none
        assert "/dev/shm" not in Path(f"/proc/{process}/maps").read_text()
    assert Path(running.address("serial")).exists()
    assert running.process.end(number) == 0
    assert not any(map(lives, children))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(parse_address(running.address("camera")))


@pytest.mark.parametrize("board", BOARDS)
def test_killed_it_leaves_no_orphans_and_the_next_one_tidies_up(
    rig: Start, board: str, tmp_path: Path
) -> None:
    running = rig("--board", board)
    children = running.process.children
    assert len(children) == (2 if board == "simavr" else 1)
    assert running.process.end(signal.SIGKILL) == -signal.SIGKILL
    wait_for(lambda: not any(map(lives, children)), "the end of the children")
    left = list(tmp_path.iterdir())
    following = rig("--board", "python")
    assert set(left).isdisjoint(tmp_path.iterdir())
    assert following.process.end() == 0
    assert list(tmp_path.iterdir()) == []


def test_it_ends_with_the_reader_of_its_output(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "twinmatch.cli", "virtual-rig", "--board", "python"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as running:
        assert running.stdout is not None
        assert "ready\n" in iter(running.stdout.readline, "")
        running.stdout.close()
        assert running.wait(20) == 0
    assert list(tmp_path.iterdir()) == []


def test_two_rigs_leave_each_other_alone(rig: Start) -> None:
    first, second = rig("--board", "python"), rig("--board", "python")
    assert second.process.end() == 0
    assert Path(first.address("serial")).exists()
    first.state()


def test_it_ends_when_its_duration_is_over(rig: Start) -> None:
    running = rig("--speed", "100", "--duration", "5", "--board", "python")
    assert running.said("ended:").startswith("5.0 s of plant time")
    assert running.process.wait() == 0


def test_the_clock_tells_plant_time_and_never_runs_ahead(rig: Start) -> None:
    running = rig("--speed", "10", "--board", "python")
    with socket.create_connection(parse_address(running.address("clock"))) as connection:
        lines = connection.makefile("rb")
        first, start = int(lines.readline()), time.monotonic()
        stamps = [int(lines.readline()) for _ in range(100)]
        wall = time.monotonic() - start
    assert all(a < b for a, b in itertools.pairwise(stamps))
    # 0.2 s of plant time may be made up for, and one slice.
    assert (stamps[-1] - first) / 1e9 <= 10 * wall + 0.3
    assert abs(first / 1e9 - time.time()) < 3600


def test_a_broken_wire_lets_the_plate_go_while_the_board_continues(rig: Start, controller: Start) -> None:
    running = rig("--speed", "10", "--board", "python", "--fault", "drive-lost@60")
    loop = controller(running)
    loop.hold(45.0, 50.0)
    assert loop.current > 0.1
    loop.hold(45.0, 60.0)
    assert running.said("fault:") == "drive-lost begins at 60.00 s"
    state = running.state()
    assert state["plate"] < 40
    assert state["faults"] == ["drive-lost"]
    assert loop.current == pytest.approx(0, abs=0.02)  # two counts of the converter
    assert state["pwm"] > 200  # the controller does what it can


def test_a_frozen_sensor_keeps_sending_but_has_no_news(rig: Start, controller: Start) -> None:
    running = rig("--speed", "20", "--board", "python")
    loop = controller(running)
    wait_for(loop.thermal.news, "an image")
    running.tell("sensor-frozen+40")
    wait_for(lambda: running.state()["faults"], "the fault")
    time.sleep(0.1)
    last, status = loop.thermal.news(), loop.thermal.status
    time.sleep(0.3)
    assert loop.thermal.news() is last
    assert loop.thermal.status.frames > status.frames + 5
    wait_for(lambda: loop.thermal.news() is not last, "the end of the fault")


def test_a_camera_that_is_gone_comes_back_at_its_address(rig: Start, controller: Start) -> None:
    running = rig("--speed", "20", "--board", "python")
    loop = controller(running)
    wait_for(loop.thermal.news, "an image")
    running.tell("camera-gone")
    wait_for(lambda: loop.thermal.status.state is LinkState.WAITING, "the loss")
    time.sleep(0.5)
    assert loop.thermal.status.failures > 1
    running.tell("end camera-gone")
    wait_for(lambda: loop.thermal.status.restarts == 1, "the new camera")
    assert running.process.children


def test_garbage_from_the_camera_is_refused_and_the_camera_comes_back(rig: Start, controller: Start) -> None:
    running = rig("--speed", "20", "--board", "python")
    loop = controller(running)
    wait_for(loop.thermal.news, "an image")
    running.tell("garbage-camera+40")
    wait_for(lambda: any("Frame" in name for name in loop.thermal.status.errors), "the refusal")
    wait_for(lambda: loop.thermal.status.restarts == 1, "the camera again")


@pytest.mark.parametrize("board", BOARDS)
def test_a_pulled_cable_comes_back_latched(rig: Start, controller: Start, board: str) -> None:
    running = rig("--speed", "20", "--board", board)
    loop = controller(running)
    loop.hold(30.0, 5.0)
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


@pytest.mark.parametrize("board", BOARDS)
def test_noise_on_the_line_is_survived(rig: Start, controller: Start, board: str) -> None:
    running = rig("--speed", "5", "--board", board)
    loop = controller(running)
    running.tell("garbage-serial+20")
    loop.hold(30.0, 25.0)
    assert loop.errors
    wait_for(lambda: not running.state()["faults"], "the end of the fault")
    loop.link.reopen()
    loop.link.clear()
    assert loop.link.command(7).pwm == 7  # the line is as good as before


def test_a_fault_of_the_driver_trips_the_board(rig: Start, controller: Start) -> None:
    # At real time, and commanded without a pause: else the board may trip because of silence first.
    running = rig("--speed", "1", "--board", "python")
    loop = controller(running)
    loop.hold(30.0, 1.0)
    running.tell("driver-fault")
    with pytest.raises(PwmLatchedError, match="driver"):
        wait_for(lambda: loop.link.command(10) is None, "the trip")
    assert not running.state()["enabled"]


@pytest.mark.parametrize("board", BOARDS)
def test_a_hung_board_is_restarted_by_its_watchdog(rig: Start, controller: Start, board: str) -> None:
    running = rig("--speed", "2", "--board", board)
    loop = controller(running)
    loop.hold(30.0, 1.0)
    running.tell("board-hung+1")
    wait_for(lambda: not running.state()["enabled"], "the restart")
    time.sleep(0.5)
    loop.link.reopen()
    with pytest.raises((PwmLatchedError, PwmResetError)):
        loop.link.command(10)


def test_fan_and_room_warm_the_sink(rig: Start) -> None:
    running = rig("--speed", "200", "--board", "python", "--fault", "ambient-step@10,fan-failed@100")
    running.wait_for_time(300)
    assert running.state()["sink"] > 25
    assert running.state()["faults"] == ["ambient-step", "fan-failed"]


def test_faults_at_run_time_are_checked_too(rig: Start) -> None:
    running = rig("--board", "python")
    with pytest.raises(Exception, match="did you mean drive-lost"):
        running.tell("drive-last")
    with pytest.raises(Exception, match="empty command"):
        running.tell("")
    running.tell("stop")
    assert running.process.finish() == 0, "it ends by itself; a signal might meet it on its way out"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fault", "drive-last@3"], "did you mean drive-lost?"),
        (["--speed", "0"], "the speed is 0.0; give 0.01 to 1000"),
        (["--duration", "0"], "the duration is 0.0 s; it must be positive"),
        (["--seed", "-1"], "the seed is -1; give 0 or more"),
        (["--board", "esp32"], "board 'esp32' does not exist; choose one of auto, simavr, python"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(rig: Start, arguments: list[str], message: str) -> None:
    refused = rig(*arguments, ready=False)
    assert message in refused.said("twinmatch:")
    assert refused.process.wait() == 2
    assert len(refused.process.lines) == 1


def test_a_camera_program_that_dies_ends_the_rig_with_a_reason(rig: Start) -> None:
    running = rig("--board", "python")
    (camera,) = running.process.children
    os.kill(camera, signal.SIGKILL)
    assert "its program has ended unexpectedly" in running.said("twinmatch:")
    assert running.process.wait() == 1
