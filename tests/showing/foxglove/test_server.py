"""The server alone, looked at by a real client of the protocol, and the time that viewers are sent."""

from __future__ import annotations

import importlib
import json
import re
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from twinmatch.showing.foxglove.node import BACKLOG, GraphServer, StreamTime
from twinmatch.showing.foxglove.relay import MAX_TOLD, Relay, hidden_address
from twinmatch.showing.serving import Hosts, ServingError

pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from tests.showing.foxglove.conftest import PROTOCOL
from tests.support.odd_requests import odd_requests
from tests.support.places import PROJECT
from tests.support.processes import Processes
from tests.support.sockets import UPGRADE, ask, exchange
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.plants import Peltier, TCLabBoth
from twinmatch.plants.records import description_of
from twinmatch.showing.foxglove.layout import APPLIED, IMAGE, OUTSIDE, TOPICS, layout

TEXT = "float64 data\n"


@pytest.fixture
def server() -> Iterator[GraphServer]:
    opened = GraphServer("rig", "127.0.0.1", 0)
    yield opened
    opened.close()


def number(value: float) -> bytes:
    """A std_msgs/Float64 in CDR."""
    return b"\x00\x01\x00\x00" + struct.pack("<d", value)


def test_a_topic_is_offered_with_its_definition_and_its_bytes_arrive_as_they_were(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
    server.advertise("/a", "std_msgs/msg/Float64", TEXT)
    viewer = view(server.url)
    viewer.subscribe("/a")
    offer = {
        "encoding": "cdr",
        "schemaEncoding": "ros2msg",
        "schemaName": "std_msgs/msg/Float64",
        "schema": TEXT,
    }
    assert viewer.channels["/a"].items() >= offer.items()
    viewer.wait(lambda: server.viewers == 1, "the subscription")
    server.send("/a", number(1.5), 123)
    viewer.wait(lambda: viewer.messages, "the message")
    assert viewer.messages == [("/a", 123, number(1.5))]


def test_nothing_can_be_sent_through_it(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
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
    assert [message.stamp for message in first.messages] == [10, 20]
    server.forget("/a")
    third = view(server.url)
    third.subscribe("/a")
    third.wait(lambda: server.viewers == 3, "the subscription")
    third.read_for(0.3)
    assert not third.messages


SLOW_SERVER = """
import os, threading, time
from twinmatch.showing.foxglove.node import GraphServer

class Counting(GraphServer):
    count = 0

    def on_subscribe(self, client, channel):
        self.count += 1

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
server = Counting("rig", "127.0.0.1", 0)
os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
print(f"server: {server.url}", flush=True)
server.advertise("/first", "std_msgs/msg/Float64", "float64 data")
while not server.count:
    time.sleep(0.01)
for number in range(60):
    server.advertise(f"/{number}", "std_msgs/msg/Float64", "float64 data")
    time.sleep(0.01)
while server.count < 61:
    time.sleep(0.01)
print("all subscribed", flush=True)
time.sleep(1000)
"""
"""It has one processor, and its thread that advertises steps back for all others."""

QUICK_VIEWER = """
import json, sys
from websockets.sync.client import connect

with connect(sys.argv[1], subprotocols=["foxglove.sdk.v1"]) as socket:
    for frame in socket:
        message = json.loads(frame) if isinstance(frame, str) else {}
        for channel in message.get("channels", []):
            wanted = {"id": channel["id"], "channelId": channel["id"]}
            socket.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
        if message.get("op") == "status":
            print("refused", message["message"], flush=True)
"""
"""A viewer that subscribes to whatever is advertised, at once."""


def test_a_viewer_that_subscribes_at_once_is_not_refused(tmp_path: Path) -> None:
    """One topic in five was refused as unknown here while it was offered before it was there."""
    processes = Processes(tmp_path)
    server = processes.start(sys.executable, "-c", SLOW_SERVER)
    viewer = processes.start(sys.executable, "-c", QUICK_VIEWER, server.url)
    wait_for(
        lambda: "refused" in viewer.text or "all subscribed" in server.text,
        lambda: f"subscriptions: {server.text} {viewer.text}",
    )
    processes.dismiss()
    assert viewer.text == ""


def test_what_is_held_back_reaches_the_viewers_afterwards() -> None:
    bound = socket.create_server(("127.0.0.1", 0))
    address = bound.getsockname()
    with socket.create_server(("127.0.0.1", 0)) as inner:
        relay = Relay(bound, Hosts.of("127.0.0.1"), inner.getsockname())
        with socket.create_connection(address) as viewer:
            viewer.sendall(
                f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{address[1]}\r\n\r\n".encode()
            )
            behind, _ = inner.accept()
            viewer.settimeout(0.3)
            with behind:
                assert behind.recv(1 << 14).startswith(b"GET /")
                with relay.holding_back():
                    behind.sendall(b"news")
                    with pytest.raises(TimeoutError):
                        viewer.recv(4)
                viewer.settimeout(PATIENCE)
                assert viewer.recv(4) == b"news"
        assert relay.close()


def test_another_kind_of_time_is_another_session_that_begins_with_what_was_said_last(
    server: GraphServer, view: Callable[[str], Any]
) -> None:
    server.advertise("/a", "std_msgs/msg/Float64", TEXT)
    viewer = view(server.url)
    viewer.subscribe("/a")
    viewer.wait(lambda: server.viewers == 1, "the subscription")
    server.send("/a", number(1.0), 10)
    server.reset(5)
    viewer.wait(
        lambda: len(set(viewer.sessions)) == 2 and viewer.times, "another session"
    )
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
    viewer.wait(
        lambda: viewer.messages and viewer.messages[-1].stamp == many - 1,
        "the newest message",
    )
    stamps = [message.stamp for message in viewer.messages]
    assert stamps == sorted(stamps)
    assert len(stamps) < many


@pytest.mark.parametrize(
    ("name", "origin", "let_in"),
    [
        ("", None, True),
        ("localhost:8765", None, True),
        ("", "http://localhost:8080", True),
        ("", "file://", True),
        ("", "https://viewer.example", True),
        ("evil.example", None, False),
        ("evil.example:8765", "http://evil.example:8765", False),
        ("", "http://evil.example", False),
        ("", "null", False),
        ("192.0.2.1", None, False),
    ],
)
def test_a_foreign_name_or_page_is_refused(
    name: str, origin: str | None, let_in: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    server = GraphServer(
        "rig", "127.0.0.1", 0, Hosts.of("127.0.0.1", ["viewer.example"])
    )
    headers = (
        *UPGRADE,
        f"Sec-WebSocket-Protocol: {PROTOCOL}",
        *([f"Origin: {origin}"] if origin else []),
    )
    for _ in range(3):
        status, why = ask(server.url, "/", *headers, host=name or None)
        assert status == (101 if let_in else 403)
        assert ("--host" in why) == (not let_in)
    server.close()
    assert capsys.readouterr().out == ("" if let_in else f"foxglove: refused: {why}")


def test_what_is_behind_it_has_an_address_that_no_page_can_guess(
    server: GraphServer,
) -> None:
    assert server.url.startswith("ws://127.0.0.1:")
    assert len({hidden_address() for _ in range(50)}) == 50
    with socket.socket() as elsewhere:  # nothing of the SDK listens there
        elsewhere.bind(("127.0.0.2", int(server.url.rsplit(":", 1)[1])))


def test_odd_requests_end_nothing_and_print_nothing_but_refusals(
    server: GraphServer, view: Callable[[str], Any], capfd: pytest.CaptureFixture[str]
) -> None:
    for k, request in enumerate(odd_requests(seed=28, count=500)):
        answer = exchange(server.url, request)
        assert answer == b"" or answer[9:10] in b"14", (k, request, answer)
    viewer = view(server.url)
    viewer.wait(lambda: viewer.info, "the server's greeting")
    printed = capfd.readouterr()
    assert printed.err == ""
    assert 0 < len(printed.out.splitlines()) <= MAX_TOLD
    assert all(
        line.startswith("foxglove: refused: ") and line.isprintable()
        for line in printed.out.splitlines()
    )


def test_a_port_that_is_taken_is_one_clear_line(server: GraphServer) -> None:
    port = int(server.url.rsplit(":", 1)[1])
    line = rf"^foxglove: 127\.0\.0\.1:{port} cannot be used: Address already in use; choose another with --port"
    with pytest.raises(ServingError, match=line):
        GraphServer("rig", "127.0.0.1", port)


def test_time_is_that_of_the_clock_and_stands_after_it_until_another_graph_has_samples() -> (
    None
):
    stream = StreamTime()
    assert not stream.on_sample(0.5, clock=False)
    # without a clock it is that of the wall
    assert abs(stream.now - time.time_ns()) < 10**10
    assert stream.on_clock(6, 0.9)
    assert not stream.on_clock(7, 1.0)
    # still on its way when the clock ended
    assert not stream.on_sample(2.0, clock=False)
    assert not stream.on_sample(9.0, clock=True)  # the clock is there but slow
    assert stream.now == 7
    assert stream.on_sample(9.0, clock=False)
    assert stream.now > 10**18


# The layout that is shipped and the topics that are offered: every name exists and its kind fits.


LAYOUT = json.loads((PROJECT / "config" / "foxglove_layout.json").read_text("utf-8"))
PANELS: dict[str, Any] = LAYOUT["configById"]
KINDS = {f"/{name}": kind for name, kind in TOPICS.items()} | OUTSIDE
NUMBER = re.compile(r"double|float|u?int(8|16|32|64)|boolean")


def field_type(path: str) -> str:
    """ROS type of what a message path leads to; fails if it leads nowhere."""
    topic = path.split(".", maxsplit=1)[0]
    kind = KINDS[topic].replace("/msg/", "/")
    for name in path.removeprefix(topic).strip(".").split("."):
        name, _, element = name.partition("[")  # noqa: PLW2901
        if name:
            package, short = re.sub(r"^sequence<|>$|\[\d*\]$", "", kind).split("/")
            message = getattr(importlib.import_module(f"{package}.msg"), short)
            kind = message.get_fields_and_field_types()[name]
        if element:
            kind = kind.removeprefix("sequence<").removesuffix(">")
    return kind


def panels(kind: str) -> list[dict[str, Any]]:
    configs = [config for name, config in PANELS.items() if name.startswith(f"{kind}!")]
    assert configs
    return configs


def placed(node: Any, panels: dict[str, Any] = PANELS) -> Iterator[str]:
    """Panels in a mosaic, those in its tabs included."""
    if isinstance(node, str):
        yield node
        for tab in panels[node].get("tabs", []):
            yield from placed(tab["layout"], panels)
    else:
        assert node["direction"] in {"row", "column"}
        yield from placed(node["first"], panels)
        yield from placed(node["second"], panels)


def test_the_shipped_layout_is_the_one_of_its_plant() -> None:
    """A change of the layout or of the plant's words has to be written into the file that is shipped."""
    assert layout(description_of(Peltier), (APPLIED, IMAGE)) == LAYOUT


def test_every_panel_has_its_place() -> None:
    assert sorted(placed(LAYOUT["layout"])) == sorted(PANELS)


@pytest.mark.parametrize("loops", [2, 6])
def test_a_plant_with_several_loops_has_a_column_of_charts_for_each(loops: int) -> None:
    """Four are side by side, and more below."""
    two = description_of(TCLabBoth)
    kinds = {}
    for kind in ("references", "outputs", "inputs"):
        (first, *_) = getattr(two, kind)
        kinds[kind] = tuple(replace(first, text=f"{kind} {k}") for k in range(loops))
    arranged = layout(replace(two, **kinds))
    panels = arranged["configById"]
    places = arranged["layout"]
    assert sorted(placed(places, panels)) == sorted(panels)
    for k in range(loops):
        ending = f"_{k + 1}" if k else ""
        assert panels[f"Plot!output{ending}"]["yAxisLabel"] == f"outputs {k} / °C"
        assert panels[f"Plot!input{ending}"]["yAxisLabel"] == f"inputs {k} / %"
        paths = [path["value"] for path in panels[f"Plot!residuals{ending}"]["paths"]]
        assert paths == [
            f"/twin/state.{name}[{k}]"
            for name in ("closed_residual_y", "driven_residual_y", "driven_rms_y")
        ]
    charts = places["first"]
    shares = []
    if loops > 4:
        assert (charts["direction"], charts["splitPercentage"]) == ("column", 50)
        charts = charts["first"]
    while charts["direction"] == "row":
        shares.append(charts["splitPercentage"])
        charts = charts["second"]
    assert shares == [50] if loops == 2 else [25, 33, 50]


def test_what_is_plotted_is_a_number_with_a_stamp_and_a_colour_of_its_own() -> None:
    for panel in panels("Plot"):
        for path in panel["paths"]:
            assert NUMBER.fullmatch(field_type(path["value"])), path
            assert (
                field_type(path["value"].split(".")[0] + ".header") == "std_msgs/Header"
            )
            assert path["enabled"]
            assert path["timestampMethod"] == "headerStamp"
        if panel["xAxisVal"] == "currentCustom":
            # the newest message over one of its own lists
            assert NUMBER.fullmatch(field_type(panel["xAxisPath"]["value"])), panel
        assert len({path["color"] for path in panel["paths"]}) == len(panel["paths"])


def test_the_plots_show_plant_twin_set_point_control_and_residuals() -> None:
    shown = {path["value"] for panel in panels("Plot") for path in panel["paths"]}
    measured = {f"/plant/sample.{name}[0]" for name in ("output", "reference", "input")}
    twin = {
        f"/twin/state.{name}[0]"
        for name in ("closed_output", "driven_residual_y", "closed_residual_u")
    }
    assert (
        measured | twin | {"/twin/forecast.output_low[:]", "/twin/forecast.input[:]"}
        <= shown
    )


def test_the_other_panels_look_at_what_there_is() -> None:
    assert [panel["imageMode"]["imageTopic"] for panel in panels("Image")] == [
        "/thermal/image"
    ]
    assert KINDS["/thermal/image"] == "sensor_msgs/msg/Image"
    for panel in panels("StateTransitions"):
        assert all(field_type(path["value"]) == "string" for path in panel["paths"])
    for panel in panels("RawMessages"):
        assert panel["topicPath"] in KINDS
    for panel in panels("Table"):
        assert field_type(panel["topicPath"]).startswith("sequence<twinmatch_msgs/")
    for panel in [*panels("DiagnosticSummary"), *panels("DiagnosticStatusPanel")]:
        assert KINDS[panel["topicToRender"]] == "diagnostic_msgs/msg/DiagnosticArray"


def test_the_light_knows_every_level() -> None:
    from twinmatch.comparing import TrustLevel

    [light] = panels("Indicator")
    assert field_type(light["path"]) == "string"
    assert {rule["rawValue"] for rule in light["rules"]} == {
        level.value for level in TrustLevel
    }


def test_the_topics_are_those_of_the_subscribers_page() -> None:
    page = (PROJECT / "docs" / "subscribing.md").read_text("utf-8")
    documented = dict(re.findall(r"^\| `(\S+)` \| `(\w+/\w+)` \|", page, re.MULTILINE))
    offered = {
        name: kind.replace("/msg/", "/") for name, kind in (TOPICS | OUTSIDE).items()
    }
    assert documented.items() - {
        ("/clock", "rosgraph_msgs/Clock")
    } == offered.items() - {("/rosout", "rcl_interfaces/Log")}
