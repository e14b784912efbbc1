"""Base of every virtual plant: a process that owns plant time, serves it, and accepts commands.

Time advances in small slices, at a multiple of the wall clock's speed. A plant that may run faster than real
time goes in step with the readers of its clock that answer: it stands still until all let it continue.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import shutil
import tempfile
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, TypeVar

from twinmatch.emulation.clock import ClockServer
from twinmatch.emulation.faults import (
    Change,
    ControlServer,
    FaultError,
    FaultSchedule,
    RigFault,
    parse_now,
)
from twinmatch.errors import TwinmatchError

_Own = TypeVar("_Own", bound="VirtualPlantTime")

_FOLDERS = "twinmatch-rig-"
"""Beginning of the names of private folders."""


class VirtualRigError(TwinmatchError):
    """A virtual plant cannot be created as requested."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """Settings of a virtual plant.

    Raises:
        VirtualRigError: speed, duration or seed is out of range.
    """

    speed: float = 1.0
    """Plant time per wall time, at most; infinite: as fast as the machine allows."""
    in_step: bool = False
    """Whether plant time is faster than real time only while a process that commands the plant keeps step."""
    board: str = "auto"
    """One of `arduino_virtual.BOARDS`; for the Peltier rig."""
    seed: int = 0
    """Seed of the sensor's noise and of the faults."""
    faults: tuple[RigFault, ...] = ()
    duration: float = math.inf
    """Plant time after which it ends, s."""

    def __post_init__(self) -> None:
        if not (0.01 <= self.speed <= 1000 or self.speed == math.inf):
            msg = f"virtual rig: the speed is {self.speed}; give 0.01 to 1000 times the wall clock, or max"
            raise VirtualRigError(msg)
        if not self.duration > 0:
            raise VirtualRigError(
                f"virtual rig: the duration is {self.duration} s; it must be positive"
            )
        if self.seed < 0:
            raise VirtualRigError(
                f"virtual rig: the seed is {self.seed}; give 0 or more"
            )


class VirtualPlantTime(ABC):
    """A plant whose time stands still until `step` or `run`; a context manager.

    A subclass creates its parts in `make`.

    Raises:
        TwinmatchError: a part cannot be created, or the plant does not have a requested fault.
    """

    _CLOCK_EVERY: Final = 0.005
    """Shortest wall time between two updates of the clock, s."""
    _ATTEND_EVERY: Final = 0.01
    """Interval at which commands are obeyed, wall s."""
    _REPEAT: Final = 0.2
    """Longest time without an update of the clock, which may get lost, wall s."""
    _BREATH: Final = 0.02
    """Longest time without an update while the board's answer is awaited: it usually comes first, wall s."""
    _SLICE: Final = 20
    """Longest slice, ms of plant time."""

    board_kind: str
    """Kind of its board, in a word."""
    board_remark: str
    """Remark on its board."""
    STANDING: ClassVar = 0.01
    """Longest wait for the readers of the clock, wall s; one that speaks ends it."""
    KINDS: ClassVar[frozenset[str]]
    """Faults that this plant simulates; others are refused."""

    def __init__(self, settings: RigSettings | None = None) -> None:
        self.settings = settings or RigSettings()
        self.on_change: Callable[[Change], None] = lambda _: None
        """Called when a fault starts or ends."""
        for fault in self.settings.faults:
            self._require(fault)
        self.schedule = FaultSchedule(self.settings.faults)
        self._stop = False
        self.ms = 0
        """Plant time since the start, ms."""
        self.pace = RigPace(self.settings.speed)
        self._longest = max(1, round(min(10 * self.settings.speed, self._SLICE)))
        self.slice = self._longest
        """Plant time of one step, ms."""
        # At real time and in step nobody needs the time more often, and every node of the graph receives it.
        if self.settings.speed <= 1:
            self._every = 4 * self._CLOCK_EVERY
        elif self.settings.in_step:
            self._every = 10 * self._CLOCK_EVERY
        else:
            self._every = self._CLOCK_EVERY
        self._clock_sent = 0.0
        self._stamp_sent = 0
        self._attended = 0.0
        with ExitStack() as stack:
            self.folder = stack.enter_context(_private_folder())
            self._own_addresses = self.make(stack)
            self._clock = ClockServer()
            stack.callback(self._clock.close)
            self._control = ControlServer(self.folder / "control", self._obey)
            stack.callback(self._control.close)
            self._start = time.time_ns()
            self._stack = stack.pop_all()

    def __enter__(self: _Own) -> _Own:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def make(self, stack: ExitStack) -> dict[str, str]:
        """Create the parts, which the stack will close; returns the addresses of some of them, by name."""

    @abstractmethod
    def advance(self) -> None:
        """Advance by one slice of plant time."""

    @abstractmethod
    def turn(self, kind: str, *, on: bool) -> None:
        """Start or end a fault."""

    @abstractmethod
    def state(self) -> dict[str, object]:
        """The state of the plant, for the command `state`."""

    def rest(self, seconds: float) -> None:
        """Wait, in wall time, until the next slice is due."""
        time.sleep(seconds)

    @property
    def addresses(self) -> dict[str, str]:
        """The addresses of all parts, by name."""
        clock = "{}:{}".format(*self._clock.address)
        return {
            **self._own_addresses,
            "clock": clock,
            "control": str(self._control.path),
        }

    @property
    def elapsed(self) -> float:
        """Plant time since the start, s."""
        return self.ms / 1000

    @property
    def stamp(self) -> int:
        """Plant time as served, ns since 1970: the wall clock at the start plus the elapsed plant time."""
        return self._start + self.ms * 1_000_000

    def achieved(self) -> tuple[float, float]:
        """Wall time since the start of the run, s, and mean plant time per wall time."""
        return self.pace.overall(self.elapsed)

    def request_stop(self) -> None:
        """Let `run` return; may be called from a signal handler."""
        self._stop = True

    def run(self, watch: Callable[[], object] = lambda: None) -> None:
        """Run until the duration is over or a stop is requested.

        `watch` is called about a hundred times per second.

        Raises:
            TwinmatchError: a part has ended unexpectedly.
        """
        self.pace = RigPace(self.settings.speed)
        limit = listened = 0.0
        while not self._stop and self.elapsed < self.settings.duration:
            if self.stamp >= limit and self.stamp >= (limit := self._listen()):
                self._stand()
                self._attend(watch)
                limit = self._listen(self.STANDING)
                continue
            self.slice = self._longest
            if limit < math.inf:
                self.slice = min(
                    self.slice, math.ceil((limit - self.stamp) / 1_000_000)
                )
            wait = self.pace.wait(self.elapsed + self.slice / 1000)
            if wait > 0:
                self.rest(wait)
            self.step()
            wall_now = time.monotonic()
            if wall_now - listened >= self._every:
                listened = wall_now
                # While driven it stops often, and tells the time there, unless who drives has a wrong time.
                if (
                    not self._clock.driven
                    or wall_now - self._clock_sent >= self._REPEAT
                ):
                    self._send_clock(wall_now)
                self._attend(watch)
                limit = self._listen()

    def step(self) -> None:
        """Advance by one slice of plant time, with the faults that start or end in it."""
        for change in self.schedule.due(self.elapsed):
            self.turn(change.kind, on=change.begins)
            self.on_change(change)
        self.advance()

    def close(self) -> None:
        """End children, sockets, port and folder."""
        self._stack.close()

    def settled(self, clock: ClockServer) -> bool:  # noqa: ARG002
        """Whether everything that it shows was taken; called again and again while the plant stands."""
        return True

    def _attend(self, watch: Callable[[], object]) -> None:
        wall_now = time.monotonic()
        if wall_now - self._attended >= self._ATTEND_EVERY:
            self._attended = wall_now
            self._control.attend()
            watch()

    def _listen(self, seconds: float = 0.0) -> float:
        """The time, ns, at which the plant has to wait for the readers of its clock; up to real time it never
        waits. Listens at most this long, until one speaks."""
        speed = self.settings.speed
        if speed <= 1:
            return math.inf
        self._clock.listen(seconds)
        if self.settings.in_step:
            self.pace.limit(speed if self._clock.driven else 1.0, self.elapsed)
        return self._clock.limit(self.stamp)

    def _stand(self) -> None:
        """Tell the readers the time once they have every image."""
        wall_now = time.monotonic()
        pause = self._BREATH if self._clock.breathing else 0.0
        if self._stamp_sent == self.stamp:
            pause = self._REPEAT
        if self.settled(self._clock) and wall_now - self._clock_sent >= pause:
            self._send_clock(wall_now)

    @property
    def driven(self) -> bool:
        """Whether a process that commands the plant keeps step with it."""
        return self._clock.driven

    def _send_clock(self, wall_now: float) -> None:
        self._clock.send(self.stamp)
        self._stamp_sent = self.stamp
        self._clock_sent = wall_now

    def _require(self, fault: RigFault) -> RigFault:
        if fault.kind not in self.KINDS:
            raise FaultError(
                f"fault {fault.kind!r}: not available for this plant; choose one of "
                f"{', '.join(sorted(self.KINDS))}"
            )
        return fault

    def _obey(self, line: str) -> str:
        """Execute one line from the control socket; returns the answer."""
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
            raise FaultError(
                "empty command; send KIND[+SECONDS], end KIND, state or stop"
            )
        self.schedule.add(self._require(parse_now(line, self.elapsed)))
        return ""


class RigPace:
    """Computes how long to wait before plant time may advance."""

    _MAX_LATE: Final = 0.2
    """Most plant time caught up after a delay, s, when it runs faster than the wall clock.

    Longer delays of a busy machine are lost: catching up in one jump would look like a silent host to the
    board, with its deadline of one second. At real time nothing is lost, because a real plant does not wait
    either.
    """
    _MIN_LATE: Final = 0.005
    """Wall time always caught up, s: the latency of waking up."""
    _RECENT: Final = 2.0
    """Wall time over which the achieved speed is averaged, s."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._real = speed <= 1
        self._start = self._wall = time.monotonic()
        self._plant = 0.0
        self._marks: deque[tuple[float, float]] = deque([(self._start, 0.0)])

    def wait(self, plant: float) -> float:
        """Wall time, s, until plant time `plant` (s since the start) is due; 0 if it already is."""
        wall_now = time.monotonic()
        self._mark(wall_now, plant)
        due = self._wall + (plant - self._plant) / self.speed
        late = (
            math.inf if self._real else max(self._MIN_LATE, self._MAX_LATE / self.speed)
        )
        if wall_now - due > late:
            self._wall = wall_now - late
            self._plant = plant
        return max(0.0, due - wall_now)

    def limit(self, speed: float, plant: float) -> None:
        """Continue at another speed from plant time `plant`, s."""
        if speed != self.speed:
            self.speed = speed
            self._wall = time.monotonic()
            self._plant = plant

    def achieved(self) -> float:
        """Recent plant time per wall time."""
        first_wall, first = self._marks[0]
        last_wall, last = self._marks[-1]
        return (
            (last - first) / (last_wall - first_wall) if last_wall > first_wall else 0.0
        )

    def overall(self, plant: float) -> tuple[float, float]:
        """Wall time since the start, s, and plant time per wall time over all of it."""
        wall = time.monotonic() - self._start
        return wall, plant / wall

    def _mark(self, wall_now: float, plant: float) -> None:
        if wall_now - self._marks[-1][0] > self._RECENT / 20:
            self._marks.append((wall_now, plant))
            while wall_now - self._marks[0][0] > self._RECENT:
                self._marks.popleft()


@contextlib.contextmanager
def _private_folder() -> Iterator[Path]:
    """A new private folder; folders left by killed rigs are removed first."""
    for leftover in Path(tempfile.gettempdir()).glob(f"{_FOLDERS}*"):
        _remove_if_left(leftover)
    folder = Path(tempfile.mkdtemp(prefix=_FOLDERS))
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _remove_if_left(folder: Path) -> None:
    """Remove a folder unless its rig is alive: then it is locked, or while starting has no lock file yet."""
    with contextlib.suppress(OSError), (folder / "lock").open("r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
