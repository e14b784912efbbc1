from __future__ import annotations

import contextlib
import math
import os
import pty
import signal
import subprocess
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import boards
from tests.support.boards import Board
from tests.support.waiting import wait_for
from twinmatch.links import pwm_link
from twinmatch.links.pwm_link import (
    AMPERES_PER_COUNT,
    Applied,
    LinkSettings,
    PwmCorruptReplyError,
    PwmLatchedError,
    PwmLinkError,
    PwmPortBusyError,
    PwmPortLostError,
    PwmPortMissingError,
    PwmRangeError,
    PwmRejectedError,
    PwmResetError,
    PwmStaleReplyError,
    PwmTimeoutError,
    PwmVersionError,
)
from twinmatch.links.pwm_protocol import (
    Flags,
    FrameReader,
    Request,
    parse_request,
    seal,
)

PATIENT = LinkSettings(timeout=2.0)
"""For boards that share a busy machine with the tests; nothing here measures by the wall clock."""
HASTY = LinkSettings(timeout=1.0, retries=1)
"""Where the wait for an answer that does not come is part of the story."""


@pytest.fixture(params=boards.KINDS)
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """A board whose time passes, at half speed: its deadline is two seconds to a busy machine."""
    opened = boards.make(request.param)
    opened.run(1.0 if request.param == "real" else 0.5)
    yield opened
    opened.close()


@pytest.fixture
def link(board: Board) -> Iterator[pwm_link.PwmLink]:
    """A link to it, open and cleared."""
    with pwm_link.PwmLink(board.port, PATIENT) as opened:
        opened.clear()
        yield opened


def test_a_command_reaches_the_pins_and_says_so(
    board: Board, link: pwm_link.PwmLink
) -> None:
    applied = link.command(120.4)
    assert applied.pwm == 120
    assert applied.flags == Flags.ENABLED
    assert board.drive().pwm == pytest.approx(120, abs=0.16)
    assert link.command(-80).device_time > applied.device_time
    board.set_current(2.5)
    wait_for(
        lambda: abs(link.query().current - 2.5) < 2 * AMPERES_PER_COUNT,
        "the current in amperes",
    )


def test_what_is_not_a_set_point_is_refused_before_anything_is_sent(
    link: pwm_link.PwmLink,
) -> None:
    before = link.query()
    for pwm in (math.nan, math.inf, -math.inf, 255.001, -256, np.float64("nan")):
        with pytest.raises(PwmRangeError, match="the command is"):
            link.command(pwm)
    assert link.query().pwm == before.pwm


def test_a_fresh_board_wants_clearing(board: Board) -> None:
    assert not board.drive().enabled
    with (
        pwm_link.PwmLink(board.port, PATIENT) as link,
        pytest.raises(PwmLatchedError, match="just started") as caught,
    ):
        link.command(5)
    assert caught.value.flags & Flags.RESET


def test_silence_latches_and_clear_releases_it(link: pwm_link.PwmLink) -> None:
    link.command(50)
    wait_for(lambda: link.query().flags & Flags.TRIPPED, "the trip")
    with pytest.raises(PwmLatchedError, match="received no command in time") as caught:
        link.command(50)
    assert caught.value.flags == Flags.TRIPPED | Flags.DEADLINE
    assert link.clear().flags == Flags.NONE
    assert link.command(50).pwm == 50


def test_a_driver_fault_is_named(board: Board, link: pwm_link.PwmLink) -> None:
    link.command(50)
    board.set_fault(True)
    wait_for(lambda: not board.drive().enabled, "the trip")
    with pytest.raises(PwmLatchedError, match="motor driver reported a fault"):
        link.command(50)


def test_the_port_is_ours_alone_and_closing_sets_zero_first(
    board: Board, link: pwm_link.PwmLink
) -> None:
    assert link.is_open
    with pytest.raises(PwmPortBusyError, match="another program holds"):
        pwm_link.PwmLink(board.port, PATIENT).open()
    link.command(200)
    link.close()
    assert board.drive()[1:] == (0.0, True)
    link.close()
    assert not link.is_open
    with pytest.raises(PwmPortLostError, match="is not open"):
        link.command(5)


def test_a_pulled_cable_is_noticed_and_the_port_reopened(
    board: Board, link: pwm_link.PwmLink
) -> None:
    link.command(100)
    board.unplug()
    wait_for(lambda: not Path(board.port).exists(), "the port's end")
    with pytest.raises(PwmPortLostError, match="was lost"):
        link.command(100)
    with pytest.raises(PwmPortMissingError, match="cannot be opened"):
        link.reopen(patience=0)
    threading.Timer(0.3, board.plug).start()
    link.reopen(patience=20)
    link.clear()
    assert link.command(60).pwm == 60
    assert link.restarts == 0


def test_a_restarted_board_is_noticed(board: Board, link: pwm_link.PwmLink) -> None:
    link.command(100)
    board.hang()

    def query() -> None:
        with contextlib.suppress(PwmTimeoutError):  # the board hangs
            link.query()

    with pytest.raises(PwmPortLostError, match="was lost"):
        wait_for(query, "the port's end, which is short")
    banner = link.reopen(patience=20)
    assert link.banner == banner
    assert (banner.restarts, link.restarts) == (1, 1)
    with pytest.raises(PwmLatchedError, match="just started"):
        link.command(100)


def test_threads_may_share_a_link(link: pwm_link.PwmLink) -> None:
    answers: list[tuple[int, Applied]] = []

    def drive(pwm: int) -> None:
        for _ in range(20):
            answers.append((pwm, link.command(pwm)))

    threads = [threading.Thread(target=drive, args=(pwm,)) for pwm in (10, 20, 30)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 60
    assert all(applied.pwm == pwm for pwm, applied in answers)


HOST = """
import sys
from twinmatch.links.pwm_link import LinkSettings, PwmLink
link = PwmLink(sys.argv[1], LinkSettings(timeout=2.0))
link.open()
link.clear()
while True:
    link.command(180)
    print("on", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_host_that_dies_or_freezes_lets_go_of_the_plate(
    board: Board, number: signal.Signals
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOST, board.port], stdout=subprocess.PIPE
    ) as host:
        try:
            assert host.stdout is not None
            for _ in range(20):
                assert host.stdout.readline() == b"on\n"
            assert board.drive().pwm == pytest.approx(180, abs=0.16)
            host.send_signal(number)
            if number is signal.SIGKILL:
                host.wait()
        finally:
            board.pause()  # from here on only steps count
            killed_at = board.drive().time
            while board.drive().enabled and board.drive().time < killed_at + 3:
                board.advance(0.01)
            off_at = board.drive().time
            host.kill()
    assert board.drive()[1:] == (0.0, False)
    assert off_at - killed_at <= 2.0


class Impostor:
    """A serial port that answers as a test says: each line to what comes back for it."""

    def __init__(self, answer: Callable[[Request, int], bytes]) -> None:
        self.requests: list[Request] = []
        self._answer = answer
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        reader = FrameReader()
        while data := os.read(self._master, 256):
            for event in reader.feed(data):
                if event == b"Q 99999":
                    return
                assert isinstance(event, bytes)
                request = parse_request(event)
                if isinstance(request, Request):
                    self.requests.append(request)
                    os.write(self._master, self._answer(request, len(self.requests)))

    def close(self) -> None:
        os.write(self._slave, seal("Q 99999"))
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)


def sound(request: Request, count: int = 0) -> bytes:
    """What a board would say."""
    if request.verb.value == "H":
        return seal(f"B {request.sequence} 1.0.0 1 0 1000 0")
    return seal(f"S {request.sequence} {1000 + count} {request.pwm} 0 1")


@pytest.fixture
def impostor() -> Iterator[Callable[[Callable[[Request, int], bytes]], Impostor]]:
    opened: list[Impostor] = []

    def make(answer: Callable[[Request, int], bytes]) -> Impostor:
        opened.append(Impostor(answer))
        return opened[-1]

    yield make
    for opened_impostor in opened:
        opened_impostor.close()


Make = Callable[[Callable[[Request, int], bytes]], Impostor]


def after_hello(
    answer: Callable[[Request, int], bytes],
) -> Callable[[Request, int], bytes]:
    return lambda request, count: (
        sound(request) if request.verb.value == "H" else answer(request, count)
    )


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (lambda *_: b"", PwmTimeoutError, "gave set no answer in 2 attempts of 1 s"),
        (lambda *_: b":S 1 garbage*0000\n", PwmCorruptReplyError, "arrived damaged"),
        (
            lambda r, _: seal(f"B {r.sequence} 1.0.0 1 0 1000 0"),
            PwmCorruptReplyError,
            "arrived damaged",
        ),
        (
            lambda r, n: seal(f"S {(r.sequence - 1) % 65536} {n} 0 0 1"),
            PwmStaleReplyError,
            "to earlier requests",
        ),
        (lambda *_: seal("E - CRC"), PwmRejectedError, "requests arrive damaged"),
        (
            lambda r, _: seal(f"E {r.sequence} RANGE"),
            PwmRejectedError,
            "refused with RANGE",
        ),
    ],
)
def test_each_failure_has_its_own_error(
    impostor: Make,
    answer: Callable[[Request, int], bytes],
    error: type[PwmLinkError],
    message: str,
) -> None:
    board = impostor(after_hello(answer))
    with (
        pwm_link.PwmLink(board.port, HASTY) as link,
        pytest.raises(error, match=message),
    ):
        link.command(5)


@pytest.mark.parametrize(("reply", "timeout"), [(b"", 1.0), (b":S 5 5*0000\n", 30.0)])
def test_a_lost_reply_is_asked_for_again_under_the_same_number_a_damaged_one_at_once(
    impostor: Make, reply: bytes, timeout: float
) -> None:
    board = impostor(after_hello(lambda r, n: sound(r, n) if n >= 3 else reply))
    with pwm_link.PwmLink(board.port, LinkSettings(timeout=timeout, retries=1)) as link:
        assert link.command(5).pwm == 5
    assert board.requests[1] == board.requests[2]


def test_another_version_of_the_protocol_is_refused(impostor: Make) -> None:
    board = impostor(lambda r, _: seal(f"B {r.sequence} 9.0.0 2 other fields"))
    link = pwm_link.PwmLink(board.port, PATIENT)
    with pytest.raises(PwmVersionError, match="not protocol version 1"):
        link.open()
    assert not link.is_open
    with pytest.raises(PwmVersionError, match="not protocol version"):
        link.reopen(patience=1000)  # at once: waiting does not change a version


def test_a_board_that_knows_no_greeting_is_refused(impostor: Make) -> None:
    board = impostor(lambda r, _: seal(f"E {r.sequence} UNKNOWN"))
    with pytest.raises(PwmRejectedError, match="refused with UNKNOWN"):
        pwm_link.PwmLink(board.port, PATIENT).open()


def test_a_reset_that_kept_the_port_is_noticed(impostor: Make) -> None:
    def answer(request: Request, count: int) -> bytes:
        if request.verb.value == "P" and count > 3:
            return seal(f"E {request.sequence} LATCHED")
        flags = (
            Flags.TRIPPED | Flags.RESET if request.verb.value == "Q" else Flags.ENABLED
        )
        return seal(f"S {request.sequence} {count} {request.pwm} 0 {int(flags)}")

    board = impostor(after_hello(answer))
    link = pwm_link.PwmLink(board.port, PATIENT)
    link.open()
    link.clear()
    link.command(5)
    with pytest.raises(PwmResetError, match="restarted and is off"):
        link.command(5)
    assert link.restarts == 1
    with pytest.raises(PwmLatchedError, match="just started"):
        link.command(5)
    link.close()


def test_reopening_waits_longer_each_time_up_to_a_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pauses: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: sum(pauses), sleep=pauses.append)
    monkeypatch.setattr(pwm_link, "time", clock)
    with pytest.raises(
        PwmPortMissingError, match=r"cannot be opened .*check the cable and your access"
    ):
        pwm_link.PwmLink("/dev/no-such-port").reopen(patience=8.0)
    assert pauses == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0])


def test_impossible_settings_are_refused() -> None:
    for timeout in (0.0, math.nan):
        with pytest.raises(PwmRangeError, match=f"timeout is {timeout} s"):
            LinkSettings(timeout=timeout)
    with pytest.raises(PwmRangeError, match="retries is -1"):
        LinkSettings(retries=-1)


def test_lost_and_late_are_also_the_errors_python_knows() -> None:
    assert issubclass(PwmPortLostError, ConnectionError)
    assert issubclass(PwmTimeoutError, TimeoutError)
