"""The sampler beside a rig that is not ours, in a process of its own."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from geometry_msgs.msg import Point
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64, Float64MultiArray

from tests.support.foreign_rig import CAPACITY, GAIN, TOPICS, Oven
from tests.support.oven import HOLD, MAP, PERIOD, RIG, oven_file
from tests.support.processes import Process, Processes, no_plant_files
from tests.support.ros import Inside, Listener
from twinmatch.nodes.foreign_topics import fields_of
from twinmatch.nodes.messages import sample_from
from twinmatch.nodes.topics import EVERYTHING, NEWEST, MessageTypeError, message_class
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import Field
from twinmatch.sampling.listener import SignalListener
from twinmatch.twin import Twin, TwinSettings
from twinmatch_msgs.msg import LoopSample

pytestmark = pytest.mark.ros

PAUSE = 3.0
"""Least time for which a rig stands still or is gone, s."""


class Beside:
    """A rig, a sampler, and what is received of them."""

    def __init__(
        self, processes: Processes, start: Any, listener: Listener, plant: Path
    ) -> None:
        self.listener = listener
        self._processes = processes
        self._start = start
        self._plant = plant
        self.samples: list[LoopSample] = listener.hear(
            LoopSample, "plant/sample", EVERYTHING
        )
        self.health = listener.health
        self.taken: list[str] = []
        """The topic of each message that a sampler in this process has taken."""

    def rig(self, *options: str) -> Process:
        return self._processes.python(RIG, "--period", f"{PERIOD}", *options)

    def sampler(self, **parameters: str) -> Inside:
        words = [f"plant:={self._plant}", f"period:={PERIOD}"]
        words += [
            f"map.{name}:='{text}'"
            for name, text in MAP.items()
            if name not in parameters
        ]
        words += [
            f"{name.replace('__', '.')}:={text}"
            for name, text in parameters.items()
            if name not in MAP
        ]
        words += [
            f"map.{name}:='{text}'"
            for name, text in parameters.items()
            if name in MAP and text
        ]
        options = [option for word in words for option in ("-p", word)]
        return self._start("sampler", *options)

    def wait_for_samples(self, count: int) -> None:
        wanted = len(self.samples) + count
        self.listener.spin_until(lambda: len(self.samples) >= wanted, self.said)

    def wait_for_word(self, words: str) -> None:
        begun = len(self.health)
        self.listener.spin_until(
            lambda: any(
                words in s.message for m in self.health[begun:] for s in m.status
            ),
            self.said,
        )

    def said(self) -> str:
        return f"{len(self.samples)} samples; {[s.message for m in self.health[-3:] for s in m.status]}"

    def stand(self, begun: float) -> None:
        """Until `PAUSE` has passed since then."""
        self.listener.spin_until(
            lambda: time.monotonic() > begun + PAUSE, "the end of a pause"
        )

    @property
    def pauses(self) -> list[int]:
        """The gaps in the indices, without those of a busy machine that stops for a moment."""
        indices = [message.index for message in self.samples]
        return [b - a for a, b in pairwise(indices) if b - a > 0.5 * PAUSE / PERIOD]


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with no_plant_files():
        yield oven_file(tmp_path_factory.mktemp("plant"))


@pytest.fixture
def beside(
    processes: Processes,
    start: Any,
    listener: Listener,
    plant: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Beside:
    around = Beside(processes, start, listener, plant)
    receive = SignalListener.receive

    def receive_and_note(
        self: SignalListener, topic: str, *message: Any, **options: Any
    ) -> None:
        receive(self, topic, *message, **options)
        around.taken.append(topic)

    monkeypatch.setattr(SignalListener, "receive", receive_and_note)
    return around


def numbers_of(messages: list[LoopSample]) -> list[tuple[float, float, float]]:
    return [(m.reference[0], m.output[0], m.input[0]) for m in messages]


def test_each_tick_of_the_rig_is_a_sample_of_the_same_three_numbers(
    beside: Beside,
) -> None:
    rig = beside.rig("--stamped")
    beside.sampler(output="/oven/temperature:temperature")
    beside.wait_for_samples(30)
    rows_of_rig = {tuple(line) for line in rig.json}
    pairs = numbers_of(beside.samples)
    # A busy machine may deliver one message late; never may the mass of them be of different ticks.
    assert sum(pair in rows_of_rig for pair in pairs) >= 0.95 * len(pairs)
    stamps = [
        m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in beside.samples
    ]
    assert all(a < b for a, b in pairwise(stamps))
    publishers = beside.listener.node.get_publishers_info_by_topic("/oven/heater")
    assert [info.node_name for info in publishers] == ["oven_rig"]


def passed_on(
    beside: Beside,
    sampler: Inside,
    kinds: dict[str, Any],
    ticks: Iterator[list[tuple[str, Any]]],
) -> None:
    """Publish what is sent at each tick by plant time, which passes once the tick was sampled.

    However long this machine takes, no message is late. `kinds` are the types of the topics.
    """
    listener = beside.listener
    publishers = {
        topic: listener.node.create_publisher(kind, topic, 10)
        for topic, kind in kinds.items()
    }
    clock = listener.node.create_publisher(Clock, "/clock", NEWEST)
    node = sampler.nodes[0]

    def pass_to(seconds: float) -> None:
        plant_time = Time(nanoseconds=round(1e9 * seconds))

        def has_come() -> bool:
            """Published at every look: a reader that has only just appeared may have missed the first."""
            clock.publish(Clock(clock=plant_time.to_msg()))
            return bool(node.get_clock().now().nanoseconds == plant_time.nanoseconds)

        listener.spin_until(has_come, "the plant time")

    listener.spin_until(
        lambda: all(p.get_subscription_count() for p in publishers.values()),
        "the readers of the rig",
    )
    listener.wait_for_publishers("plant/sample")
    for tick, sent in enumerate(ticks):
        pass_to(1000.0 + PERIOD * tick)
        for topic, message in sent:
            count_before = len(beside.taken)
            publishers[topic].publish(message)
            listener.spin_until(
                lambda count_before=count_before: len(beside.taken) > count_before,
                "a message taken at this time",
            )
        pass_to(1000.0 + PERIOD * (tick + 0.2))
        listener.spin_until(
            lambda tick=tick: len(beside.samples) == tick + 1, beside.said
        )


def in_step(beside: Beside, ticks: int) -> list[tuple[float, float, float]]:
    """Run the rig in this process by plant time: what it did."""
    oven = Oven(PERIOD, HOLD)
    rows_of_oven = [oven.step() for _ in range(ticks)]

    def messages_of(row: tuple[float, float, float]) -> list[tuple[str, Float64]]:
        return [
            (topic, Float64(data=value))
            for topic, value in zip(TOPICS, row, strict=True)
        ]

    sent = map(messages_of, rows_of_oven)
    passed_on(
        beside,
        beside.sampler(use_sim_time="true"),
        dict.fromkeys(TOPICS, Float64),
        sent,
    )
    return rows_of_oven


def joints(**positions: float) -> JointState:
    values = list(positions.values())
    return JointState(name=list(positions), position=values, effort=values)


def test_joints_are_sampled_by_name_in_any_order_and_beside_other_publishers(
    beside: Beside,
) -> None:
    """By index, every other sample would be the gripper's."""
    sent = (
        [
            ("/joints", joints(gripper=-5.0)),
            (
                "/joints",
                joints(
                    **dict(
                        sorted(
                            {"elbow": 20.0 + k, "wrist": -7.0}.items(),
                            reverse=k % 2 == 0,
                        )
                    )
                ),
            ),
        ]
        for k in range(20)
    )
    by_name = {
        "output": "/joints:position[elbow]",
        "input": "/joints:effort[elbow]",
        "reference": "",
    }
    passed_on(
        beside,
        beside.sampler(**by_name, use_sim_time="true"),
        {"/joints": JointState},
        sent,
    )
    assert [(output, command) for _, output, command in numbers_of(beside.samples)] == [
        (20.0 + k, 20.0 + k) for k in range(20)
    ]


def test_an_index_that_means_another_joint_is_reported_and_not_sampled(
    beside: Beside,
) -> None:
    by_index = {
        "output": "/joints:position[0]",
        "input": "/joints:effort[0]",
        "reference": "",
    }
    sampler = beside.sampler(**by_index, use_sim_time="true")
    sent = (
        [
            ("/joints", joints(elbow=20.0 + k)),
            *([("/joints", joints(gripper=-5.0))] if k else []),
        ]
        for k in range(10)
    )
    passed_on(beside, sampler, {"/joints": JointState}, sent)
    beside.wait_for_word(
        "/joints:position[0] is elbow in one message and gripper in another; choose it by name: "
        "/joints:position[elbow]; other messages are left out"
    )
    assert [output for _, output, _ in numbers_of(beside.samples)] == [
        20.0 + k for k in range(10)
    ]


def test_an_index_that_means_another_joint_at_the_start_ends_the_sampler(
    beside: Beside,
) -> None:
    """Which of them is meant, only the user knows."""
    by_index = {
        "output": "/joints:position[0]",
        "input": "/joints:effort[0]",
        "reference": "",
    }
    sampler = beside.sampler(**by_index)
    publisher = beside.listener.node.create_publisher(JointState, "/joints", 10)
    beside.listener.spin_until(publisher.get_subscription_count, "the sampler")
    for message in (joints(elbow=20.0), joints(gripper=-5.0)):
        publisher.publish(message)
    assert sampler.wait() == 2
    assert (
        "is elbow in one message and gripper in another; choose it by name"
        in sampler.text
    )


BOTH = {
    "map.output.1": "/kit/one:temperature",
    "map.second_temperature": "/kit/two; unit=K",
    "map.power": "/kit/heaters:data[0]",
    "map.input.2": "/kit/heaters:data[1]",
    "map.reference.1": "/kit/wanted:x",
    "map.second_temperature_reference": "/kit/wanted:y",
}
"""Two heaters and two sensors, by the names of the plant file and by their numbers."""


def sampler_of_both(start: Any, folder: Path, **changed: Any) -> Inside:
    """Its parameters are in a file: ROS takes no name with a number on a command line."""
    parameters = {"plant": "tclab-both", "period": PERIOD, **BOTH, **changed}
    file = folder / "both.yaml"
    file.write_text(yaml.safe_dump({"sampler": {"ros__parameters": parameters}}))
    return start("sampler", "--params-file", f"{file}")


def test_two_loops_are_sampled_by_name_and_by_number(
    beside: Beside, start: Any, tmp_path: Path
) -> None:
    kinds = {
        "/kit/one": Temperature,
        "/kit/two": Float64,
        "/kit/wanted": Point,
        "/kit/heaters": Float64MultiArray,
    }
    rows = [
        ((40.0, 50.0 + k), (20.0 + k, 31.0 - k), (5.0 * k, 100.0 - k))
        for k in range(12)
    ]
    sent = (
        [
            ("/kit/wanted", Point(x=r[0], y=r[1])),
            ("/kit/one", Temperature(temperature=y[0])),
            ("/kit/two", Float64(data=y[1] + 273.15)),
            ("/kit/heaters", Float64MultiArray(data=u)),
        ]
        for r, y, u in rows
    )
    passed_on(beside, sampler_of_both(start, tmp_path, use_sim_time=True), kinds, sent)
    samples = [sample_from(message) for message in beside.samples]
    assert [s.index for s in samples] == list(range(12))
    assert [(s.references, s.inputs) for s in samples] == [(r, u) for r, _, u in rows]
    assert [s.outputs for s in samples] == [
        pytest.approx(y, abs=1e-9) for _, y, _ in rows
    ]


def test_samples_of_a_rig_in_step_lead_to_its_own_numbers(
    beside: Beside, plant: Path
) -> None:
    """0.5 W/% and 4 J/K, of a plant file that begins at 0.8 and 6."""
    ticks = in_step(beside, 3 * HOLD)
    assert numbers_of(beside.samples) == ticks
    assert [message.index for message in beside.samples] == list(range(len(ticks)))
    twin = Twin(TwinSettings.of(find_plant(str(plant)), period=PERIOD))
    outcomes = [twin.push(sample_from(message)) for message in beside.samples]
    matches = [outcome.match.match for outcome in outcomes if outcome.match is not None]
    assert matches[-1].accepted
    assert matches[-1].parameters["gain"] == pytest.approx(GAIN, rel=0.02)
    assert matches[-1].parameters["capacity"] == pytest.approx(CAPACITY, rel=0.02)


def test_pause_end_and_restart_of_the_rig_are_reported_and_leave_gaps_of_their_length(
    beside: Beside,
) -> None:
    rig = beside.rig()
    sampler = beside.sampler()
    beside.wait_for_samples(10)
    before = len(beside.pauses)
    rig.freeze()
    begun = time.monotonic()
    beside.wait_for_word("input: no message on /oven/heater for")
    beside.stand(begun)
    rig.thaw()
    frozen = time.monotonic() - begun
    beside.wait_for_word("the loop paused: ticks were missed")
    beside.wait_for_samples(10)
    assert len(beside.pauses) == before + 1
    assert beside.pauses[-1] == pytest.approx(frozen / PERIOD, rel=0.2, abs=10)
    rig.kill()
    killed = time.monotonic()
    beside.wait_for_word("/oven/heater no longer has a publisher")
    beside.stand(killed)
    begun = len(beside.samples)
    rig = beside.rig()
    beside.wait_for_samples(30)
    assert len(beside.pauses) == before + 2
    assert sampler.running
    # The new rig begins cold, at its first set-point; nothing of the old one is mixed in.
    rows_of_rig = {tuple(line) for line in rig.json}
    pairs = numbers_of(beside.samples[begun + 1 :])
    assert sum(pair in rows_of_rig for pair in pairs) >= 0.95 * len(pairs)


def test_a_timer_takes_the_mean_of_the_input_and_the_newest_reading(
    beside: Beside,
) -> None:
    """The sampler's own clock, at a period the rig does not have: no tick is one of the rig's."""
    rig = beside.rig()
    beside.sampler(paced_by="timer", period="0.13")
    beside.wait_for_samples(20)
    rows_of_rig = rig.json
    readings = {line[1] for line in rows_of_rig}
    commands = [line[2] for line in rows_of_rig]
    assert {m.output[0] for m in beside.samples} <= readings
    assert all(min(commands) <= m.input[0] <= max(commands) for m in beside.samples)
    assert not {m.input[0] for m in beside.samples} <= set(commands)


def test_without_a_set_point_there_is_one_that_stands(beside: Beside) -> None:
    beside.rig("--no-set-point")
    beside.sampler(reference="")
    beside.wait_for_samples(10)
    assert len({m.reference[0] for m in beside.samples}) == 1


def test_kelvin_are_converted_where_it_is_said_and_refused_where_not(
    beside: Beside,
) -> None:
    beside.rig("--kelvin")
    wrong = beside.sampler()
    beside.wait_for_word(
        "outside -10 to 120 °C: no samples; if /oven/temperature has another unit"
    )
    assert not beside.samples
    wrong.end()
    beside.sampler(output="/oven/temperature; unit=K")
    beside.wait_for_samples(5)
    assert all(15.0 < m.output[0] < 60.0 for m in beside.samples)


def test_stamps_of_a_clock_that_is_behind_are_reported(beside: Beside) -> None:
    beside.rig("--stamped", "--behind", "100")
    beside.sampler(output="/oven/temperature:temperature")
    beside.wait_for_word(
        "the stamps of /oven/temperature:temperature lag behind this machine's clock"
    )
    assert not beside.samples


MISFITS: tuple[tuple[dict[str, str], str], ...] = (
    (
        {"output": "/oven/temp"},
        "no publisher on /oven/temp for 5 s; topics with a publisher: .*/oven/temperature",
    ),
    (
        {"output": "/oven/temperature:value"},
        "std_msgs/msg/Float64 has no field 'value'; its numbers:",
    ),
    (
        {"output": "/oven/temperature; unit=Pa"},
        "'/oven/temperature:data' is in Pa, but the plant's output",
    ),
    ({"input": "/oven/heater; unit=wibble"}, "'wibble' is not a known unit"),
    ({"input": ""}, "map.input is missing"),
    (
        {"paced_by": "timr"},
        "parameter paced_by is 'timr'; allowed: one of: reference, output, input, timer",
    ),
    (
        {"input": "/oven/heater; gain=3"},
        "gain: is not a known key; there are column, columns, interval, missing, names",
    ),
    ({"max_age__room": "3.0"}, "there is no parameter max_age.room"),
    (
        {"types": "'/oven/heater lab_msgs/msg/Drive'"},
        "lab_msgs/msg/Drive is not installed here",
    ),
)


OF_BOTH: tuple[tuple[dict[str, str], str], ...] = (
    (
        {"map.second_temperature": ""},
        "map.second_temperature is missing; give its topic and field",
    ),
    (
        {"map.power": "/oven/heater", "map.input.1": "/oven/heater"},
        "map.input.1 and map.power are the same signal; give it once",
    ),
    (
        {"map.reference.1": ""},
        "map.temperature_reference is missing; .*; give all set-points, or none",
    ),
    (
        {"map.power": "/oven/heater; unit=degC"},
        "'/oven/heater:data' is in degC, but the plant's power in %",
    ),
    (
        {"paced_by": "input"},
        "paced_by is 'input'; allowed: one of: .*, power, second, timer",
    ),
    ({"max_age.output.3": 3.0}, "there is no parameter max_age.output.3"),
)


def is_refused(sampler: Inside, words: str) -> None:
    assert sampler.wait() == 2, words
    assert re.search(words, sampler.text)
    assert sampler.text.count("\n") == 1


def test_what_does_not_fit_is_one_line_and_exit_code_2(
    beside: Beside, start: Any, tmp_path: Path
) -> None:
    rig = beside.rig()
    rig.wait_until(lambda: rig.json, "its first samples")
    for misfit, words in MISFITS:
        is_refused(beside.sampler(wait_timeout="5.0", **misfit), words)
    for misfit, words in OF_BOTH:
        values = dict.fromkeys(BOTH, "/oven/heater") | {"wait_timeout": 5.0} | misfit
        is_refused(sampler_of_both(start, tmp_path, **values), words)
    assert not beside.samples


def test_fields_of_installed_types_are_known() -> None:
    assert fields_of("sensor_msgs/msg/Temperature") == {
        "header": Field("std_msgs/msg/Header"),
        "temperature": Field("double"),
        "variance": Field("double"),
    }
    fields: dict[str, Any] = dict(fields_of("sensor_msgs/msg/Imu"))
    assert fields["orientation_covariance"] == Field("double", array=True, length=9)
    assert dict(fields_of("sensor_msgs/msg/JointState"))["name"] == Field(
        "string", array=True
    )
    with pytest.raises(
        MessageTypeError, match="lab_msgs/msg/Rack is not installed here"
    ):
        message_class("lab_msgs/msg/Rack")
