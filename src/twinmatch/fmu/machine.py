"""An FMU made to run: put somewhere, moved on, looked at. Only its own process uses this.

Values here are the FMU's own. FMUs of FMI 2 and of FMI 3 differ in names only, as far as they are used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from twinmatch.fmu.calls import Calls
from twinmatch.fmu.straight import Addresses, Rooms

__all__ = ["Machine", "MachineError", "Wires"]


class MachineError(Exception):
    """The FMU does not do what it should."""


class Wires(NamedTuple):
    """Value references of what is put in and looked at."""

    fixed: list[int]
    """What is set before a run begins: parameters, and where states start."""
    inputs: list[int]
    """Drive, then disturbances."""
    states: list[int]
    """Where they are read."""
    output: list[int]


class Machine:
    """One that moves itself (co-simulation)."""

    def __init__(self, fmu: Any, major: int, wires: Wires) -> None:
        self.fmu, self.major, self.wires = fmu, major, wires
        self._begun, self._resets = False, True
        self._calls = calls = Calls(fmu, major)
        self._fixed, self._inputs, self._states, self._output = (calls.group(own) for own in wires)
        self.time = 0.0
        self._at: dict[str, int] = {}

    def put(self, fixed: Sequence[float], inputs: Sequence[float]) -> None:
        """Begin anew with these values."""
        fmu = self.fmu
        if self._begun:
            self._renew()
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
        """What a run in compiled code needs, from where this has been put; None if it may have events."""
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
        """Names of what moves it on, by the fields of `Addresses`; empty ones are not called."""
        none = dict.fromkeys(("set_time", "set_x", "get_x", "get_dx", "after_step"), "")
        return {**none, "do_step": "DoStep"}

    def _references(self) -> list[int]:
        return [group.address for group in (self._inputs, self._states, self._output)]

    def forget(self) -> None:
        """Something went wrong: nothing that it was told before counts any more."""

    def feed(self, inputs: Sequence[float]) -> None:
        """Drive and disturbances from now on."""
        self._inputs.write(inputs)

    def move(self, period: float, steps: int) -> None:  # noqa: ARG002 (it chooses its own steps)
        """On by one period."""
        told = self.fmu.doStep(self.time, period)
        if self.major == 3 and (told[1] or told[2]):
            raise MachineError("it ended its simulation, or returned early")
        self.time += period

    def states(self) -> list[float]:
        """Where it is."""
        return self._states.read()

    def output(self) -> float:
        """What a sensor would say."""
        return self._output.read()[0]

    def _renew(self) -> None:
        """Back to where nothing was set."""
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
