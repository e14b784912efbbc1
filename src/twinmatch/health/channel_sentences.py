"""Describes the faults of a plant with several signals, each by its drive, sensor or parameter."""

from __future__ import annotations

import math
from typing import Final

from twinmatch.dynamics import Drive, Model, Output, Parameter
from twinmatch.health.evidence import Suspect
from twinmatch.health.faults import Fault, signed
from twinmatch.health.hypotheses import Named

_SAID: Final = {
    Fault.SENSOR_DRIFT: "the readings of {name} are off by about {size}: compare with another instrument",
    Fault.SENSOR_FROZEN: "{name} repeats one reading, and should have moved: look at its sensor",
    Fault.SENSOR_IMPLAUSIBLE: "{name} is read as what it cannot be: look at its sensor",
    Fault.DRIVE_LOST: "{name} has no effect: look at it, its wires and its supply",
    Fault.DRIVE_WEAK: "{name} has {size} of its effect: look at it, its wires and its supply",
    Fault.LOSSES_CHANGED: "losses ({name}) are {size} what they were: look at {surroundings}",
    Fault.ROOM_CHANGED: "{name} has changed by {size}: look at {surroundings}",
    Fault.DISTURBANCE: "something other than the drives moved {name} and has ceased: look at {surroundings}",
    Fault.DRIFT: "the plant behaves differently, and the samples do not tell apart: {rivals}",
}
_CALLED: Final = {
    Fault.SENSOR_DRIFT: "the reading of {name}",
    Fault.SENSOR_FROZEN: "a frozen {name}",
    Fault.SENSOR_IMPLAUSIBLE: "an impossible {name}",
    Fault.DRIVE_LOST: "the drive {name}",
    Fault.DRIVE_WEAK: "the drive {name}",
    Fault.LOSSES_CHANGED: "losses ({name})",
    Fault.ROOM_CHANGED: "{name}",
    Fault.DISTURBANCE: "a passing push on {name}",
    Fault.DRIFT: "something that acts as {name} does",
}


class ChannelSentences:
    """Names the signals of one plant."""

    def __init__(self, model: Model) -> None:
        self._model = model
        plant = model.plant
        self._drives = list(plant.drives.items())
        self._outputs = list(plant.outputs.items())

    def _declared(self, cause: Named) -> tuple[str, Drive | Output | Parameter]:
        fault, place = cause
        if fault in {Fault.LOSSES_CHANGED, Fault.ROOM_CHANGED}:
            name = self._model.structure.free[place]
            return name, self._model.declared[name]
        driven = fault in {Fault.DRIVE_LOST, Fault.DRIVE_WEAK, Fault.DRIFT}
        return self._drives[place] if driven else self._outputs[place]

    def called(self, cause: Named) -> str:
        """What may have changed, in words."""
        name, declared = self._declared(cause)
        return _CALLED[cause[0]].format(name=declared.text or name)

    def said(
        self, fault: Fault, best: Suspect, share: float, rivals: tuple[str, ...]
    ) -> tuple[str, float, str]:
        """Name of the signal, size of the change, and a sentence; `share` of a drive's effect is left."""
        name, declared = self._declared(best.cause)
        size = math.nan
        text = ""
        unit = declared.unit
        if fault is Fault.LOSSES_CHANGED:
            size = math.exp(best.shift)
            text = f"{size:.2g} times"
        elif fault in {Fault.DRIVE_LOST, Fault.DRIVE_WEAK}:
            size = share
            text = f"{share:.0%}"
        elif fault in {Fault.SENSOR_DRIFT, Fault.ROOM_CHANGED}:
            size = best.shift
            text = f"{signed(best.shift)} {unit}".rstrip()
        around = self._model.plant.surroundings
        reason = _SAID[fault].format(
            name=declared.text or name, size=text, surroundings=around, rivals=" or ".join(rivals)
        )
        return name, size, reason
