"""The kit's node as a process: real ROS, the package on a pseudo-terminal, an emulated board."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("tclab", reason="pip install 'twinmatch[tclab]'")

from rclpy.qos import QoSProfile, qos_profile_sensor_data

from tests.support.heaters import UNWATCHED, HeaterRig
from tests.support.kits import BenchKit
from tests.support.processes import Process, Start
from tests.support.ros import Listener
from tests.support.verdicts import verdict
from tests.support.waiting import wait_for
from twinmatch.comparing import TrustLevel
from twinmatch.nodes.messages import message_of
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.plants import TCLab
from twinmatch.safety import stand_in
from twinmatch_msgs.msg import (
    EstimatedReading,
    ModelScore,
    PlantApplied,
    PlantCommand,
    PlantReading,
)

pytestmark = pytest.mark.ros

PATIENT = (
    "-p", "command_timeout:=3.0", "-p", "temperature_timeout:=8.0", "-p", "deadline:=4.0", *UNWATCHED
)  # fmt: skip
"""For tests that are not about time, on a busy machine."""


def test_the_heaters_go_off_between_the_highest_set_point_and_what_the_kit_bears() -> (
    None
):
    assert TCLab.output.safe[1] < TCLabBridge.LIMITS.highest < 100.0


class Rig(HeaterRig):
    """A controller as the bridge sees it, and what it says."""

    def __init__(self, listener: Listener) -> None:
        super().__init__(listener, "plant")
        self.applied = listener.hear(
            PlantApplied, "plant/applied", QoSProfile(depth=100)
        )
        self.readings = listener.hear(
            PlantReading, "plant/reading", qos_profile_sensor_data
        )
        self._commands = listener.node.create_publisher(
            PlantCommand, "plant/command", 10
        )
        self.sent: list[float] | None = None
        self.beside: Callable[[], None] = lambda: None
        """Called before each command."""
        self.begin()

    def drive(self, kit: BenchKit, *powers: float) -> None:
        """Until the heaters have these powers, and the bridge has said something of the kit."""
        self.sent = list(powers)
        self.listener.spin_until(
            lambda: (
                kit.heaters[: len(powers)] == list(powers)
                and self.readings
                and self.applied
            ),
            lambda: f"{powers} %; the bridge says {self.fault!r}",
        )

    def faulted(self, kind: str, kit: BenchKit) -> None:
        self.until(lambda: self.fault.startswith(f"{kind}: "), kind)
        self.until(lambda: kit.heaters == [0.0, 0.0], "zero")

    def feed(self) -> None:
        self.beside()
        if self.sent is not None:
            message = PlantCommand(index=7, input=self.sent)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(
                time.time_ns(), 10**9
            )
            self._commands.publish(message)


@pytest.fixture
def rig(listener: Listener) -> Iterator[Rig]:
    opened = Rig(listener)
    yield opened
    opened.close()


@pytest.fixture
def kit(tmp_path: Path) -> Iterator[BenchKit]:
    opened = BenchKit(tmp_path)
    yield opened
    opened.close()


ONE = ("-p", "plant:=tclab")
BOTH = ("-p", "plant:=tclab-both")


def bridge(start: Start, kit: BenchKit, *more: str) -> Any:
    return start("tclab_bridge", "-p", f"port:={kit.port}", *PATIENT, *more)


@pytest.mark.parametrize(
    ("words", "sent", "read"),
    [
        ((*ONE, "-p", "second:=15.0"), [42.0], ([33.5], [15.0])),
        (BOTH, [42.0, 15.0], ([33.5, 24.0], [])),
    ],
)
def test_commands_reach_the_heaters_and_readings_come_back(  # noqa: PLR0917
    start_process: Start,
    rig: Rig,
    kit: BenchKit,
    words: Any,
    sent: list[float],
    read: Any,
) -> None:
    process = bridge(start_process, kit, *words)
    rig.drive(kit, *sent)
    # Its command follows that of the first.
    rig.until(lambda: kit.heaters[1] == 15.0, "the second heater")
    kit.shown[1] = 33.5
    rig.until(lambda: list(rig.readings[-1].output) == read[0], "a reading")
    assert list(rig.readings[-1].disturbances) == read[1]
    rig.until(lambda: list(rig.applied[-1].input) == sent, "what was applied")
    assert (rig.applied[-1].sequence, rig.applied[-1].fault) == (7, "")
    assert Process.well(process.end(signal.SIGINT))
    assert kit.heaters == [0.0, 0.0]


DOUBTS: dict[str, tuple[tuple[str, ...], list[float], list[tuple[str, str, Any]]]] = {
    "one": (
        ONE,
        [50.0],
        [
            (
                "over_temperature",
                "the heater is at 91.0 °C",
                lambda _, kit: kit.shown.update({1: 91.0}),
            ),
            (
                "command_invalid",
                "the heater is nan",
                lambda rig, _: setattr(rig, "sent", [math.nan]),
            ),
            # a wire off its sensor
            ("under_temperature", "", lambda _, kit: kit.shown.update({1: -50.0})),
        ],
    ),
    "both": (
        BOTH,
        [50.0, 30.0],
        [
            (
                "over_temperature",
                "the second heater is at 91.0",
                lambda _, kit: kit.shown.update({2: 91.0}),
            ),
            (
                "command_invalid",
                "second heater is nan",
                lambda r, _: setattr(r, "sent", [50.0, math.nan]),
            ),
            (
                "command_invalid",
                "1 values for 2 drives",
                lambda rig, _: setattr(rig, "sent", [50.0]),
            ),
            ("command_silent", "", lambda rig, _: setattr(rig, "sent", None)),
            (
                "under_temperature",
                "the first heater",
                lambda _, kit: kit.shown.update({1: -50.0}),
            ),
        ],
    ),
}
"""Parameters of the bridge, what drives, and doubts: fault, its words, and what spoils a rig or a kit."""


@pytest.mark.parametrize("heaters", DOUBTS)
def test_doubt_is_zero_and_latches_until_cleared(
    start: Start, rig: Rig, kit: BenchKit, heaters: str
) -> None:
    words, sent, doubts = DOUBTS[heaters]
    bridge(start, kit, *words)
    shown = dict(kit.shown)
    for kind, text, spoil in doubts:
        rig.drive(kit, *sent)
        spoil(rig, kit)
        rig.faulted(kind, kit)
        assert text in rig.fault
        assert kit.highest == 50.0
        rig.sent = sent
        kit.shown.update(shown)
        before = len(rig.applied)
        rig.until(lambda before=before: len(rig.applied) > before + 3, "reports")
        assert kit.heaters == [0.0, 0.0]
        assert rig.call("clear_fault").success
    rig.drive(kit, *sent)
    assert "stopped" in rig.call("stop").message
    rig.faulted("stopped", kit)


@pytest.mark.parametrize("stopped", [False, True])
def test_the_node_is_killed_or_stands_still(
    start_process: Start, rig: Rig, kit: BenchKit, stopped: bool
) -> None:
    """The process that holds the port sees the end of its pipe, or receives nothing for its deadline."""
    process = bridge(start_process, kit, *BOTH)
    rig.drive(kit, 50.0, 30.0)
    if stopped:
        process.freeze()
    else:
        process.kill()
    wait_for(lambda: kit.heaters == [0.0, 0.0], "zero")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda alive, _: alive.clear(),
            "temperature is not believed, and there is no estimate",
        ),
        (
            lambda _, told: told.update(value=61.0),
            "temperature is estimated at 61.0 °C",
        ),
    ],
    ids=["as if the twin were killed", "too hot"],
)
def test_the_law_runs_on_an_estimate_as_long_as_there_is_one(  # noqa: PLR0917
    start: Start,
    rig: Rig,
    kit: BenchKit,
    monkeypatch: pytest.MonkeyPatch,
    spoil: Any,
    words: str,
) -> None:
    """By the operator's word only, of a trusted twin only, and never back onto the sensor by silence."""
    # tests/safety holds that it is not for less than ten
    monkeypatch.setattr(stand_in, "LASTING", 1.0)
    bridge(start, kit, *BOTH, "-p", "read_through:=T1", "-p", "highest:=60.0")
    scores = rig.listener.node.create_publisher(ModelScore, "twin/model_score", 10)
    estimates = rig.listener.node.create_publisher(
        EstimatedReading, "plant/estimate", 10
    )
    alive = threading.Event()
    estimate = {"value": 40.0}

    def feed() -> None:
        if alive.is_set():
            estimates.publish(
                EstimatedReading(
                    signal="temperature", band=0.5, wide=1.5, good=600.0, **estimate
                )
            )

    def say(level: TrustLevel, sample: int, **more: Any) -> None:
        scores.publish(message_of(verdict(level, sample, **more), time.time_ns()))

    rig.beside = feed
    rig.drive(kit, 50.0, 30.0)
    rig.until(
        lambda: scores.get_subscription_count() and estimates.get_subscription_count(),
        "the bridge",
    )
    alive.set()
    say(TrustLevel.TRUSTED, 360)
    drift = {
        "fault": "sensor-drift",
        "fault_signal": "temperature",
        "fault_since": 365,
        "reason": "off",
    }
    say(TrustLevel.FAULT, 370, **drift)
    rig.until(lambda: list(rig.readings[-1].taken)[:1] == [40.0], "the estimate")
    assert math.isnan(rig.readings[-1].taken[1])
    say(TrustLevel.TRUSTED, 380)
    rig.until(lambda: all(map(math.isnan, rig.readings[-1].taken)), "the sensor")
    assert rig.fault == ""
    say(TrustLevel.FAULT, 390, **drift)
    rig.until(lambda: list(rig.readings[-1].taken)[:1] == [40.0], "the estimate")
    spoil(alive, estimate)
    rig.faulted("estimate", kit)
    assert words in rig.fault


def test_a_sensor_that_is_not_there_is_one_line(start: Start) -> None:
    process = start("tclab_bridge", *BOTH, "-p", "read_through:=T1 T3")
    assert process.wait() == 2
    assert process.text == (
        "tclab_bridge: read_through has T3, no output of plant tclab-both; give temperature or "
        "second_temperature\n"
    )


def test_of_a_single_sensor_nothing_else_says_what_it_should_read(
    start: Start, kit: BenchKit
) -> None:
    process = bridge(start, kit, *ONE, "-p", "read_through:=temperature")
    assert process.wait() == 2
    assert process.text.count("\n") == 1
    assert "read_through needs plant tclab-both" in process.text


def test_the_cable_is_pulled_and_put_back(
    start: Start, rig: Rig, kit: BenchKit
) -> None:
    # or a busy machine's fault is another
    bridge(start, kit, *BOTH, "-p", "command_timeout:=10.0")
    rig.drive(kit, 50.0, 30.0)
    kit.unplug()
    rig.faulted("link", kit)
    rig.until(lambda: all(map(math.isnan, rig.applied[-1].input)), "not knowing")
    kit.plug()
    rig.until(lambda: list(rig.applied[-1].input) == [0.0, 0.0], "a kit that is back")
    assert rig.call("clear_fault").success
    rig.drive(kit, 30.0, 20.0)


class PulledInAnswer(dict[int, float]):
    """The sensors of a kit whose cable is pulled while it answers the first command that heats."""

    def __init__(self, kit: BenchKit) -> None:
        super().__init__(kit.shown)
        self._kit = kit

    def __getitem__(self, number: int) -> float:
        if self._kit.heaters[0] > 0.0:
            self._kit.board.unplug()
        return super().__getitem__(number)


def test_a_cable_pulled_before_the_first_answer_is_a_fault_too(
    start: Start, rig: Rig, kit: BenchKit
) -> None:
    """The heater was on, though no answer said so: it must not come on again by itself."""
    kit.shown = PulledInAnswer(kit)
    bridge(start, kit, "-p", "command_timeout:=10.0")
    rig.sent = [50.0]
    rig.faulted("link", kit)
    kit.plug()
    rig.until(lambda: list(rig.applied[-1].input) == [0.0], "a kit that is back")
    assert kit.heaters == [0.0, 0.0]


@pytest.mark.parametrize(
    ("port", "words"), [("/nowhere", "No such file"), ("/dev/null", "cannot be opened")]
)
def test_no_kit_is_one_line_and_exit_code_two(
    start: Start, port: str, words: str
) -> None:
    process = start("tclab_bridge", "-p", f"port:={port}")
    assert process.wait() == 2
    assert process.text.startswith("kit at")
    assert process.text.count("\n") == 1
    assert words in process.text


def test_two_wishes_for_heater_two_are_one_line(start: Start) -> None:
    process = start("tclab_bridge", *BOTH, "-p", "second:=5.0")
    assert process.wait() == 2
    assert (
        process.text
        == "tclab_bridge: second is 5 %, but plant tclab-both drives heater 2\n"
    )
