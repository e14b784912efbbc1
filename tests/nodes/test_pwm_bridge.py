"""The PWM bridge as a process: real ROS, a real serial port, an emulated board; the plate's last defence."""

from __future__ import annotations

import math
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature

from tests.support import boards
from tests.support.boards import StandIn
from tests.support.heaters import UNWATCHED, HeaterRig
from tests.support.processes import Start
from tests.support.ros import Listener
from tests.support.verdicts import verdict
from twinmatch.comparing import TrustLevel
from twinmatch.links.pwm_protocol import Flags
from twinmatch.nodes.messages import message_of
from twinmatch.nodes.network import sockets_elsewhere
from twinmatch_msgs.msg import LoopSample, ModelScore, PwmApplied, PwmCommand

pytestmark = pytest.mark.ros

PATIENT = [
    "-p",
    "timeout:=0.5",
    "-p",
    "command_timeout:=3.0",
    "-p",
    "temperature_timeout:=8.0",
]
"""For tests that are not about time, on a busy machine."""
QUIET = [*PATIENT, *UNWATCHED]
UNLIMITED = ["-p", "observer.margin:=150.0"]
SLOW = 0.1
"""Speed of a board whose deadline, a second of its own time, is not to pass before the test has looked."""

KINDS = [kind for kind in boards.KINDS if kind != "real"]


@pytest.fixture(params=KINDS)
def any_board(request: pytest.FixtureRequest) -> Iterator[Any]:
    board = boards.make(request.param)
    board.run()
    yield board
    board.close()


@pytest.fixture
def board() -> Iterator[StandIn]:
    board = StandIn()
    board.run()
    yield board
    board.close()


class Rig(HeaterRig):
    """Controller and camera as the bridge sees them, and what it says."""

    def __init__(self, listener: Listener) -> None:
        super().__init__(listener, "pwm_bridge")
        node = listener.node
        self.applied = listener.hear(
            PwmApplied, "plant/pwm_applied", QoSProfile(depth=100)
        )
        assert not listener.health
        self._commands = node.create_publisher(PwmCommand, "plant/pwm_command", 10)
        self._temperatures = node.create_publisher(
            Temperature, "plant/temperature", qos_profile_sensor_data
        )
        self._samples = node.create_publisher(LoopSample, "plant/sample", 100)
        self.pwm: float | None = None
        self.celsius: float | None = 25.0
        self.reference: float | None = None
        self.age = 0.0
        self._indices = count()
        self.stamp: Callable[[], int] = time.time_ns
        self.begin()

    def drive(self, pwm: float, board: Any) -> None:
        self.pwm = pwm
        self.until(
            lambda: board.drive().pwm == pytest.approx(pwm, abs=0.16), f"PWM {pwm}"
        )

    def wait_for_fault(self, kind: str, board: Any) -> None:
        """Until the bridge tells the fault and the board is at zero."""
        self.until(lambda: self.fault, kind)
        assert self.fault.startswith(f"{kind}: ")
        self.until(lambda: board.drive().pwm == 0, "zero")

    def stays_at_zero(self, board: Any) -> None:
        count_before = len(self.applied)

        def look() -> bool:
            assert board.drive().pwm == 0
            return len(self.applied) >= count_before + 3

        self.until(look, "reports")

    def warnings(self) -> str:
        """What the newest report of the bridge says."""
        reports = self.listener.reports("pwm_bridge: health")
        return reports[-1].message if reports else ""

    def feed(self) -> None:
        plant_time = self.stamp()
        if self.pwm is not None:
            command = PwmCommand(index=7, pwm=float(self.pwm))
            command.header.stamp = stamp(plant_time)
            self._commands.publish(command)
        if self.celsius is not None:
            temperature = Temperature(temperature=float(self.celsius))
            temperature.header.stamp = stamp(plant_time - round(self.age * 1e9))
            self._temperatures.publish(temperature)
        if (
            self.reference is not None
            and self.celsius is not None
            and self.pwm is not None
        ):
            loop = {
                "reference": [self.reference],
                "output": [self.celsius],
                "input": [self.pwm],
            }
            self._samples.publish(LoopSample(index=next(self._indices), **loop))


def stamp(nanoseconds: int) -> Time:
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


@pytest.fixture
def rig(listener: Listener) -> Iterator[Rig]:
    opened = Rig(listener)
    yield opened
    opened.close()


def test_commands_reach_the_pins_and_what_was_applied_is_reported(
    start_process: Start, rig: Rig, any_board: Any
) -> None:
    bridge = start_process("pwm_bridge", "-p", f"port:={any_board.port}", *QUIET)
    rig.until(lambda: rig.applied, "a report")
    assert (rig.applied[0].pwm, rig.applied[0].fault) == (0.0, "")
    rig.drive(120.0, any_board)
    any_board.set_current(2.5)
    rig.until(
        lambda: rig.applied[-1].current == pytest.approx(2.5, abs=0.02), "the current"
    )
    last = rig.applied[-1]
    assert (last.pwm, last.sequence, last.flags) == (120.0, 7, Flags.ENABLED)
    assert last.header.frame_id == "driver"
    assert abs(last.header.stamp.sec - time.time()) < 60
    rig.drive(-80.0, any_board)
    assert sockets_elsewhere(bridge.id) == []
    any_board.run(SLOW)
    assert bridge.end() == 0  # SIGTERM
    # an acknowledged zero, before the board's own deadline
    assert any_board.drive()[1:] == (0.0, True)


def test_a_killed_bridge_costs_at_most_the_boards_deadline(
    start_process: Start, rig: Rig, any_board: Any
) -> None:
    bridge = start_process("pwm_bridge", "-p", f"port:={any_board.port}", *QUIET)
    any_board.run(SLOW)
    rig.drive(200.0, any_board)
    any_board.pause()
    bridge.kill()
    before = any_board.drive()
    assert before.pwm == pytest.approx(200.0, abs=0.16)
    after = any_board.advance(1.05)
    assert (after.pwm, after.enabled) == (0.0, False)
    assert after.time - before.time == pytest.approx(1.05, abs=0.005)


def test_a_frozen_bridge_lets_go_and_stays_off(
    start_process: Start, rig: Rig, any_board: Any
) -> None:
    bridge = start_process("pwm_bridge", "-p", f"port:={any_board.port}", *QUIET)
    rig.drive(200.0, any_board)
    bridge.freeze()
    rig.until(lambda: not any_board.drive().enabled, "the board's deadline")
    bridge.thaw()
    rig.until(lambda: rig.fault, "a fault")
    rig.stays_at_zero(any_board)
    assert rig.fault.split(":")[0] in {"board", "link", "command_silent"}


def test_another_signal_ends_it_with_zero_too(
    start_process: Start, rig: Rig, board: StandIn
) -> None:
    bridge = start_process("pwm_bridge", "-p", f"port:={board.port}", *QUIET)
    rig.drive(200.0, board)
    board.run(SLOW)
    assert bridge.end(signal.SIGINT) == 0
    assert board.drive()[1:] == (0.0, True)


DOUBTS: tuple[tuple[str, str, float | None], ...] = (
    ("command_invalid", "pwm", math.nan),
    ("command_silent", "pwm", None),
    ("command_invalid", "pwm", math.inf),
    ("temperature_stale", "celsius", None),
    ("command_invalid", "pwm", 256.0),
    ("temperature_invalid", "celsius", math.nan),
    ("over_temperature", "celsius", 110.5),
    ("temperature_stale", "age", 60.0),
    ("under_temperature", "celsius", -40.0),
)
"""Fault, and which input breaks to which value."""


def test_doubt_is_zero_and_latches_until_cleared(
    start: Start, rig: Rig, board: StandIn
) -> None:
    limits = [
        "-p",
        "command_timeout:=2.0",
        "-p",
        "temperature_timeout:=3.0",
        *UNWATCHED,
    ]
    start("pwm_bridge", "-p", f"port:={board.port}", *limits)
    for kind, name, value in DOUBTS:
        rig.drive(120.0, board)
        rig.until(lambda: not rig.fault, "no fault any longer")
        good = getattr(rig, name)
        setattr(rig, name, value)
        rig.wait_for_fault(kind, board)
        rig.until(lambda kind=kind: kind in rig.warnings(), "the diagnostics")
        setattr(rig, name, good)
        rig.stays_at_zero(board)  # what is good again changes nothing
        answer = rig.call("clear_fault")
        assert answer.success
        assert kind in answer.message
    rig.drive(90.0, board)
    assert rig.call("clear_fault").message == "there is no fault"


@pytest.mark.parametrize(
    ("reference", "pwm"), [(60.0, 255.0), (0.0, -255.0)], ids=["heating", "cooling"]
)
def test_a_runaway_is_zero(
    start: Start, rig: Rig, board: StandIn, reference: float, pwm: float
) -> None:
    limits = ["-p", "runaway.gain_time:=1.0", "-p", "runaway.patience:=20.0"]
    start("pwm_bridge", "-p", f"port:={board.port}", *QUIET, *limits)
    rig.drive(pwm, board)
    rig.reference = reference
    rig.wait_for_fault("runaway", board)
    rig.stays_at_zero(board)


def test_a_sensor_that_does_not_see_the_heat_is_zero(
    start: Start, rig: Rig, board: StandIn
) -> None:
    """Any set-point or none: the drive alone says where the plate must be. Of a plant that is known better
    than usual, so that seconds of drive are enough."""
    limits = [*UNLIMITED, "-p", "observer.band:=3.0", "-p", "observer.spread:=0.05"]
    start("pwm_bridge", "-p", f"port:={board.port}", *PATIENT, *limits)
    rig.drive(255.0, board)
    rig.wait_for_fault("disagrees", board)
    assert re.fullmatch(
        r"disagrees: by its drive the plate is at \d+ ± \d+ °C, but the camera reads 25.0 °C: the drive "
        r"is lost, or the camera does not see the plate; check both",
        rig.fault,
    )
    rig.stays_at_zero(board)


def test_drive_that_no_reading_shows_is_limited_and_the_operator_lifts_that(
    start: Start, rig: Rig, board: StandIn
) -> None:
    start("pwm_bridge", "-p", f"port:={board.port}", *PATIENT)
    rig.drive(255.0, board)
    rig.until(
        lambda: rig.fault.startswith("limited: by its drive the plate is at "),
        "the limit",
    )
    rig.until(lambda: 0 < board.drive().pwm < 250, "less drive")
    rig.until(lambda: "limited: by its drive" in rig.warnings(), "the report")
    answer = rig.call("clear_fault")
    assert answer.success
    assert answer.message.startswith("cleared limited: ")
    rig.until(
        lambda: not rig.fault and board.drive().pwm == pytest.approx(255, abs=0.16),
        "all drive",
    )


def test_drive_that_the_readings_do_not_explain_is_zero(
    start: Start, rig: Rig, board: StandIn
) -> None:
    limits = [
        "-p",
        "observer.band:=150.0",
        "-p",
        "budget.least:=400.0",
        "-p",
        "budget.each:=0.0",
    ]
    start("pwm_bridge", "-p", f"port:={board.port}", *PATIENT, *UNLIMITED, *limits)
    rig.drive(255.0, board)
    rig.wait_for_fault("budget", board)
    assert "PWM·s more drive than the readings explain" in rig.fault
    assert rig.call("clear_fault").success  # which does not refill it
    rig.wait_for_fault("budget", board)


def test_what_a_trusted_twin_says_against_drive_or_sensor_is_zero(
    start: Start, rig: Rig, board: StandIn
) -> None:
    start("pwm_bridge", "-p", f"port:={board.port}", *QUIET)
    scores = rig.listener.node.create_publisher(ModelScore, "twin/model_score", 10)
    rig.drive(120.0, board)

    def say(level: TrustLevel, sample: int, **more: Any) -> None:
        count_before = len(rig.applied)
        scores.publish(message_of(verdict(level, sample, **more), time.time_ns()))
        rig.until(lambda: len(rig.applied) >= count_before + 3, "reports")

    rig.until(scores.get_subscription_count, "the bridge")
    say(TrustLevel.FAULT, 350, fault="drive-lost", fault_since=340, reason="no effect")
    assert rig.fault == ""  # nobody has trusted this twin yet
    say(TrustLevel.TRUSTED, 360)
    say(TrustLevel.FAULT, 370, fault="drive-lost", fault_since=365, reason="no effect")
    rig.wait_for_fault("twin", board)
    assert (
        rig.fault
        == "twin: the twin, trusted at sample 360, reports drive-lost: no effect"
    )
    rig.stays_at_zero(board)


def test_stop_is_a_fault_that_is_asked_for(
    start: Start, rig: Rig, board: StandIn
) -> None:
    start("pwm_bridge", "-p", f"port:={board.port}", *QUIET)
    rig.drive(120.0, board)
    assert rig.call("stop").success
    rig.wait_for_fault("stopped", board)
    rig.stays_at_zero(board)
    assert rig.call("clear_fault").success
    rig.drive(120.0, board)


def test_a_cable_pulled_and_put_back(start: Start, rig: Rig, any_board: Any) -> None:
    start("pwm_bridge", "-p", f"port:={any_board.port}", *QUIET)
    rig.drive(120.0, any_board)
    any_board.unplug()
    rig.until(lambda: rig.fault.startswith("link: "), "the fault")
    rig.until(lambda: math.isnan(rig.applied[-1].pwm), "not knowing")
    refused = rig.call("clear_fault")
    assert not refused.success
    assert "not connected" in refused.message
    any_board.plug()
    rig.wait_for_fault("link", any_board)
    rig.stays_at_zero(any_board)
    rig.until(lambda: rig.applied[-1].pwm == 0, "knowing again")
    assert rig.call("clear_fault").success
    rig.drive(120.0, any_board)


def test_a_bridge_started_before_there_is_a_board_drives_once_there_is(
    start: Start, rig: Rig, any_board: Any
) -> None:
    any_board.unplug()
    start("pwm_bridge", "-p", f"port:={any_board.port}", *QUIET)
    rig.pwm = 120.0
    rig.until(lambda: rig.listener.said("PWM link"), "a word of it")
    rig.pwm = None
    any_board.plug()
    rig.until(lambda: rig.applied and rig.applied[-1].pwm == 0, "the board")
    if rig.fault:  # commands that came meanwhile went nowhere, which latches
        assert rig.call("clear_fault").success
    rig.drive(120.0, any_board)


class SimulatedTime:
    """/clock, published in real time as long as it is let run."""

    def __init__(self, rig: Rig, at: float) -> None:
        self._publisher = rig.listener.node.create_publisher(Clock, "/clock", 10)
        self.now = at
        self.running = True
        self._ending = threading.Event()
        rig.stamp = lambda: round(self.now * 1e9)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(0.01):
            self.now += 0.01 * self.running
            self._publisher.publish(Clock(clock=stamp(round(self.now * 1e9))))


@pytest.fixture
def simulated(rig: Rig) -> Iterator[SimulatedTime]:
    opened = SimulatedTime(rig, 1000.0)
    yield opened
    opened.close()


def test_a_simulated_clock_that_stands_still_is_zero(
    start: Start, rig: Rig, board: StandIn, simulated: SimulatedTime
) -> None:
    """Although commands and temperatures keep arriving: in their time none of them is old."""
    start("pwm_bridge", "-p", f"port:={board.port}", "-p", "use_sim_time:=true", *QUIET)
    rig.drive(120.0, board)
    simulated.running = False
    rig.wait_for_fault("clock", board)
    simulated.running = True
    rig.stays_at_zero(board)
    assert rig.call("clear_fault").success
    rig.drive(90.0, board)


def test_a_simulated_clock_that_jumps_back_extends_no_deadline(
    start: Start, rig: Rig, board: StandIn, simulated: SimulatedTime
) -> None:
    start("pwm_bridge", "-p", f"port:={board.port}", "-p", "use_sim_time:=true", *QUIET)
    rig.drive(120.0, board)
    rig.pwm = None  # the controller has fallen silent …
    # … and the clock will not be back there for a quarter of an hour
    simulated.now -= 900.0
    rig.wait_for_fault("command_silent", board)
    rig.stays_at_zero(board)
    assert simulated.now < 200.0


def test_without_a_clock_nothing_is_driven_and_the_diagnostics_say_why(
    start: Start, rig: Rig, board: StandIn
) -> None:
    start("pwm_bridge", "-p", f"port:={board.port}", "-p", "use_sim_time:=true", *QUIET)
    rig.pwm = 120.0
    rig.stamp = lambda: 0
    rig.until(lambda: "the clock stands still" in rig.warnings(), "the warning")
    rig.stays_at_zero(board)
    assert rig.fault == ""


def test_no_samples_no_runaway_watch_and_that_is_said(
    start: Start, rig: Rig, board: StandIn
) -> None:
    start("pwm_bridge", "-p", f"port:={board.port}", *QUIET)
    rig.drive(50.0, board)
    rig.until(lambda: "runaway is not monitored" in rig.warnings(), "the warning")
    rig.reference = 25.0
    rig.until(lambda: "not monitored" not in rig.warnings(), "samples that are seen")


@pytest.mark.parametrize(
    ("topic", "kind"),
    [("plant/pwm_command", PwmCommand), ("plant/temperature", Temperature)],
)
def test_a_second_publisher_of_what_decides_about_heat_is_named_and_latches(
    start: Start, rig: Rig, board: StandIn, topic: str, kind: Any
) -> None:
    """Without one message from it; once it has ended the fault can be cleared."""
    start("pwm_bridge", "-p", f"port:={board.port}", *QUIET)
    rig.drive(50.0, board)
    second_publisher = rig.listener.node.create_publisher(kind, topic, 10)
    rig.wait_for_fault("senders", board)
    assert (
        f"/{topic} is published by listener and listener; end all but one" in rig.fault
    )
    assert rig.call("clear_fault").success
    rig.stays_at_zero(board)
    assert rig.fault == ""  # nothing was driven when it was cleared
    rig.listener.node.destroy_publisher(second_publisher)
    rig.drive(50.0, board)


def test_another_protocol_ends_it_in_one_line(
    start: Start, board: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinmatch.emulation.arduino.PROTOCOL", 9)
    bridge = start("pwm_bridge", "-p", f"port:={board.port}")
    assert bridge.wait() == 2
    assert "which is not protocol version 1" in bridge.text
    assert len(bridge.text.splitlines()) == 1
