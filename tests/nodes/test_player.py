"""Sessions played: every byte, in order, at its time, to readers that are slow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from tests.support.processes import Start
from tests.support.ros import Listener
from twinmatch.nodes.messages import sample_from
from twinmatch.nodes.player import Pace, PlayerError, class_of, playing_profile
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.sessions import Qos, Topic, read_session, write_session
from twinmatch.signals import Sample
from twinmatch_msgs.msg import LoopSample

pytestmark = pytest.mark.ros

EPOCH = 1_700_000_000_000_000_000


def counted(number: int, period: float) -> list[Sample]:
    return [
        Sample(k, EPOCH + round(k * period * 1e9), 50.0, 20.0 + k, 0.0)
        for k in range(number)
    ]


def test_every_byte_arrives(
    start_process: Start, listener: Listener, session: Path
) -> None:
    recorded = [
        message.data for message in read_session(session).messages(["/plant/sample"])
    ]
    heard: list[bytes] = []
    listener.node.create_subscription(
        LoopSample, "plant/sample", heard.append, EVERYTHING, raw=True
    )
    player = start_process("player", "-p", f"session:={session}", "-p", "rate:=0.0")
    listener.spin_until(lambda: len(heard) == len(recorded), "the last sample")
    assert heard == recorded
    assert player.wait() == 0


def test_a_session_of_the_first_form_is_played_as_one_of_today(
    start: Start, listener: Listener
) -> None:
    path = Path(__file__).resolve().parents[1] / "sessions" / "first_form"
    heard = listener.hear(LoopSample, "plant/sample", EVERYTHING)
    player = start("player", "-p", f"session:={path}", "-p", "rate:=0.0")
    samples = read_session(path).samples
    listener.spin_until(lambda: len(heard) == len(samples), "the last sample")
    assert [sample_from(message) for message in heard] == samples
    assert player.wait() == 0


def test_slow_reader_loses_nothing(
    start_process: Start, listener: Listener, tmp_path: Path
) -> None:
    """It takes nothing until the player has ended, of more samples than the middleware keeps by default."""
    samples = counted(7000, 0.1)
    path = write_session(tmp_path / "long", samples)
    heard = listener.hear(LoopSample, "plant/sample", EVERYTHING)
    player = start_process("player", "-p", f"session:={path}", "-p", "rate:=0.0")
    assert player.wait() == 0
    assert heard == []
    listener.spin_until(lambda: len(heard) == len(samples), "the last sample")
    assert [sample_from(message) for message in heard] == samples


def test_clock_goes_with_the_samples_and_pauses(
    start: Start, listener: Listener, tmp_path: Path
) -> None:
    samples = counted(21, 1.0)
    path = write_session(tmp_path / "timed", samples)
    heard = listener.hear(LoopSample, "plant/sample", EVERYTHING)
    clock = listener.hear(Clock, "/clock", QoSProfile(depth=1000))
    assert not listener.health
    client = listener.node.create_client(SetBool, "player/pause")
    player = start(
        "player", "-p", f"session:={path}", "-p", "rate:=20.0", "-p", "paused:=true"
    )
    listener.spin_until(
        lambda: clock and client.service_is_ready(), "the clock, which stands"
    )
    assert {tick.clock.sec for tick in clock} == {EPOCH // 10**9}
    listener.spin_until(lambda: listener.said("paused"), "the pause")
    assert heard == []
    answer = client.call_async(SetBool.Request(data=False))
    listener.spin_until(answer.done, "the answer")
    assert answer.result().message == "playing"
    listener.spin_until(lambda: len(heard) == len(samples), "the last sample")
    listener.spin_until(
        lambda: clock[-1].clock.sec == samples[-1].stamp // 10**9,
        "the last of the clock",
    )
    assert player.wait() == 0
    times = [tick.clock.sec * 10**9 + tick.clock.nanosec for tick in clock]
    assert times == sorted(times)
    assert set(times) >= {sample.stamp for sample in samples}
    assert max(times) == samples[-1].stamp


def test_rate_is_changed_while_it_plays(
    start: Start, listener: Listener, tmp_path: Path
) -> None:
    """At recorded speed this would take five minutes."""
    path = write_session(tmp_path / "five", counted(300, 1.0))
    heard = listener.hear(LoopSample, "plant/sample", EVERYTHING)
    assert not listener.health
    client = listener.node.create_client(SetParameters, "player/set_parameters")
    player = start("player", "-p", f"session:={path}")
    listener.spin_until(lambda: heard and client.service_is_ready(), "the first sample")

    def ask(rate: float) -> Any:
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=rate)
        request = SetParameters.Request(
            parameters=[Parameter(name="rate", value=value)]
        )
        answer = client.call_async(request)
        listener.spin_until(answer.done, "the answer")
        return answer.result().results[0]

    assert not ask(-1.0).successful
    assert not ask(1e9).successful
    assert ask(100.0).successful
    listener.spin_until(lambda: len(heard) > 50, "fifty seconds of the recording")
    assert "100" in listener.values("rate")
    assert ask(0.0).successful
    listener.spin_until(lambda: len(heard) == 300, "the last sample")
    assert player.wait() == 0


def test_the_end_is_reported_with_the_number_of_messages(
    start: Start, listener: Listener, tmp_path: Path
) -> None:
    path = write_session(tmp_path / "short", counted(20, 0.1))
    listener.hear(LoopSample, "plant/sample", EVERYTHING)
    assert not listener.health
    start("player", "-p", f"session:={path}", "-p", "rate:=1.0")
    listener.spin_until(lambda: listener.said("ended"), "the end")
    assert listener.said("ended: all 41 messages were delivered")
    assert listener.values("messages")[-1] == "41"


def test_recorded_namespace_gives_way_to_the_players(
    start: Start, listener: Listener, session: Path
) -> None:
    samples = read_session(session).samples
    heard = listener.hear(LoopSample, "/rig7/plant/sample", EVERYTHING)
    player = start(
        "player", "-r", "__ns:=/rig7", "-p", f"session:={session}", "-p", "rate:=0.0"
    )
    assert player.wait() == 0
    listener.spin_until(lambda: len(heard) == len(samples), "the last sample")


@pytest.mark.parametrize(
    "kind", ["nobody_msgs/msg/LoopSample", "twinmatch_msgs/msg/Nothing"]
)
def test_a_type_that_is_not_installed_is_named_with_its_topic(kind: str) -> None:
    with pytest.raises(
        PlayerError, match=f"player: /x: the type {kind} is not installed here"
    ):
        class_of(Topic("/x", kind, "", ""))


def test_a_topic_is_played_with_the_quality_of_service_it_was_recorded_with() -> None:
    profile = playing_profile(Qos("reliable", "transient_local", 1))
    assert (profile.durability, profile.depth) == (DurabilityPolicy.TRANSIENT_LOCAL, 1)
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    profile = playing_profile(Qos("best_effort", "volatile", 5))
    assert (profile.durability, profile.depth) == (DurabilityPolicy.VOLATILE, 1000)
    assert profile.reliability == ReliabilityPolicy.BEST_EFFORT


SECONDS = st.integers(0, 1000).map(float)
RATES = st.sampled_from([0.0, 0.5, 1.0, 2.0, 10.0])
STEPS = st.one_of(
    st.tuples(st.sampled_from(["resume", "pause"]), st.just(0.0)),
    st.tuples(st.just("change"), RATES),
    st.tuples(st.just("reach"), SECONDS),
)


@given(
    rate=RATES,
    start=SECONDS,
    story=st.lists(st.tuples(SECONDS, STEPS), max_size=20),
    due=SECONDS,
)
def test_recorded_time_passes_at_its_rate_unless_paused(
    rate: float, start: float, story: list[tuple[float, tuple[str, float]]], due: float
) -> None:
    """Without a rate it is that of the latest message played; it stands still until it is resumed."""
    pace = Pace(rate, start)
    position = start
    paused = True
    wall = 50.0
    for wait, (action, value) in story:
        wall += wait
        position += 0.0 if paused else wait * rate
        if action == "reach":
            pace.reach(value, wall)
            position = max(position, value) if rate == 0 else position
        elif action == "change":
            pace.change(value, wall)
            rate = value
        else:
            getattr(pace, action)(wall)
            paused = action == "pause"
        assert (pace.position(wall), pace.rate, pace.paused) == (position, rate, paused)
        expected_wait = None
        if not paused:
            expected_wait = 0.0 if rate == 0 else max(0.0, (due - position) / rate)
        assert pace.wait(due, wall) == expected_wait
        if expected_wait is not None and rate:
            assert pace.position(wall + expected_wait) >= due - 1e-9
