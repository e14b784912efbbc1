"""The line to a Temperature Control Lab: the package's own class on a pseudo-terminal, and what breaks it."""

from __future__ import annotations

import math
import os
import pty
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("tclab", reason="pip install 'twinmatch[tclab]'")

from tests.support.kits import BenchKit
from tests.support.processes import Process
from tests.support.waiting import wait_for
from twinmatch.links.kit_keeper import open_kit
from twinmatch.links.kit_link import (
    KitAbsentError,
    KitError,
    KitLink,
    KitSilentError,
    is_pseudo_terminal,
    require_port,
)


@pytest.fixture
def kit(tmp_path: Path) -> Iterator[BenchKit]:
    opened = BenchKit(tmp_path)
    yield opened
    opened.close()


@pytest.fixture
def link(kit: BenchKit) -> Iterator[KitLink]:
    """Open, with its keeper patient enough for a busy machine."""
    opened = KitLink(kit.port, deadline=3.0)
    opened.open()
    yield opened
    opened.close()


def test_only_a_board_is_given_the_time_to_restart(kit: BenchKit) -> None:
    assert is_pseudo_terminal(kit.port)  # a link to one
    assert not is_pseudo_terminal("/dev/ttyACM0")
    assert not is_pseudo_terminal("/dev/ttyUSB1")


def wait_for_both_off(kit: BenchKit) -> None:
    wait_for(lambda: kit.heaters == [0.0, 0.0], "both heaters off")


def keeper(kit: BenchKit) -> int:
    """Process id of who holds the port."""
    words = {
        child: Path(f"/proc/{child}/cmdline").read_text()
        for child in Process.children_of(os.getpid())
    }
    (holding,) = (
        child
        for child, line in words.items()
        if "kit_keeper" in line and kit.port in line
    )
    return holding


def test_it_sets_heaters_and_reads_sensors_whatever_stands_between_while_somebody_commands(
    kit: BenchKit, link: KitLink
) -> None:
    """Until its end of the pipe closes, as the kernel does for a process that is killed."""
    assert link.firmware.startswith("TCLab Firmware")
    kit.shown = {1: 41.25, 2: 30.5}
    assert link.drive(37.5, 12.0) == (41.25, 30.5, 37.5, 12.0)
    assert kit.heaters == [37.5, 12.0]
    for _ in range(5):  # rubbish between two questions
        kit.say(b"\xff\x00 99.9\r\n12")
        time.sleep(0.02)
        assert link.drive(40.0, 0.0) == (41.25, 30.5, 40.0, 0.0)
    assert link.keeper is not None
    assert link.keeper.stdin is not None
    link.keeper.stdin.close()
    wait_for_both_off(kit)


def test_silence_switches_off_until_it_is_cleared(kit: BenchKit) -> None:
    link = KitLink(kit.port, deadline=0.6)
    link.open()
    link.drive(50.0, 50.0)
    wait_for_both_off(kit)
    with pytest.raises(KitSilentError, match=r"received no command for 0\.6 s"):
        link.drive(50.0, 0.0)
    assert link.drive(0.0, 0.0)[2] == 0.0
    link.clear()
    assert link.drive(20.0, 0.0)[2] == 20.0
    link.close()


def test_an_invalid_command_never_reaches_it(kit: BenchKit, link: KitLink) -> None:
    """The package itself makes 100 % of what is not a number."""
    link.drive(50.0, 30.0)
    with pytest.raises(KitError, match="it must be within 0 to 100 %"):
        link.drive(50.0, math.nan)
    wait_for_both_off(kit)
    assert kit.highest == 50.0


def test_who_holds_the_port_is_killed_and_the_next_one_begins_with_zero_and_ends_when_asked(
    kit: BenchKit, link: KitLink
) -> None:
    link.drive(80.0, 60.0)
    os.kill(keeper(kit), signal.SIGKILL)
    with pytest.raises(KitError, match="process that holds its port"):
        link.drive(80.0, 60.0)
    link.close()
    # the firmware has no deadline: somebody has to say it
    assert kit.heaters == [80.0, 60.0]
    link.open()
    assert kit.heaters == [0.0, 0.0]
    link.drive(80.0, 60.0)
    os.kill(keeper(kit), signal.SIGTERM)
    wait_for_both_off(kit)


def test_a_pulled_cable_is_an_error_and_a_returned_one_can_be_opened(
    kit: BenchKit, link: KitLink
) -> None:
    link.drive(80.0, 60.0)
    kit.unplug()
    with pytest.raises(KitError):
        link.drive(80.0, 60.0)
    link.close()
    with pytest.raises(KitAbsentError, match="No such file"):
        link.open()
    kit.plug()
    link.open()
    assert link.drive(10.0, 0.0)[2] == 10.0


def test_who_holds_the_port_checks_commands_and_a_port_that_is_gone_is_an_error_of_the_system(
    kit: BenchKit,
) -> None:
    """And not one of the terminal, which nobody expects: the heaters would be switched off only once."""
    board = open_kit(kit.port)
    board.drive(30.0, 0.0)
    for value in (math.nan, math.inf, -1.0, 100.5):
        with pytest.raises(KitError, match="it must be within 0 to 100 %"):
            board.drive(value, 0.0)
    assert kit.highest == 30.0
    kit.unplug()
    for _ in range(2):
        with pytest.raises(OSError):  # noqa: PT011
            board.off()


def test_a_kit_that_answers_too_late_has_both_heaters_off(kit: BenchKit) -> None:
    """The second is set to zero, too, though the first was not confirmed."""
    board = open_kit(kit.port, patience=0.05)
    board.drive(40.0, 30.0)
    with (
        kit.suspended(),
        pytest.raises(KitError, match=r"no valid answer to 'Q1 0\.00'"),
    ):
        board.off()
    wait_for_both_off(kit)
    board.sp.close()


def test_a_kit_that_answers_rubbish_is_switched_off(
    kit: BenchKit, link: KitLink
) -> None:
    link.drive(40.0, 30.0)
    kit.shown[2] = math.nan
    with pytest.raises(KitError, match="T2 reads nan"):
        link.drive(40.0, 30.0)
    wait_for_both_off(kit)


def test_a_kit_that_says_nothing_is_given_up(kit: BenchKit, link: KitLink) -> None:
    link.drive(40.0, 0.0)
    kit.board.hung = True
    with pytest.raises(KitError, match="no valid answer"):
        link.drive(40.0, 0.0)


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("/nowhere/ttyACM0", "No such file"),
        (__file__, "not a serial port"),
        ("/dev/null", "cannot be opened"),
    ],
)
def test_a_wrong_port_is_one_clear_line(port: str, words: str) -> None:
    with pytest.raises(KitAbsentError, match=words) as caught:
        KitLink(port).open()
    assert port in str(caught.value)
    assert "\n" not in str(caught.value)


def test_another_device_is_reported_as_such() -> None:
    """A modem, say: it receives everything and answers nothing."""
    master, slave = pty.openpty()
    try:
        require_port(os.ttyname(slave))
        with pytest.raises(
            KitAbsentError, match="does not answer like a Temperature Control Lab"
        ):
            KitLink(os.ttyname(slave)).open()
    finally:
        os.close(master)
        os.close(slave)


def test_without_the_package_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(KitAbsentError, match=r"pip install 'twinmatch\[tclab\]'"):
        KitLink("")
