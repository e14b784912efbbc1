"""A running FMU: initialise, advance, read. Used only in the FMU's own process.

Values are in the FMU's units. As used here, FMI 2 and FMI 3 differ only in names.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from twinmatch.fmu.calls import Calls
from twinmatch.fmu.straight import Addresses, Rooms

__all__ = ["Machine", "MachineError", "Wires"]


class MachineError(Exception):
    """The FMU cannot be run, or violates FMI."""


class Wires(NamedTuple):
    """Value references of the variables that are set and read."""

    fixed: list[int]
    """Set before a run: parameters, and initial states."""
    inputs: list[int]
    """Drive, then disturbances."""
    states: list[int]
    """States to read."""
    output: list[int]


class Machine:
    """A co-simulation FMU, which has its own solver."""

    def __init__(self, fmu: Any, major: int, wires: Wires) -> None:
        self.fmu, self.major, self.wires = fmu, major, wires
        self._begun, self._resets = False, True
        self._calls = calls = Calls(fmu, major)
        self._fixed, self._inputs, self._states, self._output = (calls.group(own) for own in wires)
        self.time = 0.0
        self._at: dict[str, int] = {}

    def put(self, fixed: Sequence[float], inputs: Sequence[float]) -> None:
        """Initialise with these values."""
        fmu = self.fmu
        if self._begun:
            self._reset()
        self._begun, self.time = True, 0.0
        if self.major == 2:
            fmu.setupExperiment(startTime=0.0)
        self._fixed.write(fixed)
        if self.major == 2:
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=0.0)
        self._inputs.write(inputs)
        fmu.exitInitializationMode()

    def straight(self) -> tuple[Addresses, Rooms] | None:
        """The arguments of a compiled run from the current state; None if it may have events."""
        if not self._at:
            real = "Real" if self.major == 2 else "Float64"
            names = (f"Get{real}", f"Set{real}")
            self._at = {
                **dict(zip(("get", "set"), map(self._calls.address, names), strict=True)),
                **dict(zip(("inputs", "states", "output"), self._references(), strict=True)),
                **{name: self._calls.address(of) if of else 0 for name, of in self._functions().items()},
            }
            sizes = (len(self.wires.inputs), len(self.wires.states), 1, self._size, self._size)
            inputs, states, output, x, dx = map(np.zeros, sizes)
            self._rooms = Rooms(inputs, states, output, x, dx, np.zeros(8, dtype=np.int32))
        return Addresses(component=self.fmu.component, **self._at), self._rooms

    _size = 0
    """Number of continuous states that are integrated here."""

    def _functions(self) -> dict[str, str]:
        """Names of the functions that advance it, by the fields of `Addresses`; empty ones are not called."""
        none = dict.fromkeys(("set_time", "set_x", "get_x", "get_dx", "after_step"), "")
        return {**none, "do_step": "DoStep"}

    def _references(self) -> list[int]:
        return [group.address for group in (self._inputs, self._states, self._output)]

    def forget(self) -> None:
        """Do nothing after an error: `put` always initialises again."""

    def feed(self, inputs: Sequence[float]) -> None:
        """Set drive and disturbances."""
        self._inputs.write(inputs)

    def move(self, period: float, steps: int) -> None:  # noqa: ARG002 (it chooses its own steps)
        """Advance by one period."""
        result = self.fmu.doStep(self.time, period)
        if self.major == 3 and (result[1] or result[2]):
            raise MachineError("it terminated the simulation, or returned early")
        self.time += period

    def states(self) -> list[float]:
        """The current states."""
        return self._states.read()

    def output(self) -> float:
        """The current output."""
        return self._output.read()[0]

    def _reset(self) -> None:
        """Reset the instance, or replace it if the FMU cannot be reset."""
        from fmpy.fmi1 import FMICallException  # noqa: PLC0415 (an extra)

        fmu = self.fmu
        if self._resets:
            try:
                fmu.reset()
            except FMICallException:
                self._resets = False
            else:
                return
        if self.major == 2:
            fmu.fmi2FreeInstance(fmu.component)
        else:
            fmu.fmi3FreeInstance(fmu.component)
        fmu.instantiate()
