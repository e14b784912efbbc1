"""Which topics are recorded and how; rates and silence. No ROS graph needed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from twinmatch.nodes.recorder import Arrivals
from twinmatch.nodes.topics import offered, profile_of, wanted
from twinmatch.sessions import Qos

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("name", "namespace", "expected"),
    [
        ("/plant/sample", "/", True),
        ("/one/plant/sample", "/one", True),
        ("/one/plant/sample", "/", True),
        ("/two/plant/sample", "/one", False),
        ("/onesie/plant/sample", "/one", False),
        ("/clock", "/", False),
        ("/rosout", "/", False),
        ("/_hidden/topic", "/", False),
        ("/diagnostics", "/one", True),
        ("/thermal/image", "/", False),
    ],
)
def test_topics_are_chosen(name, namespace, expected):
    assert wanted(name, namespace, ["/diagnostics"], ["thermal/"]) is expected


def endpoint(reliable=True, latched=False, depth=10):
    return SimpleNamespace(
        qos_profile=SimpleNamespace(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
    )


@pytest.mark.parametrize(
    ("endpoints", "qos"),
    [
        ([endpoint()], Qos("reliable", "volatile", 10)),
        ([endpoint(reliable=False, depth=5)], Qos("best_effort", "volatile", 5)),
        ([endpoint(latched=True, depth=0)], Qos("reliable", "transient_local", 1)),
        ([endpoint(latched=True), endpoint(depth=20)], Qos("reliable", "volatile", 20)),
        ([endpoint(), endpoint(reliable=False)], Qos("best_effort", "volatile", 10)),
    ],
)
def test_the_weakest_offer_is_taken(endpoints, qos):
    assert offered(endpoints) == qos
    profile = profile_of(qos)
    for one in endpoints:  # a reader that asks for more than is offered receives nothing
        assert profile.reliability == ReliabilityPolicy.BEST_EFFORT or (
            one.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        )
        assert profile.durability == DurabilityPolicy.VOLATILE or (
            one.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        )


@given(st.floats(0.01, 1.0), st.integers(10, 100))
def test_a_rhythm_is_silent_when_it_stops(interval, count):
    arrivals = Arrivals()
    for k in range(count):
        arrivals.push(k * interval)
        assert not arrivals.silent(k * interval + interval)
    assert arrivals.rate == pytest.approx(1 / interval)
    last = (count - 1) * interval
    assert not arrivals.silent(last + max(3.0, 10 * interval) - 0.01)
    assert arrivals.silent(last + max(3.0, 10 * interval) + 0.01)


def test_what_comes_now_and_then_is_never_silent():
    arrivals = Arrivals()
    assert not arrivals.silent(1e9)
    for k in range(9):
        arrivals.push(float(k))
    assert not arrivals.silent(1e9)


def test_lost_messages_are_shown():
    arrivals = Arrivals()
    arrivals.push(0.0)
    arrivals.push(0.5)
    assert arrivals.text() == "2.0 Hz, 2 messages"
    arrivals.lost = 3
    assert arrivals.text() == "2.0 Hz, 2 messages, 3 lost"
