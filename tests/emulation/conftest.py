"""A virtual rig in a process of its own, and a small controller at its port and its stream."""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from twinmatch_camera.emulation import PLATE

from tests.support.processes import Process, Processes
from tests.support.waiting import PATIENCE
from twinmatch.dynamics import Controller as Law
from twinmatch.emulation.clock import ClockClient, parse_address
from twinmatch.emulation.faults import tell
from twinmatch.kept import cache_folder
from twinmatch.links.pwm_link import PwmLatchedError, PwmLink, PwmLinkError
from twinmatch.links.thermal_client import ThermalClient, region
from twinmatch.plants import Peltier


class RigProcess:
    """`twinmatch virtual-rig` in a process of its own."""

    def __init__(self, process: Process) -> None:
        self.process = process

    def said(self, beginning: str) -> str:
        """Wait for a line that begins so; the rest of it."""
        return self.process.said(f"^{re.escape(beginning)}(.*)")[1].strip()

    def address(self, name: str) -> str:
        return self.said(f"{name}:")

    def tell(self, line: str) -> str:
        return tell(self.address("control"), line)

    def state(self) -> dict[str, Any]:
        rig_state = json.loads(self.tell("state"))
        assert isinstance(rig_state, dict)
        return rig_state


@pytest.fixture(scope="session", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The simulator is compiled into a cache of the test run."""
    with pytest.MonkeyPatch.context() as patch:
        # the plants' equations are ready where they are
        patch.setenv("TWINMATCH_CACHE", str(cache_folder()))
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def rig(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., RigProcess]]:
    """Start a virtual rig, its files in `tmp_path`: `rig("--speed", "20")`; it is ready on return."""
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    processes = Processes(tmp_path_factory.mktemp("output"), environment)

    def start(*arguments: str, ready: bool = True) -> RigProcess:
        started = RigProcess(
            processes.python("-m", "twinmatch.cli", "virtual-rig", *arguments)
        )
        if ready:
            started.said("ready")
        return started

    yield start
    processes.end()


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
        self._pid = Law(Peltier.loop)
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
            assert self._moved.wait_for(lambda: self._now != before, PATIENCE), (
                "the clock stands"
            )
            return self._now

    def hold(self, reference: float, seconds: float) -> list[Tick]:
        """Run the loop at 1 Hz of plant time for so long; the set-point is sent again ten times a second."""
        start = self._wait_for_time_after(0)
        ticks: list[Tick] = []
        sent = start
        while (time := self._now) < start + seconds * 1e9:
            news = self.thermal.news()
            if time >= start + len(ticks) * 1e9 and news is not None:
                y = region(news.frame, PLATE).mean
                ticks.append(
                    Tick((time - start) / 1e9, y, self._pid.step(reference, y)[0])
                )
            if ticks and time - sent >= 1e8:
                sent = time
                self._command(ticks[-1].pwm)
            self._wait_for_time_after(time)
        return ticks

    def _command(self, pwm: float) -> None:
        try:
            self.current = self.link.command(pwm).current
        except PwmLinkError as error:
            self.errors.append(error)
            with contextlib.suppress(PwmLinkError):
                if isinstance(error, PwmLatchedError):
                    # a machine that is busy may miss a deadline of 50 ms
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
