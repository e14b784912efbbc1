"""The server as a process, a viewer that speaks its protocol, and publishers in the test's own process."""

from __future__ import annotations

import json
import signal
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest

pytest.importorskip(
    "foxglove", reason="foxglove-sdk is not installed; it is in the extra 'foxglove'"
)
pytest.importorskip(
    "websockets", reason="websockets is not installed; it is in the extra 'test'"
)

from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.support.processes import Process, Processes
from tests.support.waiting import wait_for

PROTOCOL = Subprotocol("foxglove.sdk.v1")


class Arrived(NamedTuple):
    """A message as the viewer was given it."""

    topic: str
    stamp: int
    data: bytes


class Viewer:
    """Speaks the WebSocket protocol of Foxglove, as its documents describe it."""

    def __init__(self, url: str) -> None:
        self._open = ExitStack()
        self._socket = self._open.enter_context(
            connect(url, subprotocols=[PROTOCOL], max_size=None)
        )
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: list[Arrived] = []
        self.times: list[int] = []
        self.sessions: list[str] = []
        self._topics: dict[int, str] = {}

    def read(self, patience: float = 0.05) -> bool:
        """Take one frame; whether there was one."""
        try:
            frame = self._socket.recv(patience)
        except TimeoutError:
            return False
        if isinstance(frame, bytes):
            self._read_data(frame)
            return True
        greeting = json.loads(frame)
        if greeting["op"] == "serverInfo":
            self.info = greeting
            self.sessions.append(greeting["sessionId"])
        elif greeting["op"] == "advertise":
            self.channels |= {
                channel["topic"]: channel for channel in greeting["channels"]
            }
        return True

    def _read_data(self, frame: bytes) -> None:
        kind = frame[0]
        if kind == 1:
            number, stamp = struct.unpack_from("<IQ", frame, 1)
            self.messages.append(Arrived(self._topics[number], stamp, frame[13:]))
        elif kind == 2:
            self.times.append(struct.unpack_from("<Q", frame, 1)[0])

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        return wait_for(condition, what, meanwhile=self.read)

    def read_for(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.read()

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics, waiting until they are offered."""
        self.wait(
            lambda: set(topics) <= set(self.channels),
            f"{topics} among {sorted(self.channels)}",
        )
        wanted = []
        for topic in topics:
            number = len(self._topics) + 1
            self._topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    @property
    def subscribed(self) -> list[str]:
        return list(self._topics.values())

    def heard(self, topic: str) -> list[Arrived]:
        return [message for message in self.messages if message.topic == topic]

    def close(self) -> None:
        self._open.close()


@pytest.fixture
def view() -> Iterator[Callable[[str], Viewer]]:
    """Open a viewer on an address."""
    opened: list[Viewer] = []

    def open_viewer(url: str) -> Viewer:
        opened.append(Viewer(url))
        return opened[-1]

    yield open_viewer
    for viewer in opened:
        viewer.close()


@pytest.fixture
def serve(ros: None, tmp_path: Path) -> Iterator[Callable[..., Process]]:  # noqa: ARG001
    """Start a server: `serve("--namespace", "/rig_a")`; it ends with the test, and cleanly."""
    processes = Processes(tmp_path / "servers")
    yield lambda *options: processes.python(
        "-m", "twinmatch.cli", "foxglove", "--port", "0", *options
    )
    ended = processes.end(signal.SIGINT)
    assert all(code == 0 and "Traceback" not in text for code, text in ended), ended
