"""A virtual rig in a process of its own, and a small controller at its port and its stream."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from twinmatch.emulation.lepton import PLATE
from twinmatch.emulation.virtual_rig_clock import ClockClient, parse_address
from twinmatch.emulation.virtual_rig_control import tell
from twinmatch.links.pwm import PwmLatchedError, PwmLink, PwmLinkError
from twinmatch.links.thermal_client import ThermalClient
from twinmatch.links.thermal_region import region
from twinmatch.plant import Pid

PATIENCE = 60.0
"""Wall time after which a test gives up, s; everything comes within a few."""


class RigProcess:
    """`twinmatch virtual-rig` with what it prints."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        environment = {**os.environ, "TMPDIR": str(folder), "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twinmatch.cli", "virtual-rig", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
        )
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._said:
                self.lines.append(line.rstrip())
                self._said.notify_all()
        with self._said:
            self._ended = True
            self._said.notify_all()

    def said(self, beginning: str) -> str:
        """Wait for a line that begins so; the rest of it."""

        def found() -> list[str]:
            return [line for line in self.lines if line.startswith(beginning)]

        with self._said:
            self._said.wait_for(lambda: found() or self._ended, PATIENCE)
            assert found(), f"{beginning!r} was not said: {self.lines}"
            return found()[0].removeprefix(beginning).strip()

    def address(self, name: str) -> str:
        return self.said(f"{name}:")

    def tell(self, line: str) -> str:
        return tell(self.address("control"), line)

    def state(self) -> dict[str, Any]:
        found = json.loads(self.tell("state"))
        assert isinstance(found, dict)
        return found

    def wait_for_time(self, seconds: float) -> None:
        """Wait until so much plant time has passed."""
        deadline = time.monotonic() + PATIENCE
        while self.state()["time"] < seconds:
            assert time.monotonic() < deadline, "plant time does not pass"
            time.sleep(0.01)

    def children(self) -> list[int]:
        threads = Path(f"/proc/{self.process.pid}/task").glob("*/children")
        return [int(child) for thread in threads for child in thread.read_text().split()]

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Exit code after a signal."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(20)
        finally:
            self.process.kill()
            self.process.wait()
            self._thread.join(20)
            if self.process.stdout is not None:
                self.process.stdout.close()


@pytest.fixture(scope="session", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The simulator is compiled into a cache of the test run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Callable[..., RigProcess]]:
    """Start a virtual rig: `rig("--speed", "20")`; it is ready on return."""
    started: list[RigProcess] = []

    def start(*arguments: str, ready: bool = True) -> RigProcess:
        started.append(RigProcess(tmp_path, *arguments))
        if ready:
            started[-1].said("ready")
        return started[-1]

    yield start
    for process in started:
        process.end()


class Tick(NamedTuple):
    """One sample of the loop."""

    time: float
    temperature: float
    pwm: float


class Controller:
    """The PID at the production port and stream, with the rig's clock. Errors are counted, and lived with."""

    def __init__(self, rig: RigProcess) -> None:
        host, port = parse_address(rig.address("camera"))
        self.thermal = ThermalClient(host, port)
        self.link = PwmLink(rig.address("serial"))
        self.errors: list[PwmLinkError] = []
        self.current = 0.0
        self._pid = Pid()
        self._now = 0
        self._moved = threading.Condition()
        self._clock = ClockClient(parse_address(rig.address("clock")), self._on_time)

    def __enter__(self) -> Controller:
        self.thermal.start()
        self._clock.start()
        self.link.open()
        self.link.clear()
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()
        self._clock.close()
        self.thermal.close()

    def _on_time(self, stamp: int) -> None:
        with self._moved:
            self._now = stamp
            self._moved.notify_all()

    def _wait_for_time_after(self, before: int) -> int:
        with self._moved:
            assert self._moved.wait_for(lambda: self._now != before, PATIENCE), "the clock stands"
            return self._now

    def hold(self, reference: float, seconds: float) -> list[Tick]:
        """Run the loop at 1 Hz of plant time for so long; the set-point is sent again ten times a second."""
        start = self._wait_for_time_after(0)
        ticks: list[Tick] = []
        sent = start
        while (now := self._now) < start + seconds * 1e9:
            news = self.thermal.news()
            if now >= start + len(ticks) * 1e9 and news is not None:
                y = region(news.frame, PLATE).mean
                ticks.append(Tick((now - start) / 1e9, y, self._pid.step(reference, y)))
            if ticks and now - sent >= 1e8:
                sent = now
                self._command(ticks[-1].pwm)
            self._wait_for_time_after(now)
        return ticks

    def _command(self, pwm: float) -> None:
        try:
            self.current = self.link.command(pwm).current
        except PwmLinkError as error:
            self.errors.append(error)
            with contextlib.suppress(PwmLinkError):
                if isinstance(error, PwmLatchedError):  # a machine that is busy may miss a deadline of 50 ms
                    self.link.clear()
                else:
                    self.link.open()


@pytest.fixture
def controller() -> Iterator[Callable[[RigProcess], Controller]]:
    """Join a controller to a rig: `controller(rig)`."""
    with contextlib.ExitStack() as stack:

        def join(process: RigProcess) -> Controller:
            return stack.enter_context(Controller(process))

        yield join
