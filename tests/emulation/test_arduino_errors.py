"""Emulated boards that cannot be made, or are asked for what they cannot do."""

from __future__ import annotations

import logging
import shutil
import stat
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import boards
from tests.support.places import PROJECT
from twinmatch.emulation import arduino_virtual
from twinmatch.emulation.arduino import ArduinoError, Board, StandInArduino
from twinmatch.emulation.arduino_virtual import VirtualArduino, VirtualTools, build_virtual_board


@pytest.fixture(params=["stand-in", "simavr"])
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    made = boards.make(request.param)
    yield made
    made.close()


def program(path: Path, script: str) -> VirtualTools:
    """A simulator that is a shell script."""
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return VirtualTools(path, path)


def test_a_board_that_runs_by_itself_takes_no_steps(board: Board) -> None:
    board.run(0.1)
    with pytest.raises(ArduinoError, match="it is running"):
        board.advance(0.01)
    board.pause()
    before = board.drive().time
    assert board.advance(0.25).time == pytest.approx(before + 0.25, abs=0.002)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_time_passes_forwards(board: Board, speed: float) -> None:
    with pytest.raises(ArduinoError, match="it must be positive"):
        board.run(speed)


def test_time_passes_by_itself_while_it_runs_and_not_while_it_pauses(board: Board) -> None:
    start = board.drive().time
    board.run(5.0)
    while board.drive().time < start + 0.5:
        time.sleep(0.01)
    board.pause()
    stopped = board.drive().time
    assert board.drive().time == stopped


def test_the_port_disappears_with_the_board(tmp_path: Path) -> None:
    port = tmp_path / "ttyACM7"
    with StandInArduino(port) as stand_in:
        assert stand_in.port == str(port)
        assert port.exists()
    assert not port.is_symlink()


def test_a_stand_in_admits_to_being_one(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO), StandInArduino():
        assert "stand-in for the Arduino" in caplog.text


def test_a_stand_in_takes_nobody_elses_place(tmp_path: Path) -> None:
    place = tmp_path / "ttyACM0"
    place.write_text("mine")
    with pytest.raises(ArduinoError, match="choose another path"):
        StandInArduino(place)
    assert place.read_text() == "mine"


def test_a_missing_tool_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(shutil, "which", lambda tool: None if tool == "avr-g++" else f"/usr/bin/{tool}")
    with pytest.raises(ArduinoError, match="install gcc-avr"):
        build_virtual_board(PROJECT, tmp_path)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(shutil, "which", lambda tool: f"/usr/bin/{tool}")
    monkeypatch.setattr(arduino_virtual, "SIMAVR_HEADER", tmp_path / "nowhere.h")
    with pytest.raises(ArduinoError, match="install libsimavr-dev"):
        build_virtual_board(PROJECT, tmp_path)


def test_sources_that_do_not_compile(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make on this machine")
    (tmp_path / "firmware").mkdir()
    (tmp_path / "firmware" / "Makefile").write_text("all:\n\t@echo too bad >&2; exit 1\n")
    monkeypatch.setattr(arduino_virtual, "SIMAVR_HEADER", Path(__file__))
    monkeypatch.setattr(arduino_virtual, "TOOLS", {"make": "make"})
    with pytest.raises(ArduinoError, match="firmware does not compile:\ntoo bad"):
        build_virtual_board(tmp_path, tmp_path / "build")


def test_a_simulator_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ArduinoError, match="does not start"):
        VirtualArduino(VirtualTools(tmp_path / "nothing", tmp_path / "image.elf"))


def test_a_simulator_that_ends_at_once_is_quoted(tmp_path: Path) -> None:
    with pytest.raises(ArduinoError, match="its process has ended: no image"):
        VirtualArduino(program(tmp_path / "simulator", "echo no image >&2"))


def test_an_invalid_image(tmp_path: Path) -> None:
    parts = boards.tools()
    if isinstance(parts, str):
        pytest.skip(parts)
    with pytest.raises(ArduinoError, match="its process has ended"):
        VirtualArduino(VirtualTools(parts.program, tmp_path / "no.elf"))


def test_a_simulator_that_ends_later(tmp_path: Path) -> None:
    made = VirtualArduino(program(tmp_path / "simulator", "echo state 0 0 0 800 0 0 1; read line"))
    with pytest.raises(ArduinoError, match="its process has ended"):
        made.advance(0.1)
    with pytest.raises(ArduinoError, match="its process has ended"):
        made.drive()
    made.close()


def test_a_simulator_of_another_version(tmp_path: Path) -> None:
    tools = program(tmp_path / "simulator", "echo state 0 0 0 800 0 0 1; read line; echo error; read line")
    with VirtualArduino(tools) as made, pytest.raises(ArduinoError, match="it refused a command"):
        made.hang()
