"""The board of the virtual rig, and interference on its serial line."""

from __future__ import annotations

import fcntl
import hashlib
import os
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twinmatch.emulation.arduino import StandInArduino
from twinmatch.emulation.arduino_pins import ArduinoError, Board
from twinmatch.emulation.arduino_virtual import VirtualArduino, VirtualTools, build_virtual_board

__all__ = ["BOARDS", "SerialNoise", "VirtualBoard", "make_board", "virtual_tools"]

BOARDS: Final = ("auto", "simavr", "python")
_PROJECT = Path(__file__).resolve().parents[3]
_BOOT = 0.5
"""Board time until it is on the bus, s."""
_WRITING = 0.05
"""Probability per burst that the other program writes to the line."""
_TAKEN = 20
"""Most bytes it takes from the line; a reply has about 25."""


class VirtualBoard(NamedTuple):
    """A board and its description."""

    board: Board
    kind: str
    """`simavr` or `python`."""
    remark: str


def make_board(wanted: str, port: Path) -> VirtualBoard:
    """A board on the bus, with its serial port at `port`.

    `simavr` runs the firmware image on a simulated processor, `python` is a stand-in, `auto` is simavr if
    available.

    Raises:
        ArduinoError: there is no such kind, or it cannot be created.
    """
    if wanted not in BOARDS:
        raise ArduinoError(f"virtual rig: board {wanted!r} does not exist; choose one of {', '.join(BOARDS)}")
    why = "as requested"
    if wanted != "python":
        try:
            board = VirtualArduino(virtual_tools(), port)
        except ArduinoError as error:
            if wanted == "simavr":
                raise
            why = str(error).splitlines()[0]
        else:
            return VirtualBoard(_on_the_bus(board), "simavr", "the firmware image on a simulated ATmega32U4")
    return VirtualBoard(_on_the_bus(StandInArduino(port)), "python", f"a stand-in, no firmware runs: {why}")


def virtual_tools() -> VirtualTools:
    """Simulator and firmware, compiled from the sources into the user's cache if necessary.

    Raises:
        ArduinoError: there are no sources, a tool is missing, or something does not compile.
    """
    if not (_PROJECT / "virtual_board" / "Makefile").exists():
        raise ArduinoError("virtual board: its sources are not installed; use a checkout of the project")
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    checkout = hashlib.sha256(str(_PROJECT).encode()).hexdigest()[:12]
    build = home / "twinmatch" / f"virtual_board-{checkout}"
    try:
        build.mkdir(parents=True, exist_ok=True)
        with (build / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # two rigs may start at once
            return build_virtual_board(_PROJECT, build)
    except OSError as error:
        raise ArduinoError(f"virtual board: it cannot be built in {build} ({error})") from error


def _on_the_bus(board: Board) -> Board:
    board.advance(_BOOT)
    if not Path(board.port).exists():
        board.close()
        raise ArduinoError(f"virtual board at {board.port}: not on the bus after {_BOOT} s")
    return board


class SerialNoise:
    """Another program on the port that ignores the lock: it writes damaged frames and takes replies away."""

    def __init__(self, port: str, seed: int = 0) -> None:
        self._port = port
        self._random = np.random.default_rng(seed)

    def burst(self) -> None:
        """Interfere once."""
        try:
            line = os.open(self._port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return  # the cable is pulled
        try:
            if self._random.random() < _WRITING:
                os.write(line, b":" + self._random.bytes(12) + b"\n")
            os.read(line, int(self._random.integers(1, _TAKEN)))
        except OSError:
            return  # nothing to take
        finally:
            os.close(line)
