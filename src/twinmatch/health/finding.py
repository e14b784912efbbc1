"""What a trace amounts to at one sample, in the words and units of a plant."""

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
    """Whether it has lasted long enough, or is large enough, to be told."""
    first: int
    """Sample at which it begins."""
    reason: str
    slow: bool = False
    """Whether it was found by following the plant."""


class Words:
    """Finds the words for the traces of one plant."""

    def __init__(self, plant: type[Plant], period: float) -> None:
        """`period` is the sample time, s."""
        self._period = period
        self.output = f"the {plant.output.text or plant.output.name}"
        self.unit = f" {plant.output.unit}".rstrip()
        self.input = plant.drive.unit or plant.drive.name
        self.sensor = f"look at the {plant.output.sensor}"
        self.surroundings = f"look at {plant.surroundings}"

    def impossible(self, sample: Sample) -> Finding:
        """A sample that is none."""
        reason = (
            f"{self.output} is {sample.output:g}{self.unit} at {sample.input:g} {self.input} and "
            f"set-point {sample.reference:g}{self.unit}, which cannot be: {self.sensor}"
        )
        return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)

    def leaping(self, before: Sample, sample: Sample, unexplained: float) -> Finding:
        """A step that the plant cannot make."""
        reason = (
            f"{self.output} went from {before.output:.4g} to {sample.output:.4g}{self.unit} at once, "
            f"{abs(unexplained):.3g}{self.unit} from where the plant can be: {self.sensor}"
        )
        return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)

    def frozen(self, sample: Sample, repeats: Repeats) -> Finding:
        """A sensor that stands still."""
        reason = (
            f"{self.output} stands still at {sample.output:g}{self.unit} for "
            f"{repeats.count * self._period:g} s, in which the plant should have moved "
            f"{signed(repeats.expected)}{self.unit} and the reading shown its noise: {self.sensor}"
        )
        return Finding(Fault.SENSOR_FROZEN, True, sample.index - repeats.count, reason)

    def late(self, index: int, effect: Effect | Answer, lag: float, *, sure: bool) -> Finding:
        """Readings that come too late."""
        reason = f"{self.output} follows the drive {lag:g} s late: {self.sensor}"
        return Finding(Fault.SENSOR_LATE, sure, index - effect.length, reason)

    def lost(self, index: int, effect: Effect | Answer, *, sure: bool) -> Finding:
        """A drive without effect."""
        moved, shown = signed(effect.expected), signed(effect.share * effect.expected)
        reason = (
            f"the drive should have moved {self.output} by {moved}{self.unit} in "
            f"{effect.length * self._period:g} s, but what it did shows {shown}{self.unit} of that: "
            "look at drive, wires and supply"
        )
        return Finding(Fault.DRIVE_LOST, sure, index - effect.length, reason)

    def weak(self, index: int, effect: Effect | Answer, lasts: int, *, sure: bool) -> Finding:
        """A drive with too small an effect, for so many samples."""
        reason = (
            f"the drive does {max(effect.share, 0.0):.0%} of what it should to {self.output}, and that for "
            f"{lasts * self._period:g} s: look at drive, wires and supply"
        )
        return Finding(Fault.DRIVE_WEAK, sure, index - effect.length - lasts, reason)


def signed(value: float) -> str:
    """As many digits as can be meant."""
    return f"{value:+.0f}" if abs(value) >= 100 else f"{value:+.2g}"
