"""The faults of a virtual plant, their schedule, and the socket on which they are commanded.

A fault is written `KIND@SECONDS`, which lasts to the end, or `KIND@SECONDS+DURATION`. Of a plant with several
drives and sensors, `KIND.2` is that of the second. Times are in seconds of
plant time from the start of the rig. Commands are lines on a socket in the rig's private folder, with one
answer each:

    KIND[+SECONDS]   start a fault now             end KIND   end it
    state            report the rig's state        stop       end the rig
"""

from __future__ import annotations

import difflib
import math
import socket
from bisect import insort
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.emulation.clock import LineServer
from twinmatch.errors import TwinmatchError
from twinmatch.settings import Rule

KINDS: Final = {
    "drive-lost": "a wire to the plate breaks: no current at any command",
    "driver-fault": "the motor driver sets its fault flag",
    "board-hung": "the firmware hangs once, until its watchdog restarts it",
    "cable-pulled": "the board's USB cable is unplugged; the board keeps its power",
    "garbage-serial": "another program writes to the serial line and takes replies away",
    "camera-gone": "the camera's program is killed; at the end of the fault it is restarted",
    "garbage-camera": "another program at the camera's address sends noise",
    "sensor-frozen": "the camera repeats its last image and frame counter",
    "sensor-drifts": "the readings fall by 0.8 °C each second",
    "sensor-offset": "the readings are 5 °C too high",
    "sensor-slips": "the sensor slips off within 20 s, and then reads the room",
    "fan-failed": "the fan stops: the heat sink keeps a tenth of its convection",
    "ambient-step": "the surroundings become 10 °C warmer",
}
"""Every fault and its effect; a virtual plant names those that it simulates."""

OF_READINGS: Final = ("sensor-drifts", "sensor-offset", "sensor-slips")
"""Those that `FaultSchedule.told` simulates, for every virtual plant that asks it."""


class SensorErrors(Rule):
    """How far the faults of sensors take a reading from the temperature."""

    drift: float = 0.8
    """Rate at which the readings of `sensor-drifts` fall, °C/s."""
    offset: float = 5.0
    """What `sensor-offset` adds to the readings, °C."""
    slip: float = 20.0
    """Time constant of `sensor-slips`, s."""


_ERRORS: Final = SensorErrors()
_PATIENCE = 5.0
"""Longest wait for the answer to a command, s."""


class FaultError(TwinmatchError):
    """A fault does not exist, or has an invalid time."""


class RigFault(NamedTuple):
    """One fault."""

    kind: str
    start: float
    """Plant time at which it starts, s."""
    duration: float = math.inf
    """How long it lasts, s."""


class Change(NamedTuple):
    """The start or the end of a fault."""

    time: float
    """Plant time, s."""
    kind: str
    begins: bool


def parse_faults(text: str) -> tuple[RigFault, ...]:
    """Faults from a comma-separated list of `KIND@SECONDS` and `KIND@SECONDS+SECONDS`.

    Raises:
        FaultError: there is no such kind, or a time is invalid.
    """
    return tuple(map(_parse_fault, text.split(",")))


def parse_now(text: str, now: float) -> RigFault:
    """A fault that begins `now`, from `KIND` or `KIND+SECONDS`.

    Raises:
        FaultError: there is no such kind, or the duration is invalid.
    """
    kind, plus, duration = text.strip().partition("+")
    _check_kind(kind)
    return RigFault(kind, now, _duration(text, plus, duration))


def _parse_fault(text: str) -> RigFault:
    kind, mark, times = text.strip().partition("@")
    _check_kind(kind)
    start, plus, duration = times.partition("+")
    if not mark:
        raise FaultError(
            f"fault {text!r}: no time; write {kind}@SECONDS or {kind}@SECONDS+DURATION"
        )
    return RigFault(kind, _seconds(text, start, 0.0), _duration(text, plus, duration))


def _check_kind(kind: str) -> None:
    name, dot, number = kind.partition(".")
    if name not in KINDS or (dot and not number.isdigit()):
        near = difflib.get_close_matches(name, KINDS, n=1)
        hint = (
            f"did you mean {near[0]}?" if near else f"choose one of {', '.join(KINDS)}"
        )
        raise FaultError(f"fault {kind!r} does not exist; {hint}")


def _duration(text: str, plus: str, number: str) -> float:
    return _seconds(text, number, 1e-3) if plus else math.inf


def _seconds(text: str, number: str, least: float) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        raise FaultError(
            f"fault {text!r}: {number!r} is not a time; give seconds of plant time"
        )
    return value


class FaultSchedule:
    """Scheduled and active faults."""

    def __init__(self, faults: Iterable[RigFault] = ()) -> None:
        # by time, simultaneous ones in the order of their commands
        self._changes: list[Change] = []
        self._on: dict[str, int] = {}
        self._since: dict[str, float] = {}
        for fault in faults:
            self.add(fault)

    @property
    def active(self) -> tuple[str, ...]:
        """Active kinds, in the order in which they started."""
        return tuple(self._on)

    def acts(self, kind: str, number: int) -> bool:
        """Whether a kind is active of the drive or sensor of this number."""
        return kind in self._on or f"{kind}.{number}" in self._on

    def lasted(self, kind: str, now: float, number: int = 1) -> float:
        """For how long a kind has been active of the sensor of this number, s; 0 if it is not."""
        since = [
            self._since[name] for name in (kind, f"{kind}.{number}") if name in self._on
        ]
        return now - min(since, default=now)

    def told(self, true: float, room: float, now: float, number: int = 1) -> float:
        """What the sensor of this number tells of a temperature, °C: it may be off, drift or slip off."""
        contact = math.exp(-self.lasted("sensor-slips", now, number) / _ERRORS.slip)
        offset = _ERRORS.offset * self.acts("sensor-offset", number)
        drift = _ERRORS.drift * self.lasted("sensor-drifts", now, number)
        error = offset - drift
        return room + (true - room) * contact + error

    def add(self, fault: RigFault) -> None:
        """Put a fault on the schedule."""
        self._push(fault.start, fault.kind, begins=True)
        if math.isfinite(fault.duration):
            self._push(fault.start + fault.duration, fault.kind, begins=False)

    def end(self, kind: str, now: float) -> None:
        """End the active fault of a kind, and cancel those scheduled.

        Raises:
            FaultError: there is no such kind.
        """
        _check_kind(kind)
        self._changes = [change for change in self._changes if change.kind != kind]
        if kind in self._on:
            self._on[kind] = 1
            self._push(now, kind, begins=False)

    def due(self, now: float) -> list[Change]:
        """Kinds that turn on or off by this time. If faults of one kind overlap, the last end counts."""
        turned = []
        while self._changes and self._changes[0].time <= now + 1e-9:
            change = self._changes.pop(0)
            before = self._on.get(change.kind, 0)
            self._on[change.kind] = before + (1 if change.begins else -1)
            if not self._on[change.kind]:
                del self._on[change.kind]
            if bool(before) != (change.kind in self._on):
                self._since[change.kind] = change.time
                turned.append(change)
        return turned

    def _push(self, time: float, kind: str, *, begins: bool) -> None:
        insort(
            self._changes, Change(time, kind, begins), key=lambda change: change.time
        )


class RigControlError(TwinmatchError):
    """A virtual rig cannot be reached, or refused a command."""


class ControlServer(LineServer):
    """The rig's side: the rig's loop calls `attend`."""

    def __init__(self, path: Path, obey: Callable[[str], str]) -> None:
        self.path = path
        self._obey = obey
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(path))
        listener.listen(8)
        super().__init__(listener)

    def attend(self) -> None:
        """Answer pending commands."""
        for client, line in self.hear():
            try:
                answer = f"ok {self._obey(line.decode(errors='replace').strip())}"
            except TwinmatchError as error:
                answer = f"error {error}"
            self.put(client, answer.strip().encode() + b"\n")

    def close(self) -> None:
        """Close everything and remove the socket."""
        super().close()
        self.path.unlink(missing_ok=True)


def tell(path: str | Path, line: str) -> str:
    """Send a line to the rig with its control socket at `path`; returns its answer without `ok`.

    Raises:
        RigControlError: there is no such rig, or it refused the command.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(_PATIENCE)
            connection.connect(str(path))
            connection.sendall(line.encode() + b"\n")
            answer = connection.makefile("r", encoding="utf-8").readline().strip()
    except OSError as error:
        msg = (
            f"virtual rig at {path}: {error}; give the address it prints as `control:`"
        )
        raise RigControlError(msg) from error
    verdict, _, text = answer.partition(" ")
    if verdict != "ok":
        raise RigControlError(f"virtual rig: {text or 'no answer'}")
    return text
