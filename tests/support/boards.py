"""Boards for the tests: the stand-in, the simulated processor, and a real one if there is one.

`TWINMATCH_SERIAL=/dev/ttyACM0` adds a real board; what needs a look at its pins or a hand on its cable is
skipped there. Its motor supply should be off.
"""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Callable
from functools import cache
from typing import NoReturn, TypeVar

import pytest

from twinmatch.emulation.arduino import (
    ArduinoError,
    EmulatedBoard,
    PinDrive,
    StandInArduino,
)
from twinmatch.emulation.arduino_virtual import (
    VirtualArduino,
    VirtualTools,
    virtual_tools,
)
from twinmatch.links.pwm_protocol import (
    BoardStatus,
    FrameReader,
    Reply,
    parse_reply,
    seal,
)

REAL = os.environ.get("TWINMATCH_SERIAL")
KINDS = ["stand-in", "simavr", *(["real"] if REAL else [])]

R = TypeVar("R", bound=Reply)


@cache
def tools() -> VirtualTools | str:
    """The virtual board's parts, or why there are none; compiled where virtual rigs compile them."""
    try:
        return virtual_tools()
    except ArduinoError as error:
        return str(error)


def make(kind: str) -> Board:
    """A board of a kind, switched on and on the bus."""
    if kind == "real":
        return RealBoard(str(REAL))
    if kind == "stand-in":
        return StandIn()
    parts = tools()
    if isinstance(parts, str):
        pytest.skip(parts)
    board = Simulated(parts)
    board.advance(0.1)
    return board


class Paced(EmulatedBoard):
    """A board whose time passes by itself, if asked; what a busy machine delays is lost, not caught up."""

    _thread: threading.Thread | None = None

    def run(self, speed: float = 1.0) -> None:
        """Let time pass `speed` times as fast as the wall clock."""
        self.pause()
        self._paused = threading.Event()
        self._thread = threading.Thread(
            target=self._pace, args=(speed, self._paused), daemon=True
        )
        self._thread.start()

    def pause(self) -> None:
        """Let time stand still."""
        if self._thread is not None:
            self._paused.set()
            self._thread.join()
        self._thread = None

    def close(self) -> None:
        self.pause()
        super().close()

    def _pace(self, speed: float, paused: threading.Event) -> None:
        step = max(1, round(2 * speed)) / 1000
        while not paused.wait(step / speed):
            self.advance(step)


class StandIn(Paced, StandInArduino):
    """The stand-in."""


class Simulated(Paced, VirtualArduino):
    """The simulated processor."""


class RealBoard(Paced):
    """A board on the desk: its time is ours, its pins are out of sight."""

    def advance(self, seconds: float) -> PinDrive:
        time.sleep(seconds)
        return PinDrive(time.monotonic(), float("nan"), enabled=False)

    def run(self, speed: float = 1.0) -> None:
        if speed != 1.0:
            self._skip()

    def _skip(self, *_: object) -> NoReturn:
        pytest.skip("needs an emulated board")

    drive = set_current = set_fault = unplug = plug = hang = _skip


Board = StandIn | Simulated | RealBoard


class Wire:
    """The serial port by hand, in step with the board's time."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.descriptor = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.descriptor)
        self._reader = FrameReader()
        board.advance(0.03)  # the host's greeting on the control pipe

    def send(self, data: bytes) -> None:
        """Write bytes as they are."""
        while data:
            try:
                data = data[os.write(self.descriptor, data) :]
            except BlockingIOError:
                self.board.advance(0.001)

    def heard(self) -> list[Reply]:
        """The replies that have come since the last look."""
        try:
            data = os.read(self.descriptor, 4096)
        except BlockingIOError:
            return []
        replies = [
            parse_reply(e) for e in self._reader.feed(data) if isinstance(e, bytes)
        ]
        assert None not in replies
        return [r for r in replies if r is not None]

    def wait(self, wanted: Callable[[Reply], bool]) -> Reply:
        """Let time pass until a wanted reply comes."""
        for _ in range(200):
            for reply in self.heard():
                if wanted(reply):
                    return reply
            self.board.advance(0.001)
        pytest.fail("no reply within 200 ms of the board's time")

    def ask(self, payload: str) -> Reply:
        """Send a request and let time pass until its reply."""
        sequence = int(payload.split()[1])
        self.send(seal(payload))
        return self.wait(lambda reply: reply.sequence == sequence)

    def status(self, payload: str) -> BoardStatus:
        """Ask for what is answered by a status."""
        reply = self.ask(payload)
        assert isinstance(reply, BoardStatus), reply
        return reply

    def ready(self) -> None:
        """Greet and clear, with the numbers 0 and 1."""
        self.ask("H 0")
        assert self.status("C 1").flags == 0

    def close(self) -> None:
        """Close the port."""
        os.close(self.descriptor)
