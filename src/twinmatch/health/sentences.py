"""What is said of faults of one plant: what they concern, and the evidence for them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

from twinmatch.dynamics import Drive, Model, Output, Parameter
from twinmatch.health.faults import EVERY, TRAITS, Evidence, Fault, Subject, signed
from twinmatch.health.traces import DriveEffect, Repeats
from twinmatch.signals import Sample

if TYPE_CHECKING:  # a plant with one loop needs nothing of their arithmetic
    from twinmatch.health.hypotheses import PlacedFault
    from twinmatch.health.suspects import Suspect

LEARNED: Final = "what has changed has no name and is taken for how the plant is: the twin adapts to it"
"""Why a change without a name is reported no longer though it stays."""


class FaultSentences:
    """Names what faults concern, and describes the evidence for them.

    The evidence is a trace, and each kind of trace has a method; or it is a hypothesis that explains the
    readings better than its rivals, and `changed` and `said` fill in the sentence of its row in `TRAITS`: on
    a plant with one loop, and on one with several.
    """

    def __init__(self, model: Model, period: float) -> None:
        """`period` is the sample time, s."""
        self._model = model
        self._plant = model.plant
        self._period = period
        self._drives = list(model.plant.drives.items())
        self._outputs = list(model.plant.outputs.items())
        self.surroundings = model.plant.surroundings

    @cached_property
    def output(self) -> str:
        """The output of a single loop, in words; like the properties below it, only there."""
        return f"the {self._plant.output.text or self._plant.output.name}"

    @cached_property
    def unit(self) -> str:
        """Its unit, as it follows a number."""
        return f" {self._plant.output.unit}".rstrip()

    @cached_property
    def input(self) -> str:
        """Unit or name of the input."""
        return self._plant.drive.unit or self._plant.drive.name

    @cached_property
    def sensor(self) -> str:
        """The sensor of the output, in words."""
        return f"the {self._plant.output.sensor}"

    @cached_property
    def _other(self) -> str:
        return "thermometer" if self._plant.output.unit == "°C" else "instrument"

    @cached_property
    def _all_drives(self) -> str:
        *others, last = [drive.text or name for name, drive in self._drives]
        return f"{', '.join(others)} and {last}"

    def _concerned(self, cause: PlacedFault) -> tuple[str, Drive | Output | Parameter]:
        """Name of what a fault concerns, and what the plant file declares of it."""
        fault, place = cause
        if place == EVERY:
            return "", replace(self._drives[0][1], text=self._all_drives)
        subject = TRAITS[fault].subject
        if subject is Subject.PARAMETER:
            name = self._model.structure.free[place]
            return name, self._model.declared[name]
        if subject is Subject.DRIVE or fault is Fault.DRIFT:
            # what has no name pushes as a drive does
            return self._drives[place]
        return self._outputs[place]

    def signal(self, fault: Fault) -> str:
        """Name of what a fault of a plant with one loop concerns; empty where it may be anything."""
        traits = TRAITS[fault]
        if traits.subject is Subject.ANYTHING:
            return ""
        if traits.subject is Subject.PARAMETER:
            return self._parameter(traits.role)
        name, _ = self._concerned((fault, 0))
        return name

    def _parameter(self, role: str) -> str:
        """Name of the first parameter with a role; empty if the plant file gives it to none."""
        for name, declared in self._plant.parameters.items():
            if declared.role == role:
                return name
        return ""

    def refused(self, before: Sample | None, sample: Sample) -> Evidence:
        """A reading that the plant cannot have, or cannot have reached from the sample before."""
        [reading] = sample.refused
        low, high = self._plant.output.readable
        if before is None or not low <= reading <= high:
            reason = (
                f"{self.output} is {reading:g}{self.unit} at {sample.input:g} {self.input}, "
                f"which is impossible: look at {self.sensor}"
            )
        else:
            reason = (
                f"{self.output} jumped from {before.output:.4g} to {reading:.4g}{self.unit} in one sample, "
                f"{abs(reading - sample.output):.3g}{self.unit} more than the plant can explain: "
                f"look at {self.sensor}"
            )
        return Evidence(
            Fault.SENSOR_IMPLAUSIBLE, sure=True, first=sample.index, reason=reason
        )

    def recurring(self) -> str:
        """Steps that were called impossible, and have come again and again."""
        return (
            f"{Fault.SENSOR_IMPLAUSIBLE.value} is taken back: steps of {self.output} as large as those that "
            "were refused recur, and its readings continue from there, so the plant makes them"
        )

    def frozen(self, sample: Sample, repeats: Repeats) -> Evidence:
        """A sensor that repeats one reading."""
        reason = (
            f"{self.output} has been stuck at {sample.output:g}{self.unit} for "
            f"{repeats.count * self._period:g} s, while the plant should have moved "
            f"{signed(repeats.expected)}{self.unit} and the reading should have shown noise: "
            f"look at {self.sensor}"
        )
        first = sample.index - repeats.count
        return Evidence(Fault.SENSOR_FROZEN, sure=True, first=first, reason=reason)

    def late(
        self, index: int, effect: DriveEffect, lag: float, *, sure: bool
    ) -> Evidence:
        """Readings that lag behind the plant."""
        reason = f"{self.output} follows the drive with a delay of {lag:g} s: look at {self.sensor}"
        return Evidence(Fault.SENSOR_LATE, sure, index - effect.length, reason)

    def lost(
        self, index: int, effect: DriveEffect, *, sure: bool, lagged: bool = False
    ) -> Evidence:
        """A drive without effect. Behind a lag, much larger losses look the same for minutes."""
        moved = signed(effect.expected)
        shown = signed(effect.share * effect.expected)
        alternative = ", or the plant loses far more than before" if lagged else ""
        where = f", and at {self.surroundings}" if lagged else ""
        reason = (
            f"the drive should have moved {self.output} by {moved}{self.unit} in "
            f"{effect.length * self._period:g} s; the readings show {shown}{self.unit} of that: the drive is "
            f"lost, or {self.sensor} does not see it{alternative}; look at drive, wires, supply and "
            f"sensor{where}"
        )
        return Evidence(Fault.DRIVE_LOST, sure, index - effect.length, reason)

    def weak(
        self, index: int, effect: DriveEffect, lasts: int, *, sure: bool
    ) -> Evidence:
        """A drive whose effect has been too small for `lasts` samples."""
        reason = (
            f"the drive has had {max(effect.share, 0.0):.0%} of its expected effect on {self.output} for "
            f"{lasts * self._period:g} s: look at drive, wires and supply"
        )
        return Evidence(Fault.DRIVE_WEAK, sure, index - effect.length - lasts, reason)

    def doubted(self, offset: float) -> str:
        """Readings that may have shifted."""
        return (
            f"the readings of {self.output} may be off by about {signed(offset)}{self.unit}: "
            f"compare them with another {self._other}"
        )

    def changed(
        self, fault: Fault, parameter: Parameter | None, shift: float, share: float
    ) -> str:
        """What has changed on a plant with one loop, by how much, and where to look.

        `shift` is that of the reading, or of the `parameter` that has changed; `share` is what is left of the
        drive's effect.
        """
        name = self.output
        unit = self._plant.output.unit
        if TRAITS[fault].subject is Subject.DRIVE:
            name = "the drive"
        elif parameter is not None:
            name = parameter.text or parameter.name
            unit = parameter.unit
        _, size = _size(fault, shift, share, unit)
        return self._filled(fault, name, size, sensor=self.sensor)

    def _filled(
        self,
        fault: Fault,
        name: str,
        size: str,
        *,
        sensor: str = "",
        rivals: Sequence[str] = (),
    ) -> str:
        """The sentence of a fault's row in `TRAITS`."""
        return TRAITS[fault].sentence.format(
            name=name,
            size=size,
            sensor=sensor,
            surroundings=self.surroundings,
            rivals=" or ".join(rivals),
        )

    def passed(self, moved: float, lasted: float) -> str:
        """What has moved the output for a while."""
        return (
            f"something other than the drive moved {self.output} for about {lasted:g} s, by "
            f"{signed(moved)}{self.unit} in all, and has ceased: look at {self.surroundings}"
        )

    def called(self, cause: PlacedFault) -> str:
        """What may have changed, in words."""
        name, declared = self._concerned(cause)
        return TRAITS[cause[0]].suspect.format(name=declared.text or name)

    def signal_of(self, output: int) -> str:
        """Name of an output in the plant file."""
        name, _ = self._outputs[output]
        return name

    def _all_of(self, outputs: list[int]) -> str:
        """Some outputs in words."""
        names = [
            output.text or name for name, output in (self._outputs[i] for i in outputs)
        ]
        return " and ".join(names)

    def jumped(self, outputs: list[int]) -> str:
        """A sentence on outputs whose readings have jumped at once."""
        return (
            f"the readings of {self._all_of(outputs)} jumped at once, and the samples do not tell which of "
            "them is right: look at what the sensors share, such as their supply; none is read through"
        )

    def ran_away_at_once(self, outputs: list[int]) -> str:
        """A sentence on outputs whose readings have moved at once, farther than their plant can."""
        return (
            f"the readings of {self._all_of(outputs)} have moved at once, farther than the plant can: look at what "
            "the sensors share, such as their supply, and whether they sit where they should; none is read through"
        )

    def ran_away(self, output: int, moved: float) -> str:
        """A sentence on an output whose reading has moved farther than its plant can."""
        name, declared = self._outputs[output]
        size = f"{signed(moved)} {declared.unit}".rstrip()
        return (
            f"the readings of {declared.text or name} have moved by {size} within seconds, farther than the plant "
            f"can: look at the {declared.sensor}, and whether it sits where it should"
        )

    @staticmethod
    def blind(reason: str) -> str:
        """A sentence on a sensor, where none is left by which it could be read through."""
        return f"{reason}; no sensor is right, so none can be read through"

    def was_frozen(self, output: int, samples: int) -> str:
        """A sentence on an output that has repeated one reading, and moves again where it is expected."""
        name, declared = self._outputs[output]
        return (
            f"{declared.text or name} repeated one reading for {samples * self._period:g} s, and moved then to where "
            f"the twin expected it: look at the {declared.sensor}"
        )

    def said(
        self, fault: Fault, best: Suspect, share: float, rivals: tuple[str, ...]
    ) -> tuple[str, float, str]:
        """Name of the signal, size of the change, and a sentence; `share` is what is left of a drive's
        effect."""
        name, declared = self._concerned(best.cause)
        size, text = _size(fault, best.shift, share, declared.unit)
        if best.cause[1] == EVERY and fault is not Fault.DRIFT:
            left = (
                "no effect" if fault is Fault.DRIVE_LOST else f"{text} of their effect"
            )
            return (
                name,
                size,
                f"{self._all_drives} have {left}: look at what they share, such as their supply",
            )
        if fault is Fault.DRIFT and len(rivals) == 1:
            return (
                name,
                size,
                f"the plant behaves as if {rivals[0]} had begun: look at {self.surroundings}",
            )
        called = declared.text or name
        sensor = f"the {declared.sensor}" if isinstance(declared, Output) else ""
        reason = self._filled(fault, called, text, sensor=sensor, rivals=rivals)
        return name, size, reason


def _size(fault: Fault, shift: float, share: float, unit: str) -> tuple[float, str]:
    """How large a change is, as a number and in words; NaN where a fault has no size.

    `shift` is that of a reading or a parameter, in its `unit`; of losses it is a share of what they were.
    `share` is what is left of a drive's effect.
    """
    if fault is Fault.LOSSES_CHANGED:
        factor = max(1.0 + shift, 0.0)
        return factor, f"{factor:.2g} times"
    if fault in {Fault.DRIVE_LOST, Fault.DRIVE_WEAK}:
        return share, f"{share:.0%}"
    if fault in {Fault.SENSOR_DRIFT, Fault.ROOM_CHANGED}:
        return shift, f"{signed(shift)} {unit}".rstrip()
    return math.nan, ""
