"""High drive for longer than a plant needs: the board ends it by itself, whatever its host says.

Most boards here have a budget of two seconds of full drive instead of 480. Times are the board's own.
"""

from __future__ import annotations

import itertools
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing

import pytest

from tests.support import boards
from tests.support.boards import Board, Simulated, Wire
from tests.support.places import PROJECT
from twinmatch.emulation import arduino
from twinmatch.emulation.arduino_virtual import VirtualTools
from twinmatch.links.pwm_protocol import (
    SEQUENCES,
    Banner,
    BoardStatus,
    Code,
    Flags,
    Refusal,
    Reply,
    seal,
)
from twinmatch.signals import Window

HOLD = 220
"""Magnitude of the PWM that may stay for ever."""
FULL = 255 - HOLD
WHOLE = FULL * 480.0
"""Budget of a board, PWM·s."""
SHORT = 2
"""Budget of a board that is soon exhausted, seconds of full drive."""
TICK = 0.001
SPENT = Flags.TRIPPED | Flags.BUDGET
KINDS = [kind for kind in boards.KINDS if kind != "real"]


def spent(drive: Iterable[float], period: float) -> Iterator[float]:
    """What of the budget is spent after each period (s) of these drives, PWM·s."""
    return itertools.accumulate(
        drive,
        lambda so_far, pwm: max(0.0, so_far + (abs(pwm) - HOLD) * period),
        initial=0,
    )


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> VirtualTools:
    """The simulator, and the firmware with another number in `config.h`."""
    parts = boards.tools()
    if isinstance(parts, str):
        pytest.skip(parts)
    folder = tmp_path_factory.mktemp("short") / "firmware"
    shutil.copytree(
        PROJECT / "firmware", folder, ignore=shutil.ignore_patterns("build")
    )
    config = folder / "twinmatch_leonardo" / "config.h"
    usual = "kFullDriveSeconds = 480;"
    assert usual in config.read_text()
    config.write_text(
        config.read_text().replace(usual, f"kFullDriveSeconds = {SHORT};")
    )
    subprocess.run(["make", "-s", "-C", str(folder)], check=True)
    return VirtualTools(parts.program, folder / "build" / "twinmatch_leonardo.elf")


class Host:
    """A host that keeps the deadline, and notes what it sees at the pins."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.pins: list[float] = []
        """Drive in each millisecond of `hold`."""
        self._open(0)
        assert self.status("C").flags == Flags.NONE

    def ask(self, verb: str, *value: int) -> Reply:
        """Send a request under the next number; its reply."""
        return self.wire.ask(self._numbered(verb, *value))

    def status(self, verb: str, *value: int) -> BoardStatus:
        """Send a request that is answered by a status."""
        return self.wire.status(self._numbered(verb, *value))

    def hold(self, pwm: int, seconds: float, repeat: float = 0.25) -> bool:
        """Command for so long, again after `repeat` seconds each; false once the board has switched off."""
        on = self.board.drive().enabled
        for n in range(round(seconds / TICK)):
            if n % round(repeat / TICK) == 0:
                self.wire.send(seal(self._numbered("P", pwm)))
            drive = self.board.advance(TICK)
            self.pins.append(drive.pwm)
            if on and not drive.enabled:
                return False
            on = drive.enabled
        return True

    def open_again(self) -> None:
        """Open the port again, as another program would."""
        self.wire.close()
        self._open(40_000)

    def close(self) -> None:
        self.wire.close()
        self.board.close()

    def _open(self, first: int) -> None:
        self.wire = Wire(self.board)
        self._next = first
        assert isinstance(self.ask("H"), Banner)

    def _numbered(self, verb: str, *value: int) -> str:
        sequence = self._next
        self._next = (self._next + 1) % SEQUENCES
        return " ".join(map(str, (verb, sequence, *value)))


@pytest.fixture(params=KINDS)
def host(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Host]:
    """A host at a board with a short budget."""
    monkeypatch.setattr(arduino, "FULL_DRIVE_SECONDS", SHORT)
    if request.param == "simavr":
        board: Board = Simulated(request.getfixturevalue("short"))
        board.advance(0.1)
    else:
        board = boards.make(request.param)
    with closing(Host(board)) as opened:
        yield opened


@pytest.mark.long("eight minutes of full drive on the simulated processor")
def test_the_image_as_it_is_flashed_ends_full_drive_after_eight_minutes() -> None:
    board = boards.make("simavr")
    with closing(Host(board)) as host:
        assert host.status("P", 255).applied == 255
        start = board.drive().time
        while board.advance(0.9).time - start < 479:
            assert host.status("P", 255).applied == 255
        assert not host.hold(255, 2.0)
        assert board.drive().time - start == pytest.approx(480, abs=0.02)
        assert board.drive()[1:] == (0.0, False)
        assert host.status("Q").flags == SPENT


@pytest.mark.parametrize(
    ("cycle", "ends"),
    [
        ([(255, 9.0)], 2.0),
        ([(-255, 9.0)], 2.0),
        ([(230, 6.5), (221, 9.0)], 11.5),  # 65 PWM·s, and 5 more
        ([(-240, 9.0)], 3.5),
        # 3.5 are left: a single PWM counted too much would spend them
        ([(255, 1.9), (220, 5.0)], None),
        ([(-255, 1.9), (-219, 5.0)], None),
        ([(255, 1.0), (0, 0.16)] * 8, None),  # 35 PWM·s more, 35.2 less
        # 35 more, 22 less: 31 are left for the fourth
        ([(255, 1.0), (0, 0.1)] * 8, 4.186),
        # 17.5 more, 5 less: 7.5 are left for the sixth
        ([(255, 0.5), (210, 0.5)] * 8, 5.214),
        ([(255, 0.5), (-255, 0.5)] * 8, 2.038),  # 3 reversals, with 2 ms at zero
        # so many reversals that it is at rest for long enough
        ([(255, 0.01), (-255, 0.01)] * 200, None),
    ],
)
def test_the_budget_adds_what_is_above_220_and_takes_off_what_is_below(
    host: Host, cycle: list[tuple[int, float]], ends: float | None
) -> None:
    assert all(host.hold(pwm, seconds) for pwm, seconds in cycle) is (ends is None)
    highest = max(spent(map(round, host.pins), TICK))
    if ends is None:
        assert highest < FULL * SHORT
        assert host.status("Q").flags == Flags.ENABLED
    else:
        assert len(host.pins) * TICK == pytest.approx(ends, abs=0.03)
        # A command may reach the pins within a millisecond, whose drive is then only about what is seen.
        assert highest == pytest.approx(FULL * SHORT, abs=0.5 * (len(cycle) + 1))
        assert host.status("Q").flags == SPENT


def given_back(host: Host, since: float) -> float:
    """Time at full drive that the rest since then gives back, s."""
    return (host.board.drive().time - since) * HOLD / FULL


def test_clearing_counts_only_after_a_rest(host: Host) -> None:
    assert not host.hold(255, 3.0)
    end_of_drive = host.board.drive().time
    for _ in range(2):
        assert host.status("C").flags == SPENT
        assert isinstance(refused := host.ask("P", 255), Refusal)
        assert refused.code is Code.LATCHED
        host.open_again()
    assert host.status("Q").flags == SPENT
    host.board.advance(
        end_of_drive + SHORT / 2 * FULL / HOLD + 0.005 - host.board.drive().time
    )
    # half of the budget is back, but nothing clears itself
    assert host.status("Q").flags & SPENT == SPENT
    assert host.status("C").flags == Flags.NONE
    expected = given_back(host, end_of_drive)
    before = len(host.pins)
    assert 1.0 < expected < 1.3
    assert not host.hold(255, 3.0)
    assert (len(host.pins) - before) * TICK == pytest.approx(expected, abs=0.05)


def test_a_silent_host_trips_the_deadline_and_gets_nothing_back_by_clearing(
    host: Host,
) -> None:
    assert not host.hold(255, 1.5, repeat=9.0)
    end_of_drive = host.board.drive().time
    assert len(host.pins) * TICK == pytest.approx(1.0, abs=0.01)
    assert host.status("Q").flags == Flags.TRIPPED | Flags.DEADLINE
    assert host.status("C").flags == Flags.NONE
    host.open_again()
    host.status("C")
    expected = SHORT - 1.0 + given_back(host, end_of_drive)
    before = len(host.pins)
    assert expected < 1.5
    assert not host.hold(255, 3.0)
    assert (len(host.pins) - before) * TICK == pytest.approx(expected, abs=0.05)
    assert host.status("Q").flags == SPENT


def test_silence_does_not_outlast_the_budget(host: Host) -> None:
    assert host.hold(255, 1.5)
    assert not host.hold(255, 1.5, repeat=9.0)
    assert len(host.pins) * TICK == pytest.approx(2.0, abs=0.01)
    assert host.status("Q").flags == SPENT


def test_neither_a_pulled_cable_nor_a_watchdog_reset_gives_anything_back(
    host: Host,
) -> None:
    assert host.hold(255, 1.9)
    host.board.hang()
    host.board.advance(0.6)
    assert not host.board.drive().enabled
    host.board.unplug()
    host.board.advance(TICK)
    host.board.plug()
    host.board.advance(0.05)
    host.open_again()
    assert host.status("Q").flags == Flags.TRIPPED | Flags.RESET
    assert host.status("C").flags == Flags.NONE
    before = len(host.pins)
    assert not host.hold(255, 3.0)
    assert (len(host.pins) - before) * TICK < 1.8
    assert host.status("Q").flags == SPENT


@pytest.mark.parametrize("number", [1, 2, 5, 9, 14, 20, 27])
def test_no_healthy_hour_of_the_rig_spends_half_of_it(
    recorded_hour: Callable[[int], Window], number: int
) -> None:
    healthy = 2155 if number == 27 else None  # where its drive is lost
    assert max(spent(recorded_hour(number).input[:healthy], 1.0)) < WHOLE / 2


def test_it_would_have_ended_the_hour_whose_drive_was_lost(
    recorded_hour: Callable[[int], Window],
) -> None:
    levels = spent(recorded_hour(27).input, 1.0)
    assert next(second for second, level in enumerate(levels) if level > WHOLE) == 2787
