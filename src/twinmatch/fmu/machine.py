"""An FMU made to run: put somewhere, moved on, looked at. Only its own process uses this.

Values here are the FMU's own. FMUs of FMI 2 and of FMI 3 differ in names only, as far as they are used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from twinmatch.fmu.calls import Calls

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
        calls = Calls(fmu, major)
        self._fixed, self._inputs, self._states, self._output = (calls.group(own) for own in wires)
        self.time = 0.0

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

    def forget(self) -> None:
        """Something went wrong: nothing that it was told before counts any more."""

    def feed(self, inputs: Sequence[float]) -> None:
        """Drive and disturbances from now on."""
        self._inputs.write(inputs)

    def move(self, period: float, steps: int) -> None:  # noqa: ARG002 (it chooses its own steps)
        """On by one period."""
        self.fmu.doStep(self.time, period)
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
