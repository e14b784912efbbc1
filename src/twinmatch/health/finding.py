"""Findings: what a trace shows at one sample, described in the words and units of a plant."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.dynamics import Plant
from twinmatch.health.answer import Answer
from twinmatch.health.record import Fault
from twinmatch.health.traces import Effect, Repeats
from twinmatch.signals import Sample

__all__ = ["Finding", "Words", "signed"]


class Finding(NamedTuple):
    """One trace of one fault."""

    fault: Fault
    sure: bool
    """Whether it has lasted long enough, or is large enough, to be reported."""
    first: int
    """Sample at which the trace begins."""
    reason: str
    slow: bool = False
    """Whether it was found by tracking the plant (`Slow`)."""


class Words:
    """Describes the traces of faults on one plant."""

    def __init__(self, plant: type[Plant], period: float) -> None:
        """`period` is the sample time, s."""
        self._period = period
        self.output = f"the {plant.output.text or plant.output.name}"
        self.unit = f" {plant.output.unit}".rstrip()
        self.input = plant.drive.unit or plant.drive.name
        self.sensor = f"look at the {plant.output.sensor}"
        self.surroundings = f"look at {plant.surroundings}"

    def impossible(self, sample: Sample) -> Finding:
        """A sample with impossible values."""
        reason = (
            f"{self.output} is {sample.output:g}{self.unit} at {sample.input:g} {self.input} and "
            f"set-point {sample.reference:g}{self.unit}, which is impossible: {self.sensor}"
        )
        return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)

    def leaping(self, before: Sample, sample: Sample, unexplained: float) -> Finding:
        """A step that the plant cannot have made."""
        reason = (
            f"{self.output} jumped from {before.output:.4g} to {sample.output:.4g}{self.unit} in one sample, "
            f"{abs(unexplained):.3g}{self.unit} more than the plant can explain: {self.sensor}"
        )
        return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)

    def frozen(self, sample: Sample, repeats: Repeats) -> Finding:
        """A sensor that repeats one reading."""
        reason = (
            f"{self.output} has been stuck at {sample.output:g}{self.unit} for "
            f"{repeats.count * self._period:g} s, while the plant should have moved "
            f"{signed(repeats.expected)}{self.unit} and the reading should have shown noise: {self.sensor}"
        )
        return Finding(Fault.SENSOR_FROZEN, True, sample.index - repeats.count, reason)

    def late(self, index: int, effect: Effect | Answer, lag: float, *, sure: bool) -> Finding:
        """Readings that lag behind the plant."""
        reason = f"{self.output} follows the drive with a delay of {lag:g} s: {self.sensor}"
        return Finding(Fault.SENSOR_LATE, sure, index - effect.length, reason)

    def lost(self, index: int, effect: Effect | Answer, *, sure: bool) -> Finding:
        """A drive without effect."""
        moved, shown = signed(effect.expected), signed(effect.share * effect.expected)
        reason = (
            f"the drive should have moved {self.output} by {moved}{self.unit} in "
            f"{effect.length * self._period:g} s; the readings show {shown}{self.unit} of that: "
            "look at drive, wires and supply"
        )
        return Finding(Fault.DRIVE_LOST, sure, index - effect.length, reason)

    def weak(self, index: int, effect: Effect | Answer, lasts: int, *, sure: bool) -> Finding:
        """A drive whose effect has been too small for `lasts` samples."""
        reason = (
            f"the drive has had {max(effect.share, 0.0):.0%} of its expected effect on {self.output} for "
            f"{lasts * self._period:g} s: look at drive, wires and supply"
        )
        return Finding(Fault.DRIVE_WEAK, sure, index - effect.length - lasts, reason)


def signed(value: float) -> str:
    """Format a change with its sign and two significant digits."""
    return f"{value:+.0f}" if abs(value) >= 100 else f"{value:+.2g}"
