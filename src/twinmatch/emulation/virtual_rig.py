"""The rig without the rig: plate, heat sink, board and camera behind the real serial port and TCP stream.

One process owns the plant's time. It steps the board in small slices, reads what the driver's pins do,
moves the plate, shows the driver's current to the board and the plate to the camera program, and tells
the time to whoever listens. Nothing of the production path is replaced: a host opens the serial port,
connects to the camera, and cannot tell the difference but by the time, which may pass faster.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from twinmatch.emulation.arduino_pins import Drive
from twinmatch.emulation.virtual_rig_board import SerialNoise, make_board
from twinmatch.emulation.virtual_rig_camera import Serving, VirtualCamera
from twinmatch.emulation.virtual_rig_clock import ClockServer
from twinmatch.emulation.virtual_rig_control import ControlServer
from twinmatch.emulation.virtual_rig_faults import Change, Fault, FaultError, Schedule, parse_now
from twinmatch.emulation.virtual_rig_folder import private_folder
from twinmatch.emulation.virtual_rig_pace import RigPace
from twinmatch.emulation.virtual_rig_plant import VirtualPlant
from twinmatch.errors import TwinmatchError

__all__ = ["RigSettings", "VirtualRig", "VirtualRigError"]

_FEEDBACK_EVERY = 100
"""Milliseconds of plant time between two changes of the current shown to the board."""
_CLOCK_EVERY = 0.005
"""Wall time between two updates of the clock at most, s."""
_LEASH = 0.25
"""Plant time that the rig runs ahead at most, s, of who says how far it has come: well within the second
that the board waits for a command."""
_PATIENCE = 3.0
"""Wall time after which it is not waited for any longer, s: it has died, or hangs."""


class VirtualRigError(TwinmatchError):
    """A virtual rig that cannot be made as asked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """How a virtual rig is to be.

    Raises:
        VirtualRigError: speed or duration is not positive, or too large to mean anything.
    """

    speed: float = 1.0
    """Plant time per wall time, at most."""
    board: str = "auto"
    """One of `virtual_rig_board.BOARDS`."""
    seed: int = 0
    """Of the camera's noise and of the faults."""
    faults: tuple[Fault, ...] = ()
    duration: float = math.inf
    """Plant time after which the rig ends, s."""

    def __post_init__(self) -> None:
        if not 0.01 <= self.speed <= 1000:
            msg = f"virtual rig: speed {self.speed}; give 0.01 to 1000 times the wall clock"
            raise VirtualRigError(msg)
        if not self.duration > 0:
            raise VirtualRigError(f"virtual rig: duration {self.duration} s; it must be positive")
        if self.seed < 0:
            raise VirtualRigError(f"virtual rig: seed {self.seed}; give 0 or more")


class VirtualRig:
    """A rig that stands until it is told to `step` or `run`; a context manager, since it has children.

    Raises:
        TwinmatchError: the board or the camera cannot be made.
    """

    def __init__(self, settings: RigSettings | None = None) -> None:
        self.settings = settings or RigSettings()
        self.plant = VirtualPlant()
        self.on_change: Callable[[Change], None] = lambda _: None
        """Called when a fault begins or ends."""
        self._schedule = Schedule(self.settings.faults)
        self._stop = False
        self._ms = 0
        self._pace = RigPace(self.settings.speed)
        self._slice = min(20, max(1, round(5 * self.settings.speed)))
        self._clock_told = 0.0
        with ExitStack() as stack:
            self._folder = stack.enter_context(private_folder())
            made = make_board(self.settings.board, self._folder / "ttyACM0")
            self._board, self.board_kind, self.board_remark = made
            stack.callback(self._board.close)
            self._camera = VirtualCamera(ambient=self.plant.plate, seed=1000 * self.settings.seed)
            stack.callback(self._camera.close)
            self._clock = ClockServer()
            stack.callback(self._clock.close)
            self._control = ControlServer(self._folder / "control", self._obey)
            stack.callback(self._control.close)
            self._noise = SerialNoise(self._board.port, self.settings.seed)
            self._drive = self._board.drive()
            self._start = time.time_ns()
            self._stack = stack.pop_all()

    def __enter__(self) -> VirtualRig:
        """Nothing to do: it stands since it was made."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()

    @property
    def addresses(self) -> dict[str, str]:
        """Where everything is, by name."""
        return {
            "camera": "{}:{}".format(*self._camera.address),
            "serial": self._board.port,
            "clock": "{}:{}".format(*self._clock.address),
            "control": str(self._control.path),
        }

    @property
    def elapsed(self) -> float:
        """Plant time since the start, s."""
        return self._ms / 1000

    @property
    def stamp(self) -> int:
        """Plant time as it is told, ns since 1970: the wall clock at the start, and plant time from there."""
        return self._start + self._ms * 1_000_000

    @property
    def drive(self) -> Drive:
        """What the driver's pins do."""
        return self._drive

    def achieved(self) -> tuple[float, float]:
        """Wall time since the rig began to run, s, and plant time per wall time over all of it."""
        return self._pace.overall(self.elapsed)

    def request_stop(self) -> None:
        """Let `run` return; from a signal handler too."""
        self._stop = True

    def run(self, watch: Callable[[], object] = lambda: None) -> None:
        """Let time pass until the duration is over or a stop is requested.

        `watch` is called now and then, a hundred times a second or so.

        Raises:
            TwinmatchError: the board or the camera program has ended by itself.
        """
        self._pace = RigPace(self.settings.speed)
        while not self._stop and self.elapsed < self.settings.duration:
            wait = self._pace.wait(self.elapsed + self._slice / 1000)
            if wait > 0:
                time.sleep(wait)
            if self._ahead_of_followers():
                time.sleep(_CLOCK_EVERY / 5)
                self._control.attend()
                continue
            self.step()
            self._control.attend()
            now = time.monotonic()
            if now - self._clock_told >= _CLOCK_EVERY or self._slice >= 5 * self.settings.speed:
                self._clock.send(self.stamp)
                self._clock_told = now
                watch()

    def _ahead_of_followers(self) -> bool:
        """Whether those who follow the clock need a moment; never at the wall clock's own pace."""
        if self.settings.speed <= 1:
            return False
        done = self._clock.slowest(_PATIENCE)
        return done is not None and self.stamp - done > _LEASH * 1e9

    def step(self) -> None:
        """One slice of plant time."""
        for change in self._schedule.due(self.elapsed):
            self._turn(change.kind, on=change.begins)
            self.on_change(change)
        seconds = self._slice / 1000
        self._advance_board()
        self.plant.advance(self._drive, seconds)
        before, self._ms = self._ms, self._ms + self._slice
        if self._ms // _FEEDBACK_EVERY != before // _FEEDBACK_EVERY:
            self._board.set_current(self.plant.feedback(self._drive))
        self._camera.see(self.elapsed, self.plant.seen, self.stamp)

    def _advance_board(self) -> None:
        if "garbage-serial" not in self._schedule.active:
            self._drive = self._board.advance(self._slice / 1000)
            return
        for _ in range(self._slice):  # the other program gets its chance between any two milliseconds
            self._drive = self._board.advance(0.001)
            self._noise.burst()

    def close(self) -> None:
        """End children, sockets, port and folder."""
        self._stack.close()

    def state(self) -> dict[str, object]:
        """What there is to know."""
        return {
            "time": self.elapsed,
            "plate": self.plant.plate,
            "sink": self.plant.sink,
            "pwm": self._drive.pwm,
            "enabled": self._drive.enabled,
            "current": self.plant.feedback(self._drive),
            "speed": self._pace.achieved(),
            "faults": list(self._schedule.active),
        }

    def _turn(self, kind: str, *, on: bool) -> None:
        """Let a fault begin or end."""
        if kind == "drive-lost":
            self.plant.wire_broken = on
        elif kind == "fan-failed":
            self.plant.fan_failed = on
        elif kind == "ambient-step":
            self.plant.warm_room = on
        elif kind == "sensor-frozen":
            self._camera.frozen = on
        elif kind == "driver-fault":
            self._board.set_fault(on)
        elif kind == "cable-pulled":
            (self._board.unplug if on else self._board.plug)()
        elif kind == "board-hung" and on:
            self._board.hang()
        elif kind in {"camera-gone", "garbage-camera"}:
            self._camera.serve(self._answering())

    def _answering(self) -> Serving:
        if "camera-gone" in self._schedule.active:
            return Serving.NOBODY
        return Serving.GARBAGE if "garbage-camera" in self._schedule.active else Serving.CAMERA

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
            self._schedule.end(kind, self.elapsed)
            return ""
        if not line:
            raise FaultError("empty command; say KIND[+SECONDS], end KIND, state or stop")
        self._schedule.add(parse_now(line, self.elapsed))
        return ""
