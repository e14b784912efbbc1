"""The server alone, looked at by a real client of the protocol, and the time that viewers are sent."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from twinmatch.showing.foxglove.node import BACKLOG, GraphServer, StreamTime
from twinmatch.showing.serving import ServingError, is_loopback

TEXT = "float64 data\n"


@pytest.fixture
def server() -> Iterator[GraphServer]:
    made = GraphServer("rig", "127.0.0.1", 0)
    yield made
    made.close()


def number(value: float) -> bytes:
    """A std_msgs/Float64 in CDR."""
    return b"\x00\x01\x00\x00" + struct.pack("<d", value)


def test_a_topic_is_offered_with_its_definition_and_its_bytes_arrive_as_they_were(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
    server.advertise("/a", "std_msgs/msg/Float64", TEXT)
    viewer = view(server.url)
    viewer.subscribe("/a")
    channel = viewer.channels["/a"]
    assert channel["encoding"] == "cdr"
    assert channel["schemaEncoding"] == "ros2msg"
    assert channel["schemaName"] == "std_msgs/msg/Float64"
    assert channel["schema"] == TEXT
    viewer.wait(lambda: server.viewers == 1, "the subscription")
    server.send("/a", number(1.5), 123)
    viewer.wait(lambda: viewer.messages, "the message")
    assert viewer.messages == [("/a", 123, number(1.5))]


def test_nothing_can_be_sent_through_it(server: GraphServer, view: Callable[[str], Any]) -> None:
    viewer = view(server.url)
    viewer.wait(lambda: viewer.info, "the server's greeting")
    assert viewer.info["capabilities"] == ["time"]


def test_a_late_subscriber_is_given_the_newest_message_and_no_other_is(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
    server.advertise("/a", "std_msgs/msg/Float64", TEXT)
    first = view(server.url)
    first.subscribe("/a")
    first.wait(lambda: server.viewers == 1, "the subscription")
    server.send("/a", number(1.0), 10)
    server.send("/a", number(2.0), 20)
    second = view(server.url)
    second.subscribe("/a")
    second.wait(lambda: second.messages, "the newest message")
    first.read_for(0.3)
    assert second.messages == [("/a", 20, number(2.0))]
    assert [message.at for message in first.messages] == [10, 20]
    server.forget("/a")
    third = view(server.url)
    third.subscribe("/a")
    third.wait(lambda: server.viewers == 3, "the subscription")
    third.read_for(0.3)
    assert not third.messages


def test_another_kind_of_time_is_another_session_that_begins_with_what_was_said_last(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
    server.advertise("/a", "std_msgs/msg/Float64", TEXT)
    viewer = view(server.url)
    viewer.subscribe("/a")
    viewer.wait(lambda: server.viewers == 1, "the subscription")
    server.send("/a", number(1.0), 10)
    server.reset(5)
    viewer.wait(lambda: len(set(viewer.sessions)) == 2 and viewer.times, "another session")
    assert viewer.times == [5]
    server.repeat(5)
    viewer.wait(lambda: len(viewer.messages) == 2, "the message again")
    assert viewer.messages[-1] == ("/a", 5, number(1.0))


def test_a_viewer_that_does_not_keep_up_loses_the_oldest_and_holds_nobody_back(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
    server.advertise("/a", "std_msgs/msg/Float64", TEXT)
    viewer = view(server.url)
    viewer.subscribe("/a")
    viewer.wait(lambda: server.viewers == 1, "the subscription")
    many = 3 * BACKLOG
    for k in range(many):
        server.send("/a", number(k) + bytes(20_000), k)
    viewer.wait(lambda: viewer.messages and viewer.messages[-1].at == many - 1, "the newest message")
    stamps = [message.at for message in viewer.messages]
    assert stamps == sorted(stamps)
    assert len(stamps) < many


def test_a_port_that_is_taken_is_one_clear_line(server: GraphServer) -> None:
    port = int(server.url.rsplit(":", 1)[1])
    line = (
        rf"^foxglove: 127\.0\.0\.1:{port} cannot be used: Address already in use; choose another with --port"
    )
    with pytest.raises(ServingError, match=line):
        GraphServer("rig", "127.0.0.1", port)


def test_an_address_of_another_machine_is_one_clear_line() -> None:
    with pytest.raises(ServingError, match=r"203\.0\.113\.7:8765 cannot be used: Cannot assign"):
        GraphServer("rig", "203.0.113.7", 8765)


@pytest.mark.parametrize(
    ("address", "loopback"),
    [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("rig", False)],
)
def test_which_addresses_are_this_machines_own(address: str, loopback: bool) -> None:
    assert is_loopback(address) == loopback


def test_without_a_clock_it_is_that_of_the_wall() -> None:
    stream = StreamTime()
    assert not stream.on_sample(1.0, clock=False)
    assert abs(stream.now - time.time_ns()) < 10**10


def test_with_one_it_is_that_of_the_plant() -> None:
    stream = StreamTime()
    assert stream.on_clock(7, 1.0)
    assert not stream.on_clock(8, 1.1)
    assert stream.now == 8


def test_after_the_end_of_a_clock_it_stands_until_another_graph_has_samples() -> None:
    stream = StreamTime()
    stream.on_clock(7, 1.0)
    assert not stream.on_sample(2.0, clock=False)  # still on its way when the clock ended
    assert not stream.on_sample(9.0, clock=True)  # the clock is there but slow
    assert stream.now == 7
    assert stream.on_sample(9.0, clock=False)
    assert stream.now > 10**18
