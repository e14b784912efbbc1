"""The gate of a plant's output, and the parameters of its limits.

The node's callbacks provide the gate's inputs, the driver's thread asks it for decisions. All times there are
from a `SafetyClock`, which reads its clocks through one function, so that tests need neither clocks nor ROS.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from twinmatch.parameters.declared import Setting, group, parameters_of
from twinmatch.safety import (
    ClockLimits,
    FaultKind,
    GuardFault,
    GuardLimits,
    OutputGuard,
    SafetyClock,
)


class ClockTimes(NamedTuple):
    """The same moment on three clocks, ns."""

    stamps: int
    """The clock of the messages' stamps."""
    plant: int
    """The clock for deadlines: the simulated one if there is one, else the monotonic one."""
    wall: int
    """A monotonic clock of this machine."""


class Decision(NamedTuple):
    """What may be sent to the driver."""

    input: float
    """Command u, in the drive's unit."""
    armed: bool
    """Whether commands pass and the driver's deadline may be kept alive."""
    sample: int
    """Sample at which the command was computed."""
    time: float
    """Time of the decision, s of the safety clock."""


class OutputGate:
    """An `OutputGuard` with its clocks and a lock."""

    def __init__(
        self,
        read_clocks: Callable[[], ClockTimes],
        limits: GuardLimits | None = None,
        clock_limits: ClockLimits | None = None,
    ) -> None:
        """Start with the output at zero, waiting for inputs."""
        self._read_clocks = read_clocks
        self._guard = OutputGuard(limits)
        self._safety_clock = SafetyClock(clock_limits)
        self._index = 0
        self.commanded = 0
        """Stamp of the newest command, ns."""
        self._news = threading.Condition(threading.RLock())

    @property
    def fault(self) -> GuardFault | None:
        """The latched fault, if any."""
        with self._news:
            return self._guard.fault

    @property
    def armed(self) -> bool:
        """Whether commands passed at the last decision."""
        with self._news:
            return self._guard.armed

    @property
    def clock_stopped(self) -> bool:
        """Whether the plant's clock stands still, or has not been seen to move."""
        with self._news:
            return self._safety_clock.stopped

    def command(self, value: float, index: int, stamp: int) -> None:
        """Take a command sent at `stamp` (ns), computed at sample `index`."""
        with self._news:
            now, times = self._now()
            self._guard.command(value, now, (times.stamps - stamp) / 1e9)
            self._index, self.commanded = index, stamp
            self._news.notify_all()

    def temperature(self, celsius: float, stamp: int) -> None:
        """Take a temperature measured at `stamp` (ns)."""
        with self._news:
            now, times = self._now()
            self._guard.temperature(celsius, now, (times.stamps - stamp) / 1e9)
            self._news.notify_all()

    def sample(self, reference: float, temperature: float, drive: float) -> None:
        """Take one tick of the control loop."""
        with self._news:
            self._guard.loop(reference, temperature, drive, self._now()[0])
            self._news.notify_all()

    def trip(self, kind: FaultKind, message: str) -> None:
        """Latch a fault."""
        with self._news:
            self._guard.trip(kind, message, self._now()[0])
            self._news.notify_all()

    def clear(self) -> GuardFault | None:
        """Clear the fault and return it; the output waits for new inputs."""
        with self._news:
            fault = self._guard.fault
            self._guard.clear()
            return fault

    def decide(self) -> Decision:
        """What may be sent now. Nothing is armed while the plant's clock stands still."""
        with self._news:
            now, _ = self._now()
            clock = self._safety_clock
            if clock.stopped:
                if self._guard.armed:
                    message = f"/clock has stood still for {clock.standing:.1f} s; is the simulator running?"
                    self._guard.trip(FaultKind.CLOCK, message, now)
                return Decision(0.0, False, self._index, now)
            value = self._guard.output(now)
            return Decision(value, self._guard.armed, self._index, now)

    def wait(self, timeout: float) -> None:
        """Sleep until there is a new input, `timeout` seconds of the wall clock at most."""
        with self._news:
            self._news.wait(timeout)

    def _now(self) -> tuple[float, ClockTimes]:
        times = self._read_clocks()
        return self._safety_clock.read(times.plant, times.wall), times


def gate_table(usual: GuardLimits, note: str = "") -> tuple[Setting, ...]:
    """The parameters of the limits of a plant; `note` explains the default of the temperature's timeout."""
    most = max(map(abs, usual.commands))
    names = {"y": usual.unit, "u": usual.drive_unit, "note": note}
    silence, *others = parameters_of(usual, **names)
    *runaway, full = parameters_of(usual.runaway, "runaway.", **names)
    clock = "Zero when /clock stands still for this long, by the wall clock."
    return (
        silence,
        others[0],
        Setting("clock_timeout", ClockLimits().patience, clock, "s", 0.1, 60.0),
        *others[1:],
        *runaway,
        replace(full, low=most / 255.0, high=most),
    )


def gate_limits(usual: GuardLimits, values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values; the other limits are those of `usual`.

    Raises:
        SafetyError: values contradict each other.
    """
    own = {parameter.name: values[parameter.name] for parameter in parameters_of(usual)}
    return replace(usual, **own, runaway=replace(usual.runaway, **group(values, "runaway.")))
