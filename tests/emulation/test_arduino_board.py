"""The same stories against every board: it keeps what it promises. Times are the board's own."""

from __future__ import annotations

import logging
import os
import shutil
import stat
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import boards
from tests.support.boards import Board, Wire
from tests.support.damage import damaged_lines
from tests.support.places import PROJECT
from twinmatch.emulation import arduino_virtual
from twinmatch.emulation.arduino import ArduinoError, StandInArduino
from twinmatch.emulation.arduino_virtual import (
    VirtualArduino,
    VirtualTools,
    build_virtual_board,
)
from twinmatch.links.pwm_link import AMPERES_PER_COUNT
from twinmatch.links.pwm_protocol import (
    PROTOCOL,
    Banner,
    BoardStatus,
    Code,
    Flags,
    Refusal,
    seal,
)

FUZZ = int(os.environ.get("TWINMATCH_FUZZ", "2000"))
DEADLINE = 1.0
TICK = 0.001


@pytest.fixture(params=boards.KINDS)
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    opened = boards.make(request.param)
    yield opened
    opened.close()


@pytest.fixture
def wire(board: Board) -> Iterator[Wire]:
    opened = Wire(board)
    yield opened
    opened.close()


def seconds_until_off(board: Board, limit: float) -> float:
    """Time from now to the millisecond in which the driver goes off."""
    start = board.drive().time
    while (drive := board.advance(TICK)).enabled:
        assert drive.time - start < limit, f"still on after {limit} s"
    return drive.time - start


def test_it_says_who_it_is(wire: Wire) -> None:
    banner = wire.ask("H 7")
    assert isinstance(banner, Banner)
    assert banner.protocol == PROTOCOL
    assert banner.deadline_ms == DEADLINE * 1000
    assert banner.firmware.removeprefix("standin-") == "1.1.0"


def test_it_starts_off_and_latched(board: Board, wire: Wire) -> None:
    assert not board.drive().enabled
    wire.ask("H 0")
    assert wire.ask("P 1 50") == Refusal(1, Code.LATCHED)
    assert wire.status("Q 2").flags & (Flags.TRIPPED | Flags.ENABLED) == Flags.TRIPPED
    assert not board.drive().enabled


@pytest.mark.parametrize("pwm", [1, -1, 2, 127, -128, 254, -255, 255])
def test_a_set_point_reaches_the_pins(board: Board, wire: Wire, pwm: int) -> None:
    wire.ready()
    status = wire.status(f"P 2 {pwm}")
    assert (status.applied, status.flags) == (pwm, Flags.ENABLED)
    drive = board.drive()
    assert drive.enabled
    # The timer has 800 counts for 255 steps: half a count is 0.16 of a step.
    assert drive.pwm == pytest.approx(pwm, abs=0.5 * 255 / 800 + 1e-9)


def test_zero_is_on_and_braking(board: Board, wire: Wire) -> None:
    wire.ready()
    wire.status("P 2 99")
    assert wire.status("P 3 0").applied == 0
    assert board.drive()[1:] == (0.0, True)


def test_silence_trips_at_the_deadline_and_the_trip_stays_until_cleared(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    wire.send(seal("P 2 200"))
    for _ in range(10):
        if board.advance(TICK).enabled:
            break
    took = seconds_until_off(board, limit=DEADLINE + 0.05)
    assert took == pytest.approx(DEADLINE, abs=0.003)
    assert board.drive().pwm == 0
    board.advance(2)
    assert wire.status("Q 3").flags == Flags.TRIPPED | Flags.DEADLINE
    assert wire.ask("P 4 10") == Refusal(4, Code.LATCHED)
    assert not board.drive().enabled
    assert wire.status("C 5").flags == 0
    assert wire.status("P 6 10").applied == 10


@pytest.mark.parametrize("repeat", ["Q 3", "P 2 9", "P 1 9"])
def test_the_deadline_passes_by_the_boards_own_word(
    board: Board, wire: Wire, repeat: str
) -> None:
    wire.ready()
    wire.status("P 2 9")
    board.advance(0.8)
    assert wire.status(repeat).applied == 9
    board.advance(0.3)
    status = wire.status("Q 4")
    assert (status.applied, status.flags) == (0, Flags.TRIPPED | Flags.DEADLINE)
    assert wire.ask("P 5 9") == Refusal(5, Code.LATCHED)
    assert wire.status("C 6").flags == 0


def test_new_set_points_keep_it_alive(board: Board, wire: Wire) -> None:
    wire.ready()
    for sequence in range(2, 5):
        assert wire.status(f"P {sequence} 77").applied == 77
        board.advance(0.9 * DEADLINE)
    assert wire.status("Q 9").applied == 77


def test_repeated_set_points_are_answered_but_do_not_feed_the_deadline(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    wire.status("P 2 200")
    start = board.drive().time
    for _ in range(8):
        board.advance(0.1)
        repeated = wire.status("P 2 100")
        assert repeated.applied == 200
        assert repeated.flags & Flags.DUPLICATE
    assert wire.status("P 1 33").flags & Flags.DUPLICATE  # an older one does no better
    assert (
        board.drive().time - start + seconds_until_off(board, limit=0.3)
        <= DEADLINE + 0.003
    )


@pytest.mark.parametrize("question", ["Q 2", "X 2", "P 2 256", "P 2 nan"])
def test_nothing_else_feeds_the_deadline(
    board: Board, wire: Wire, question: str
) -> None:
    wire.ready()
    wire.status("P 2 200")
    start = board.drive().time
    for _ in range(9):
        board.advance(0.1)
        wire.ask(question.replace("2", "5", 1))
    assert (
        board.drive().time - start + seconds_until_off(board, limit=0.2)
        <= DEADLINE + 0.003
    )


def test_a_greeting_lets_go_of_the_output(board: Board, wire: Wire) -> None:
    wire.ready()
    wire.status("P 2 200")
    wire.ask("H 40000")
    assert not board.drive().enabled
    assert wire.status("P 40001 5").applied == 5


def test_sequence_numbers_go_around(wire: Wire) -> None:
    wire.ask("H 65534")
    wire.status("C 65535")
    assert wire.status("P 0 5").flags == Flags.ENABLED
    assert wire.status("P 65535 9").flags & Flags.DUPLICATE


def test_an_old_clear_does_not_clear(board: Board, wire: Wire) -> None:
    wire.ready()
    wire.status("P 2 200")
    board.advance(1.2)
    assert wire.status("C 1").flags == Flags.TRIPPED | Flags.DEADLINE | Flags.DUPLICATE


@pytest.mark.parametrize("pwm", [200, -200])
def test_a_change_of_direction_passes_through_zero(
    board: Board, wire: Wire, pwm: int
) -> None:
    wire.ready()
    wire.status(f"P 2 {pwm}")
    wire.send(seal(f"P 3 {-pwm}"))
    drives = [board.drive().pwm]
    while drives[-1] * pwm >= 0:
        drives.append(board.advance(TICK).pwm)
        assert len(drives) < 20
    assert 0.0 in drives
    assert drives[drives.index(0.0) :].count(0.0) >= 2
    assert drives[-1] == pytest.approx(-pwm, abs=0.16)


def test_a_driver_fault_trips_and_tells(board: Board, wire: Wire) -> None:
    wire.ready()
    wire.status("P 2 200")
    board.advance(0.05)
    board.set_fault(True)
    assert seconds_until_off(board, limit=0.02) >= 0.003
    board.set_fault(False)
    assert wire.status("Q 3").flags == Flags.TRIPPED | Flags.DRIVER
    assert wire.ask("P 4 200") == Refusal(4, Code.LATCHED)
    wire.status("C 5")
    assert wire.status("P 6 200").applied == 200


def test_a_lasting_fault_trips_again_after_clearing(board: Board, wire: Wire) -> None:
    wire.ready()
    board.set_fault(True)
    wire.status("P 2 200")
    seconds_until_off(board, limit=0.03)
    assert wire.status("Q 3").flags & Flags.DRIVER


def test_the_low_flag_of_a_driver_that_is_off_is_not_a_fault(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    board.set_fault(True)
    board.advance(0.5)
    board.set_fault(False)
    assert wire.status("Q 2").flags == 0


@pytest.mark.parametrize("amperes", [0.0, 0.5, 2.0, 4.9])
def test_current_is_measured(board: Board, wire: Wire, amperes: float) -> None:
    board.set_current(amperes)
    board.advance(0.1)
    counts = wire.status("Q 1").adc
    assert counts * AMPERES_PER_COUNT == pytest.approx(
        amperes, abs=1.5 * AMPERES_PER_COUNT
    )


def test_hung_firmware_is_restarted_by_the_watchdog_and_comes_back_off(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    wire.status("P 2 200")
    board.hang()
    took = seconds_until_off(board, limit=0.6)
    assert took <= 0.53  # 500 ms nominal; the simulator's watchdog clock gives 512
    board.advance(0.2)
    reconnected = Wire(board)
    banner = reconnected.ask("H 5")
    assert isinstance(banner, Banner)
    assert banner.restarts == 1
    assert banner.reset_flags & 0x08
    assert reconnected.ask("P 6 200") == Refusal(6, Code.LATCHED)
    assert reconnected.status("Q 7").flags == Flags.TRIPPED | Flags.RESET
    reconnected.close()


def test_a_pulled_cable_trips_and_a_returned_one_finds_it_latched(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    wire.status("P 2 200")
    board.unplug()
    assert seconds_until_off(board, limit=1.05) <= DEADLINE + 0.003
    assert not Path(board.port).exists()
    board.plug()
    board.advance(0.1)
    reconnected = Wire(board)
    reconnected.ask("H 0")
    assert reconnected.status("Q 1").flags == Flags.TRIPPED | Flags.DEADLINE
    reconnected.close()


def test_a_host_that_stops_reading_cannot_hold_up_the_firmware(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    # Replies of about 25 bytes: enough of them to fill 64 kB of the port and every buffer of the board.
    for sequence in range(2, 4002):
        wire.send(seal(f"P {sequence} 50"))
        board.advance(0.004)
    assert board.drive().pwm == pytest.approx(50, abs=0.16)
    # alive to the end, and tripped by its deadline
    assert seconds_until_off(board, limit=1.05) > 0.9
    while wire.heard():
        board.advance(0.01)
    status = wire.status("Q 4002")
    assert status.flags == Flags.TRIPPED | Flags.DEADLINE
    assert status.time_ms > 16_000  # no watchdog reset meanwhile


@pytest.mark.parametrize("board", ["simavr"], indirect=True)
def test_opening_and_closing_at_1200_baud_leads_to_the_boot_loader(
    board: Board, wire: Wire
) -> None:
    wire.ready()
    wire.status("P 2 200")
    mode = termios.tcgetattr(wire.descriptor)
    wire.close()
    board.advance(0.01)
    assert board.drive().enabled  # closing alone is not a reason to stop at once
    wire.descriptor = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    mode[4] = mode[5] = termios.B1200
    termios.tcsetattr(wire.descriptor, termios.TCSANOW, mode)
    board.advance(0.03)
    wire.close()
    assert seconds_until_off(board, limit=0.02) < 0.02
    # The core sets the watchdog to 120 ms, which the simulator takes for 500. Without a boot loader here the
    # sketch itself starts again.
    board.advance(0.7)
    wire.descriptor = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    board.advance(0.03)
    banner = wire.ask("H 0")
    assert isinstance(banner, Banner)
    assert banner.restarts == 1


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b":P 2 200*0000\n", Code.CRC),
        (b":P 2 200\n", Code.CRC),
        (b":" + b"x" * 200 + b"\n", Code.TOO_LONG),
        (seal("P 2 -0"), Code.SYNTAX),
        (seal("P 2 256"), Code.RANGE),
        (seal("Z 2"), Code.UNKNOWN),
    ],
)
def test_damaged_and_impossible_requests_are_refused_with_their_code(
    wire: Wire, line: bytes, code: Code
) -> None:
    wire.send(line)
    reply = wire.wait(lambda reply: isinstance(reply, Refusal))
    assert reply.code is code


def test_a_thousand_set_points_in_order(wire: Wire) -> None:
    wire.ready()
    for n in range(1000):
        pwm = (n * 37) % 511 - 255
        assert wire.status(f"P {n + 2} {pwm}").applied == pwm


def allowed(payload: str, applied: int) -> set[int]:
    """What the output may be after a damaged copy of `payload`: as it was, or as the sound copy makes it."""
    return {applied, int(payload.split()[2]) if payload.startswith("P") else 0}


def test_no_damaged_frame_is_acted_on_with_a_changed_meaning(
    board: Board, wire: Wire
) -> None:
    for n, (payload, line) in enumerate(damaged_lines(FUZZ, seed=11)):
        if n % 50 == 0:
            wire.ready()
            applied = wire.status("P 2 -77").applied
        wire.send(line + b"\n")
        # what it answers to that must not crowd out the reply to the next
        board.advance(0.008)
        wire.send(seal("Q 60000"))
        reply = wire.wait(lambda r: isinstance(r, BoardStatus) and r.sequence == 60000)
        assert isinstance(reply, BoardStatus)
        assert reply.applied in allowed(payload, applied), (payload, line)
        assert not reply.flags & Flags.TRIPPED
        applied = reply.applied
    assert board.drive().time > 0


# Emulated boards that cannot be made, or are asked for what they cannot do.


def program(path: Path, script: str) -> VirtualTools:
    """A simulator that is a shell script."""
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return VirtualTools(path, path)


def test_a_stand_in_admits_to_being_one_and_its_port_disappears_with_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    port = tmp_path / "ttyACM7"
    with caplog.at_level(logging.INFO), StandInArduino(port) as stand_in:
        assert "stand-in for the Arduino" in caplog.text
        assert stand_in.port == str(port)
        assert port.exists()
    assert not port.is_symlink()


def test_a_stand_in_takes_nobody_elses_place(tmp_path: Path) -> None:
    place = tmp_path / "ttyACM0"
    place.write_text("mine")
    with pytest.raises(ArduinoError, match="choose another path"):
        StandInArduino(place)
    assert place.read_text() == "mine"


@pytest.mark.parametrize(
    ("missing", "words"),
    [("avr-g++", "install gcc-avr"), ("", "install libsimavr-dev")],
)
def test_what_is_missing_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, missing: str, words: str
) -> None:
    monkeypatch.setattr(
        shutil, "which", lambda tool: None if tool == missing else f"/usr/bin/{tool}"
    )
    monkeypatch.setattr(arduino_virtual, "SIMAVR_HEADER", tmp_path / "nowhere.h")
    with pytest.raises(ArduinoError, match=words):
        build_virtual_board(PROJECT, tmp_path)


def test_sources_that_do_not_compile_are_reported_with_the_compilers_words(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make on this machine")
    (tmp_path / "firmware").mkdir()
    (tmp_path / "firmware" / "Makefile").write_text(
        "all:\n\t@echo too bad >&2; exit 1\n"
    )
    monkeypatch.setattr(arduino_virtual, "SIMAVR_HEADER", Path(__file__))
    monkeypatch.setattr(arduino_virtual, "TOOLS", {"make": "make"})
    with pytest.raises(ArduinoError, match="firmware does not compile:\ntoo bad"):
        build_virtual_board(tmp_path, tmp_path / "build")


def test_a_simulator_that_is_not_there_and_one_that_ends_at_once(
    tmp_path: Path,
) -> None:
    with pytest.raises(ArduinoError, match="does not start"):
        VirtualArduino(VirtualTools(tmp_path / "nothing", tmp_path / "image.elf"))
    with pytest.raises(ArduinoError, match="its process has ended: no image"):
        VirtualArduino(program(tmp_path / "simulator", "echo no image >&2"))


def test_a_simulator_without_an_image_is_an_error(tmp_path: Path) -> None:
    parts = boards.tools()
    if isinstance(parts, str):
        pytest.skip(parts)
    with pytest.raises(ArduinoError, match="its process has ended"):
        VirtualArduino(VirtualTools(parts.program, tmp_path / "no.elf"))


def test_a_simulator_that_ends_later_is_an_error_of_every_command(
    tmp_path: Path,
) -> None:
    simulator = VirtualArduino(
        program(tmp_path / "simulator", "echo state 0 0 0 800 0 0 1; read line")
    )
    with pytest.raises(ArduinoError, match="its process has ended"):
        simulator.advance(0.1)
    with pytest.raises(ArduinoError, match="its process has ended"):
        simulator.drive()
    simulator.close()


def test_a_command_that_a_simulator_of_another_version_refuses_is_an_error(
    tmp_path: Path,
) -> None:
    tools = program(
        tmp_path / "simulator",
        "echo state 0 0 0 800 0 0 1; read line; echo error; read line",
    )
    with (
        VirtualArduino(tools) as simulator,
        pytest.raises(ArduinoError, match="it refused a command"),
    ):
        simulator.hang()
