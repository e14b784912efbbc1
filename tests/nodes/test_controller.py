"""The controller as a process, with a listener that is its camera, its bridge and its operator."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.parameter import Parameter as RosParameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64, Float64MultiArray

from tests.support.processes import Start
from tests.support.rig import GAINS
from tests.support.ros import Listener
from twinmatch.control import Loop
from twinmatch.nodes.messages import sample_from
from twinmatch.nodes.topics import EVERYTHING, LATCHED, RELIABLE
from twinmatch_msgs.msg import (
    LoopSample,
    PlantCommand,
    PlantReading,
    PwmApplied,
    PwmCommand,
)

pytestmark = pytest.mark.ros

FAST = ("-p", "period:=0.05", "-p", "command_period:=0.02", "-p", "max_age:=0.5")


class Bench:
    """What stands around a controller."""

    def __init__(self, listener: Listener) -> None:
        self.listener = listener
        self.samples = listener.hear(LoopSample, "plant/sample", EVERYTHING)
        self.commands = listener.hear(PwmCommand, "plant/pwm_command", EVERYTHING)
        assert not listener.health
        self._temperatures = listener.node.create_publisher(
            Temperature, "plant/temperature", 1
        )
        self.temperature = 25.0
        self.stamp = 0  # s; 0: none

    def feed(self, condition: Callable[[], Any], what: str) -> None:
        """Publish the temperature until something holds."""

        def fed() -> Any:
            message = Temperature(temperature=self.temperature)
            message.header.stamp.sec = self.stamp
            self._temperatures.publish(message)
            return condition()

        self.listener.spin_until(fed, what)

    def pass_time(self, seconds: float) -> None:
        """Keep publishing the temperature."""
        deadline = time.monotonic() + seconds
        self.feed(lambda: time.monotonic() > deadline, "time")

    def put(self, name: str, value: object) -> Any:
        """What the controller answers to a parameter that is set."""
        client = self.listener.node.create_client(
            SetParameters, "controller/set_parameters"
        )
        self.feed(client.service_is_ready, "the service")
        parameter = RosParameter(name, value=value).to_parameter_msg()
        answer = client.call_async(SetParameters.Request(parameters=[parameter]))
        self.feed(answer.done, "the answer")
        return answer.result().results[0]

    def zero_last(self) -> bool:
        return bool(self.commands) and self.commands[-1].pwm == 0


@pytest.fixture
def bench(listener: Listener) -> Bench:
    return Bench(listener)


def test_samples_are_steps_of_the_pid(start: Start, bench: Bench) -> None:
    references = bench.listener.hear(Float64, "plant/reference", LATCHED)
    start(
        "controller",
        *FAST,
        "-p",
        "profile.levels:=[40.0, 60.0]",
        "-p",
        "profile.holds:=[1.0, 1.0]",
    )
    bench.feed(lambda: len(bench.samples) >= 50, "samples")
    samples = [sample_from(message) for message in bench.samples]
    assert all(s.reference == (40.0 if s.index % 40 < 20 else 60.0) for s in samples)
    assert [m.data for m in references] == [40.0, 60.0, 40.0]
    assert samples[0].input == 0
    gains = replace(GAINS, period=0.05)
    for before, after in pairwise(samples):
        if after.index != before.index + 1:
            continue  # a tick was missed on a busy machine
        error = after.reference - after.output
        error_before = before.reference - before.output
        if abs(before.input) < 255 and abs(after.input) < 255:
            change = (
                gains.proportional * (error - error_before)
                + gains.period * gains.integral * error_before
            )
            jump = gains.derivative * (error - error_before) / gains.period
            assert after.input - before.input == pytest.approx(change + jump, abs=1e-6)
    at_tick = {m.index: m.pwm for m in reversed(bench.commands)}
    assert all(at_tick[s.index] == s.input for s in samples if s.index in at_tick)
    assert len(bench.commands) > len(samples), "commands are repeated between ticks"


def test_a_course_is_followed_in_place_of_the_profile_which_waits_until_it_is_continued(
    start: Start, bench: Bench
) -> None:
    """It begins at once; its last level stays; the profile neither begins again nor moves on meanwhile."""
    references = bench.listener.hear(Float64, "plant/reference", LATCHED)
    profile = (
        "profile.levels:=[40.0, 60.0]",
        "profile.holds:=[0.5, 1.0]",
        "profile.repeat:=false",
    )
    start("controller", *FAST, *(word for value in profile for word in ("-p", value)))

    def heard(*levels: float) -> None:
        bench.feed(
            lambda: [m.data for m in references][-len(levels) :] == list(levels),
            f"{levels}",
        )

    heard(40.0, 60.0)
    course = {
        "course.levels": [50.0, 55.0],
        "course.holds": [0.5, 0.5],
        "course.followed": True,
    }
    for name, value in course.items():
        assert bench.put(name, value).successful
    heard(60.0, 50.0, 55.0)
    followed = len(bench.samples)
    bench.feed(
        lambda: len(bench.samples) > followed + 40, "more than the profile lasts"
    )
    assert references[-1].data == 55.0
    assert not bench.put("course.levels", [200.0]).successful
    assert bench.put("course.levels", [45.0]).reason.startswith(
        "course: 1 levels and 2 times are given"
    )
    assert bench.put("course.followed", False).successful
    heard(55.0, 60.0)
    assert [m.data for m in references] == [40.0, 60.0, 50.0, 55.0, 60.0]


def test_without_temperatures_the_output_is_off_and_samples_have_a_gap(
    start: Start, bench: Bench
) -> None:
    start(
        "controller",
        *FAST,
        "-p",
        "profile.levels:=[30.0]",
        "-p",
        "profile.holds:=[9.0]",
    )
    bench.feed(lambda: len(bench.samples) >= 20, "samples")
    bench.listener.spin_until(
        lambda: bench.listener.said("the output is off: the newest temperature is"),
        "the warning",
    )
    assert bench.commands[-1].pwm == 0
    ended = bench.samples[-1].index
    many = len(bench.samples)
    bench.temperature = math.nan
    heard = len(bench.commands)
    bench.feed(lambda: len(bench.commands) > heard + 10, "commands")
    assert all(m.pwm == 0 for m in bench.commands[heard:])
    assert len(bench.samples) == many
    bench.temperature = 25.0
    bench.feed(lambda: len(bench.samples) > many + 5, "samples again")
    restarted = sample_from(bench.samples[many])
    # a gap: nothing was made up for the time without temperatures
    assert restarted.index > ended + 1
    assert restarted.input == pytest.approx(0.0, abs=1e-9)


def test_a_drive_that_a_fault_holds_at_rest_is_not_said_to_be_driven(
    start: Start, bench: Bench
) -> None:
    applied = bench.listener.node.create_publisher(
        PwmApplied, "plant/pwm_applied", RELIABLE
    )
    start(
        "controller",
        *FAST,
        "-p",
        "profile.levels:=[60.0]",
        "-p",
        "profile.holds:=[9.0]",
    )
    bench.feed(
        lambda: bench.samples and bench.samples[-1].input[0] > 0, "a driven sample"
    )
    applied.publish(PwmApplied(fault="clock: /clock has stood still"))
    bench.feed(lambda: bench.samples[-1].input[0] == 0 and bench.zero_last(), "rest")
    bench.feed(
        lambda: bench.listener.said("the drive is held at rest: clock: /clock"),
        "the warning",
    )
    applied.publish(PwmApplied())
    bench.feed(lambda: bench.samples[-1].input[0] > 0, "a driven sample")


def test_samples_of_a_limited_drive_have_what_passes(
    start: Start, bench: Bench
) -> None:
    applied = bench.listener.node.create_publisher(
        PwmApplied, "plant/pwm_applied", RELIABLE
    )
    start(
        "controller",
        *FAST,
        "-p",
        "profile.levels:=[60.0]",
        "-p",
        "profile.holds:=[9.0]",
    )
    bench.feed(
        lambda: bench.samples and bench.samples[-1].input[0] > 0, "a driven sample"
    )

    def limited() -> bool:
        newest = bench.commands[-1]
        applied.publish(
            PwmApplied(fault="limited: hotter", pwm=40.0, sequence=newest.index)
        )
        return bool(bench.samples[-1].input[0] == 40.0)

    bench.feed(limited, "a limited sample")
    assert bench.commands[-1].pwm > 40.0  # it still asks for what it wants
    bench.feed(
        lambda: bench.listener.said("the drive is limited: hotter"), "the warning"
    )
    applied.publish(PwmApplied())
    bench.feed(lambda: bench.samples[-1].input[0] > 40.0, "more than the limit")


def test_an_old_stamp_is_an_old_temperature(start: Start, bench: Bench) -> None:
    bench.stamp = 1000
    start("controller", *FAST)
    bench.feed(
        lambda: bench.listener.said("s old; is the camera working?"), "the warning"
    )
    assert not bench.samples


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_last_word_is_zero(
    start_process: Start, bench: Bench, number: signal.Signals
) -> None:
    process = start_process("controller", *FAST)
    bench.feed(lambda: any(m.pwm for m in bench.commands), "a command")
    assert process.end(number) == 0
    bench.listener.spin_until(bench.zero_last, "zero")
    heard = len(bench.commands)
    bench.pass_time(0.3)
    assert len(bench.commands) == heard


def test_a_defect_commands_zero_first(
    start: Start, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    tick = Loop.tick

    def defect(loop: Loop, *arguments: Any) -> Any:
        if loop.time > 3:
            raise RuntimeError("fell over")
        return tick(loop, *arguments)

    monkeypatch.setattr(Loop, "tick", defect)
    process = start("controller", "-p", "period:=0.2")
    bench.feed(lambda: any(m.pwm for m in bench.commands), "a command")
    bench.feed(lambda: not process.running, "the end")
    bench.listener.spin_until(bench.zero_last, "zero")
    assert process.wait() == 1
    assert "fell over" in process.text


def test_it_ends_with_the_profile(start: Start, bench: Bench) -> None:
    process = start(
        "controller",
        *FAST,
        "-p",
        "profile.levels:=[40.0, 50.0]",
        "-p",
        "profile.holds:=[1.0, 1.0]",
        "-p",
        "profile.repeat:=false",
        "-p",
        "exit_at_end:=true",
    )
    bench.feed(lambda: not process.running, "the end")
    assert process.wait() == 0
    bench.listener.spin_until(bench.zero_last, "zero")
    assert 37 <= bench.samples[-1].index <= 39


def test_the_set_point_may_come_from_a_topic(start: Start, bench: Bench) -> None:
    latched = bench.listener.node.create_publisher(Float64, "plant/reference", LATCHED)
    latched.publish(Float64(data=33.0))
    start("controller", *FAST, "-p", "reference_source:=topic")
    bench.feed(lambda: bench.samples, "samples")
    assert sample_from(bench.samples[0]).reference == 33.0
    # the latched reader does not match
    quiet = PublisherEventCallbacks(use_default_callbacks=False)
    plain = bench.listener.node.create_publisher(
        Float64, "plant/reference", RELIABLE, event_callbacks=quiet
    )
    bench.feed(lambda: plain.get_subscription_count() >= 1, "the reader")
    plain.publish(Float64(data=44.0))
    bench.feed(lambda: list(bench.samples[-1].reference) == [44.0], "the new set-point")
    for wrong in (120.0, math.nan):
        plain.publish(Float64(data=wrong))
        bench.feed(
            lambda wrong=wrong: bench.listener.said(f"set-point {wrong:g} °C refused"),
            "the refusal",
        )
    assert list(bench.samples[-1].reference) == [44.0]


def test_the_profile_can_be_changed_while_it_runs(start: Start, bench: Bench) -> None:
    start(
        "controller",
        *FAST,
        "-p",
        "profile.levels:=[30.0, 31.0]",
        "-p",
        "profile.holds:=[1000.0, 1000.0]",
    )
    bench.feed(lambda: bench.samples, "samples")

    def asked() -> float:
        return float(bench.samples[-1].reference[0])

    assert bench.put("profile.levels", [50.0, 51.0]).successful
    bench.feed(lambda: asked() == 50.0, "the first of the new levels")
    assert bench.put("profile.holds", [0.5, 1000.0]).successful
    bench.feed(lambda: asked() == 51.0, "the second one")
    for name, value, why in (
        ("profile.levels", [50.0, 51.0, 52.0], "3 levels and 2 times"),
        ("profile.levels", [50.0, 500.0], "allowed: "),
        ("profile.highest", 40.0, "level 1 is 50 °C"),
        ("profile.highest", 150.0, "restart the controller with it"),
        (
            "pid.proportional",
            9.0,
            "pid.proportional cannot change now: it is read once",
        ),
    ):
        refused = bench.put(name, value)
        assert not refused.successful
        assert why in refused.reason, refused.reason
    assert bench.put("profile.highest", 60.0).successful
    bench.pass_time(0.3)
    assert asked() == 51.0


def test_a_narrower_range_holds_for_the_set_point_that_stands(
    start: Start, bench: Bench
) -> None:
    latched = bench.listener.node.create_publisher(Float64, "plant/reference", LATCHED)
    latched.publish(Float64(data=70.0))
    start("controller", *FAST, "-p", "reference_source:=topic")
    bench.feed(lambda: bench.samples, "samples")
    assert bench.put("profile.highest", 60.0).successful
    bench.feed(
        lambda: list(bench.samples[-1].reference) == [60.0], "the highest set-point"
    )


def test_it_waits_for_its_readers(start: Start, bench: Bench) -> None:
    start("controller", *FAST, "-p", "wait_for:=2", "-p", "wait_timeout:=30.0")
    bench.feed(lambda: bench.listener.said("waiting"), "the report")
    assert not bench.samples
    assert not bench.commands
    bench.listener.hear(LoopSample, "plant/sample", EVERYTHING)
    bench.feed(lambda: bench.samples, "samples")
    assert bench.samples[0].index == 0


def test_readers_that_do_not_come_are_said(start: Start, bench: Bench) -> None:
    start("controller", *FAST, "-p", "wait_for:=5", "-p", "wait_timeout:=0.5")
    bench.feed(
        lambda: bench.listener.said(
            "of 5 subscribers after 0.5 s; started without them"
        ),
        "the warning",
    )
    assert bench.samples


def test_ticks_follow_the_clock(start: Start, bench: Bench) -> None:
    """Twenty times as fast, and not at all when it stands."""
    clock = bench.listener.node.create_publisher(Clock, "/clock", 10)
    start(
        "controller",
        "-p",
        "use_sim_time:=true",
        "-p",
        "profile.levels:=[40.0]",
        "-p",
        "profile.holds:=[5.0]",
    )
    bench.listener.spin_until(clock.get_subscription_count, "the controller")
    plant_time = 10_000_000_000

    def advance() -> None:
        nonlocal plant_time
        plant_time += 200_000_000
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(plant_time, 1_000_000_000)
        clock.publish(message)
        time.sleep(0.01)

    def enough() -> bool:
        advance()
        return len(bench.samples) >= 40

    bench.feed(enough, "samples")
    indices = [m.index for m in bench.samples]
    assert indices == sorted(set(indices))
    stamps = [sample_from(m).stamp for m in bench.samples]
    for (i, stamp), (j, later) in pairwise(zip(indices, stamps, strict=True)):
        assert (later - stamp) / 1e9 == pytest.approx(j - i, abs=0.99)
    bench.pass_time(1.0)  # for what is still on its way
    heard = len(bench.commands), len(bench.samples)
    bench.pass_time(1.0)
    assert (len(bench.commands), len(bench.samples)) == heard


def test_two_loops_have_two_set_points_and_one_message(
    start: Start, listener: Listener
) -> None:
    """A reading or a set-point of one heater alone, or NaN, moves nothing."""
    samples = listener.hear(LoopSample, "plant/sample", EVERYTHING)
    commands = listener.hear(PlantCommand, "plant/command", EVERYTHING)
    readings = listener.node.create_publisher(PlantReading, "plant/reading", 1)
    wishes = listener.node.create_publisher(
        Float64MultiArray, "plant/reference", LATCHED
    )
    wishes.publish(Float64MultiArray(data=[40.0, 30.0]))
    start(
        "controller", *FAST, "-p", "plant:=tclab-both", "-p", "reference_source:=topic"
    )
    temperatures = [25.0, 24.0]

    def fed(condition: Callable[[], Any], what: str) -> None:
        def look() -> Any:
            readings.publish(PlantReading(output=temperatures))
            return condition()

        listener.spin_until(look, what)

    fed(lambda: len(samples) > 3, "samples")
    sample = sample_from(samples[-1])
    assert (sample.references, sample.outputs, sample.disturbances) == (
        (40.0, 30.0),
        (25.0, 24.0),
        (),
    )
    assert all(u > 0 for u in sample.inputs)
    assert len(commands[-1].input) == 2
    for wrong, refusal in (
        (
            [45.0],
            "1 set-points refused; give one of each output: temperature, second_temperature",
        ),
        ([45.0, 90.0], "set-point 90 °C refused; the safe range is 0 to 75 °C"),
        ([math.nan, 30.0], "set-point nan °C refused"),
    ):
        wishes.publish(Float64MultiArray(data=wrong))
        fed(lambda said=refusal: listener.said(said), "the refusal")
    assert list(samples[-1].reference) == [40.0, 30.0]
    temperatures[:] = [25.0, math.nan]
    fed(lambda: list(commands[-1].input) == [0.0, 0.0], "rest")
    temperatures[:] = [25.0]
    fed(
        lambda: listener.said(
            "output has 1 values for the plant's outputs; expected 2"
        ),
        "the refusal",
    )
    assert list(commands[-1].input) == [0.0, 0.0]
