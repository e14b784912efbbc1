"""What every virtual plant is: one process that owns the plant's time, tells it, and can be talked to.

Time passes in small slices, at a multiple of the wall clock's pace and never ahead of who follows the clock.
"""

from __future__ import annotations

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from twinmatch.emulation.virtual_rig_clock import ClockServer
from twinmatch.emulation.virtual_rig_control import ControlServer
from twinmatch.emulation.virtual_rig_faults import Change, Fault, FaultError, Schedule, parse_now
from twinmatch.emulation.virtual_rig_folder import private_folder
from twinmatch.emulation.virtual_rig_pace import RigPace
from twinmatch.errors import TwinmatchError

__all__ = ["RigSettings", "VirtualPlantTime", "VirtualRigError"]

_Own = TypeVar("_Own", bound="VirtualPlantTime")

_CLOCK_EVERY = 0.005
"""Wall time between two updates of the clock at most, s."""
_LEASH = 0.25
"""Plant time that the rig runs ahead at most, s, of who says how far it has come: well within the second
that the board waits for a command."""
_PATIENCE = 3.0
"""Wall time after which it is not waited for any longer, s: it has died, or hangs."""


class VirtualRigError(TwinmatchError):
    """A virtual plant that cannot be made as asked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """How a virtual plant is to be.

    Raises:
        VirtualRigError: speed or duration is not positive, or too large to mean anything.
    """

    speed: float = 1.0
    """Plant time per wall time, at most."""
    board: str = "auto"
    """One of `virtual_rig_board.BOARDS`; for the Peltier rig."""
    seed: int = 0
    """Of the sensor's noise and of the faults."""
    faults: tuple[Fault, ...] = ()
    duration: float = math.inf
    """Plant time after which it ends, s."""

    def __post_init__(self) -> None:
        if not 0.01 <= self.speed <= 1000:
            msg = f"virtual rig: speed {self.speed}; give 0.01 to 1000 times the wall clock"
            raise VirtualRigError(msg)
        if not self.duration > 0:
            raise VirtualRigError(f"virtual rig: duration {self.duration} s; it must be positive")
        if self.seed < 0:
            raise VirtualRigError(f"virtual rig: seed {self.seed}; give 0 or more")


class VirtualPlantTime(ABC):
    """Stands until told to `step` or `run`; a context manager. A subclass makes its parts in `make`.

    Raises:
        TwinmatchError: a part of it cannot be made, or a fault is asked for that it does not have.
    """

    board_kind: str
    """What kind of board it has, in a word …"""
    board_remark: str
    """… and a few more."""
    KINDS: ClassVar[frozenset[str] | None] = None
    """Faults that it can have; None: all that there are."""

    def __init__(self, settings: RigSettings | None = None) -> None:
        self.settings = settings or RigSettings()
        self.on_change: Callable[[Change], None] = lambda _: None
        """Called when a fault begins or ends."""
        for fault in self.settings.faults:
            self._require(fault)
        self.schedule = Schedule(self.settings.faults)
        self._stop = False
        self.ms = 0
        """Plant time since the start, ms."""
        self.pace = RigPace(self.settings.speed)
        self.slice = min(20, max(1, round(5 * self.settings.speed)))
        """Plant time of one step, ms."""
        self._clock_told = 0.0
        with ExitStack() as stack:
            self.folder = stack.enter_context(private_folder())
            self._own = self.make(stack)
            self._clock = ClockServer()
            stack.callback(self._clock.close)
            self._control = ControlServer(self.folder / "control", self._obey)
            stack.callback(self._control.close)
            self._start = time.time_ns()
            self._stack = stack.pop_all()

    def __enter__(self: _Own) -> _Own:
        """Nothing to do: it stands since it was made."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()

    @abstractmethod
    def make(self, stack: ExitStack) -> dict[str, str]:
        """Make the parts, left to the stack to be ended; the addresses of those that have one, by name."""

    @abstractmethod
    def advance(self) -> None:
        """Let one slice of plant time pass."""

    @abstractmethod
    def turn(self, kind: str, *, on: bool) -> None:
        """Let a fault begin or end."""

    @abstractmethod
    def state(self) -> dict[str, object]:
        """What there is to know."""

    def rest(self, seconds: float) -> None:
        """Let wall time pass until the next slice is due."""
        time.sleep(seconds)

    @property
    def addresses(self) -> dict[str, str]:
        """Where everything is, by name."""
        clock = "{}:{}".format(*self._clock.address)
        return {**self._own, "clock": clock, "control": str(self._control.path)}

    @property
    def elapsed(self) -> float:
        """Plant time since the start, s."""
        return self.ms / 1000

    @property
    def stamp(self) -> int:
        """Plant time as it is told, ns since 1970: the wall clock at the start, and plant time from there."""
        return self._start + self.ms * 1_000_000

    def achieved(self) -> tuple[float, float]:
        """Wall time since the rig began to run, s, and plant time per wall time over all of it."""
        return self.pace.overall(self.elapsed)

    def request_stop(self) -> None:
        """Let `run` return; from a signal handler too."""
        self._stop = True

    def run(self, watch: Callable[[], object] = lambda: None) -> None:
        """Let time pass until the duration is over or a stop is requested.

        `watch` is called now and then, a hundred times a second or so.

        Raises:
            TwinmatchError: a part has ended by itself.
        """
        self.pace = RigPace(self.settings.speed)
        while not self._stop and self.elapsed < self.settings.duration:
            wait = self.pace.wait(self.elapsed + self.slice / 1000)
            if wait > 0:
                self.rest(wait)
            if self._ahead_of_followers():
                self._clock.send(self.stamp)  # they may not have been told how late it is
                self.rest(_CLOCK_EVERY / 5)
                self._control.attend()
                continue
            self.step()
            self._control.attend()
            now = time.monotonic()
            if now - self._clock_told >= _CLOCK_EVERY or self.slice >= 5 * self.settings.speed:
                self._clock.send(self.stamp)
                self._clock_told = now
                watch()

    def step(self) -> None:
        """One slice of plant time, and the faults that begin or end with it."""
        for change in self.schedule.due(self.elapsed):
            self.turn(change.kind, on=change.begins)
            self.on_change(change)
        self.advance()

    def close(self) -> None:
        """End children, sockets, port and folder."""
        self._stack.close()

    def _ahead_of_followers(self) -> bool:
        """Whether those who follow the clock need a moment; never at the wall clock's own pace."""
        if self.settings.speed <= 1:
            return False
        done = self._clock.slowest(_PATIENCE)
        return done is not None and self.stamp - done > _LEASH * 1e9

    def _require(self, fault: Fault) -> Fault:
        if self.KINDS is not None and fault.kind not in self.KINDS:
            raise FaultError(
                f"fault {fault.kind!r}: not of this plant; it has {', '.join(sorted(self.KINDS))}"
            )
        return fault

    def _obey(self, line: str) -> str:
        """One line from the control socket.

        Raises:
            FaultError: it is no command.
        """
        if line == "state":
            return json.dumps(self.state())
        if line == "stop":
            self.request_stop()
            return ""
        word, _, kind = line.partition(" ")
        if word == "end":
            self.schedule.end(kind, self.elapsed)
            return ""
        if not line:
            raise FaultError("empty command; say KIND[+SECONDS], end KIND, state or stop")
        self.schedule.add(self._require(parse_now(line, self.elapsed)))
        return ""
