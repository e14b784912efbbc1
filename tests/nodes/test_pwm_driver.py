"""The thread that speaks to the board, against emulated boards: zero is what is left of every trouble."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.support import boards
from tests.support.boards import StandIn
from tests.support.waiting import wait_for
from twinmatch.emulation import arduino
from twinmatch.links.pwm_link import Applied, LinkSettings, PwmLatchedError, PwmLink
from twinmatch.links.pwm_protocol import Flags
from twinmatch.nodes.gated import ClockTimes, DriverPace, OutputGate
from twinmatch.nodes.health import Level, NodeHealth
from twinmatch.nodes.pwm_bridge import PwmDriver
from twinmatch.safety import FaultKind, GuardLimits, OutputGuard

PATIENT = LinkSettings(timeout=1.0)
"""For boards that share a busy machine with the tests."""
SLOWLY = 0.25
"""Pace of the boards' time: their deadline of 1 s leaves a driver without a processor 4 s."""
DEADLINE = 4.0
"""The boards' deadline at that pace, wall s."""


KINDS = [kind for kind in boards.KINDS if kind != "real"]


class Bench:
    """A driver between a gate that is kept supplied and a board whose time passes."""

    def __init__(self, board: Any, link: LinkSettings = PATIENT) -> None:
        self.board = board
        self.reports: list[tuple[Applied | None, int]] = []
        self.health = NodeHealth()
        self.gate = OutputGate(
            self._clocks,
            [OutputGuard(GuardLimits(command_timeout=3.0, temperature_timeout=10.0))],
        )
        self.link = PwmLink(board.port, link)
        settings = DriverPace(first_pause=0.02, longest_pause=0.1)
        self.driver = PwmDriver(self.link, self.gate, self._tell, self.health, settings)
        self.pwm: float | None = None
        self.fail_to_tell = False
        self._ending = threading.Event()
        self._feeder = threading.Thread(target=self._feed, daemon=True)

    def start(self) -> Bench:
        self.driver.start()
        self._feeder.start()
        return self

    def drive(self, pwm: float) -> None:
        """Command from now on, and wait until the pins follow."""
        self.pwm = pwm
        self.until(lambda: self.board.drive().pwm == pytest.approx(pwm, abs=0.16))

    def until(self, condition: Callable[[], Any]) -> None:
        wait_for(condition, lambda: str(self.health.report()))

    def kind(self) -> FaultKind | None:
        return None if self.gate.fault is None else self.gate.fault.kind

    def stays_at_zero(self) -> None:
        """For a while, which the driver uses to look at the board several times."""
        count_before = len(self.reports)
        while len(self.reports) < count_before + 3:
            assert self.board.drive().pwm == 0.0
            time.sleep(0.01)

    def clear(self) -> None:
        self.driver.clear()
        self.gate.clear()

    def close(self) -> None:
        self._ending.set()
        if self._feeder.ident is not None:
            self._feeder.join()
        assert self.driver.close(30.0)
        self.board.close()

    def _clocks(self) -> ClockTimes:
        monotonic = time.monotonic_ns()
        return ClockTimes(monotonic, monotonic, monotonic)

    def _tell(self, applied: Applied | None, sample: int) -> None:
        if self.fail_to_tell:
            raise RuntimeError("the report cannot be delivered")
        self.reports.append((applied, sample))

    def _feed(self) -> None:
        while not self._ending.wait(0.02):
            self.gate.temperature(25.0, time.monotonic_ns())
            if self.pwm is not None:
                self.gate.command(self.pwm, 42, time.monotonic_ns())


@pytest.fixture(params=KINDS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    board = boards.make(request.param)
    board.run(SLOWLY)
    with closing(Bench(board).start()) as opened:
        yield opened


@pytest.fixture
def stand_in() -> Iterator[Bench]:
    board = StandIn()
    board.run(SLOWLY)
    with closing(Bench(board, LinkSettings(timeout=0.5, retries=1)).start()) as opened:
        yield opened


def test_a_command_is_repeated_and_its_effect_reported(bench: Bench) -> None:
    bench.until(lambda: bench.reports)
    assert bench.reports[0][0] is not None
    # a fresh board was cleared, and is not driven
    assert bench.reports[0][0].flags == Flags.NONE
    bench.drive(120.0)
    count_before = len(bench.reports)
    deadline = time.monotonic() + 1.1 * DEADLINE
    bench.until(
        lambda: len(bench.reports) > count_before + 15 and time.monotonic() > deadline
    )
    assert bench.gate.fault is None
    applied, sample = bench.reports[-1]
    assert applied is not None
    assert (applied.pwm, applied.flags, sample) == (120, Flags.ENABLED, 42)
    bench.drive(-80.0)


def test_silence_is_zero_first_and_then_off_and_a_new_command_wakes_it(
    bench: Bench,
) -> None:
    bench.drive(120.0)
    bench.pwm = None
    bench.until(lambda: bench.kind() is FaultKind.COMMAND_SILENT)
    bench.until(lambda: bench.board.drive().pwm == 0)
    # its deadline is not fed any longer
    bench.until(lambda: not bench.board.drive().enabled)
    bench.stays_at_zero()
    bench.clear()
    bench.drive(60.0)


def test_a_driver_fault_latches_until_it_is_gone_and_cleared(bench: Bench) -> None:
    bench.drive(120.0)
    bench.board.set_fault(True)
    bench.until(lambda: bench.kind() is FaultKind.DRIVER)
    bench.stays_at_zero()
    bench.clear()
    bench.until(lambda: bench.kind() is FaultKind.DRIVER)  # it is still there
    bench.board.set_fault(False)
    bench.stays_at_zero()
    bench.clear()
    bench.drive(60.0)


def test_a_board_that_restarts_latches(bench: Bench) -> None:
    bench.drive(120.0)
    bench.board.hang()
    bench.until(lambda: bench.kind() in {FaultKind.LINK, FaultKind.BOARD})
    bench.until(lambda: bench.driver.connected and bench.link.restarts == 1)
    bench.stays_at_zero()
    bench.clear()
    bench.drive(60.0)


def test_an_idle_board_that_restarts_latches_too(bench: Bench) -> None:
    bench.until(lambda: bench.driver.connected)
    bench.board.hang()
    bench.until(lambda: bench.kind() is FaultKind.BOARD)
    assert "restarted" in str(bench.gate.fault)
    bench.pwm = 50.0
    bench.stays_at_zero()
    bench.clear()
    bench.drive(50.0)


def test_the_end_is_an_acknowledged_zero(bench: Bench) -> None:
    bench.drive(200.0)
    assert bench.driver.close(30.0)
    applied, _ = bench.reports[-1]
    assert applied is not None
    # it was commanded, its deadline had not passed
    assert (applied.pwm, applied.flags) == (0, Flags.ENABLED)
    assert not bench.link.is_open
    assert bench.driver.failure is None


def test_a_defect_ends_the_thread_with_zero(bench: Bench) -> None:
    bench.drive(200.0)
    bench.fail_to_tell = True
    bench.until(lambda: isinstance(bench.driver.failure, RuntimeError))
    bench.until(lambda: not bench.link.is_open)
    assert bench.board.drive().pwm == 0


def test_a_mute_board_is_a_lost_link(stand_in: Bench) -> None:
    stand_in.drive(120.0)
    stand_in.board.pause()
    stand_in.until(lambda: stand_in.kind() is FaultKind.LINK)
    assert "no answer" in str(stand_in.gate.fault)
    assert stand_in.board.advance(1.001).pwm == 0.0
    stand_in.board.run(SLOWLY)
    stand_in.until(lambda: stand_in.driver.connected)
    stand_in.stays_at_zero()


def test_noise_on_the_line_is_borne(stand_in: Bench) -> None:
    """Half frames, foreign frames and binary, towards us and towards the board."""
    stand_in.drive(120.0)
    descriptor = os.open(stand_in.board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    noise = [
        b":S 1 2 3*0000\n",
        b"\xff\x00garbage\n",
        b":S 65535 0 255 0 1*",
        b"\n\n::",
        b":E - CRC*12\n",
    ]
    try:
        count_before = len(stand_in.reports)
        for number in range(40):
            stand_in.board.line.write(noise[number % 5])
            os.write(descriptor, noise[(number + 2) % 5])
            time.sleep(0.02)
    finally:
        os.close(descriptor)
    stand_in.until(lambda: len(stand_in.reports) > count_before + 5)
    if stand_in.gate.fault is None:
        assert all(
            applied is not None and applied.pwm == 120
            for applied, _ in stand_in.reports[count_before:]
        )
    else:
        # a request may be unlucky three times; then it is a lost link, and nothing else
        assert stand_in.kind() is FaultKind.LINK


def test_a_board_that_had_tripped_on_its_driver_is_not_cleared_by_itself() -> None:
    board = StandIn()
    board.run(SLOWLY)
    with PwmLink(board.port, PATIENT) as link:
        link.clear()
        link.command(50.0)
        board.set_fault(True)
        wait_for(lambda: link.query().flags & Flags.DRIVER, "the board's trip")
    board.set_fault(False)
    with closing(Bench(board).start()) as bench:
        bench.pwm = 50.0
        bench.until(lambda: bench.kind() is FaultKind.DRIVER)
        bench.stays_at_zero()
        bench.clear()
        bench.drive(50.0)


def test_a_board_that_ended_high_drive_is_not_cleared_by_itself_and_ends_it_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(arduino, "FULL_DRIVE_SECONDS", 1)
    board = StandIn()
    board.run(SLOWLY)
    with PwmLink(board.port, PATIENT) as link:
        link.clear()
        with pytest.raises(
            PwmLatchedError, match="drove high for longer than a plant needs"
        ):
            wait_for(lambda: not link.command(255.0), "the board's trip")
    with closing(Bench(board).start()) as bench:
        bench.pwm = 255.0
        bench.until(lambda: bench.kind() is FaultKind.BOARD)
        assert "high drive for longer than a plant needs; check sensor" in str(
            bench.gate.fault
        )
        bench.stays_at_zero()

        def drives() -> bool:
            if bench.kind() is not None:  # clearing counts only after a rest
                bench.clear()
            return board.drive().pwm == 255.0

        bench.until(drives)
        bench.until(lambda: bench.kind() is FaultKind.BOARD)
        bench.stays_at_zero()


def test_a_board_that_does_something_else_than_it_was_sent_is_a_fault(
    stand_in: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in.drive(120.0)
    command = stand_in.link.command

    def half_of_the_command(pwm: float) -> Applied:
        applied = command(pwm)
        return Applied(
            applied.pwm // 2, applied.current, applied.flags, applied.device_time
        )

    monkeypatch.setattr(stand_in.link, "command", half_of_the_command)
    stand_in.until(lambda: stand_in.kind() is FaultKind.BOARD)
    assert "applies 60, but 120 was sent" in str(stand_in.gate.fault)


def test_what_trips_while_the_board_is_woken_is_heeded(
    stand_in: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in.until(lambda: stand_in.driver.connected)
    query = stand_in.link.query
    command = stand_in.link.command
    sent: list[float] = []

    def tripping() -> Applied:
        if stand_in.gate.armed:
            stand_in.gate.trip(FaultKind.STOPPED, "now")
        return query()

    def noting(pwm: float) -> Applied:
        sent.append(pwm)
        return command(pwm)

    monkeypatch.setattr(stand_in.link, "query", tripping)
    monkeypatch.setattr(stand_in.link, "command", noting)
    stand_in.pwm = 200.0
    stand_in.until(lambda: stand_in.kind() is FaultKind.STOPPED)
    stand_in.stays_at_zero()
    assert 200.0 not in sent


def test_answers_slower_than_the_deadline_allows_are_warned_of() -> None:
    board = StandIn()
    board.run(SLOWLY)
    with closing(Bench(board, LinkSettings(timeout=0.4, retries=2)).start()) as bench:
        bench.until(lambda: bench.health.report().level is Level.WARN)
        assert (
            "an answer may take 1.3 s, but the board's deadline is 1 s"
            in bench.health.report().message
        )
