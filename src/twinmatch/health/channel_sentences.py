"""Describes the faults of a plant with several signals, each by its drive, sensor or parameter."""

from __future__ import annotations

import math
from dataclasses import replace

from twinmatch.dynamics import Drive, Model, Output, Parameter
from twinmatch.health.evidence import Suspect
from twinmatch.health.faults import TRAITS, Fault, Subject, signed
from twinmatch.health.hypotheses import EVERY, PlacedFault


class ChannelSentences:
    """Names the signals of one plant."""

    def __init__(self, model: Model) -> None:
        self._model = model
        plant = model.plant
        self._drives = list(plant.drives.items())
        self._all_drives = " and ".join(drive.text or name for name, drive in self._drives[:2])
        self._outputs = list(plant.outputs.items())

    def _declared(self, cause: PlacedFault) -> tuple[str, Drive | Output | Parameter]:
        """Name of what a fault concerns, and what the plant file declares of it."""
        fault, place = cause
        if place == EVERY:
            return "", replace(self._drives[0][1], text=self._all_drives)
        subject = TRAITS[fault].subject
        if subject is Subject.PARAMETER:
            name = self._model.structure.free[place]
            return name, self._model.declared[name]
        if subject is Subject.DRIVE or fault is Fault.DRIFT:  # what has no name pushes as a drive does
            return self._drives[place]
        return self._outputs[place]

    def called(self, cause: PlacedFault) -> str:
        """What may have changed, in words."""
        name, declared = self._declared(cause)
        return TRAITS[cause[0]].suspect.format(name=declared.text or name)

    def jumped(self, outputs: list[int]) -> tuple[str, str]:
        """Name of the first of the outputs whose readings have jumped at once, and a sentence."""
        names = [output.text or name for name, output in (self._outputs[i] for i in outputs)]
        reason = (
            f"the readings of {' and '.join(names)} jumped at once, and the samples do not tell which of "
            "them is right: look at what the sensors share, such as their supply; none is read through"
        )
        return self._outputs[outputs[0]][0], reason

    def said(
        self, fault: Fault, best: Suspect, share: float, rivals: tuple[str, ...]
    ) -> tuple[str, float, str]:
        """Name of the signal, size of the change, and a sentence; `share` is what is left of a drive's
        effect."""
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
        if best.cause[1] == EVERY:
            left = "no effect" if fault is Fault.DRIVE_LOST else f"{text} of their effect"
            return (
                name,
                size,
                f"{self._all_drives} have {left}: look at what they share, such as their supply",
            )
        around = self._model.plant.surroundings
        reason = TRAITS[fault].sentence.format(
            name=declared.text or name, size=text, surroundings=around, rivals=" or ".join(rivals)
        )
        return name, size, reason
