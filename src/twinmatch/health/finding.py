"""What a trace amounts to at one sample, in the words and units of a plant."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.dynamics import Plant
from twinmatch.health.record import Fault
from twinmatch.health.traces import DRIFT_TIME, Drift, Effect, Repeats
from twinmatch.signals import Sample

__all__ = ["Finding", "Words"]


class Finding(NamedTuple):
    """One trace of one fault."""

    fault: Fault
    sure: bool
    """Whether it has lasted long enough, or is large enough, to be told."""
    first: int
    """Sample at which it begins."""
    reason: str


class Words:
    """Finds the words for the traces of one plant."""

    def __init__(self, plant: type[Plant], period: float) -> None:
        """`period` is the sample time, s."""
        self._period = period
        self._output = f"the {plant.output.text or plant.output.name}"
        self._unit = f" {plant.output.unit}".rstrip()
        self._input = plant.drive.unit or plant.drive.name
        self._sensor = f"look at the {plant.output.sensor}"
        self._surroundings = f"look at {plant.surroundings}"

    def impossible(self, sample: Sample) -> Finding:
        """A sample that is none."""
        reason = (
            f"{self._output} is {sample.output:g}{self._unit} at {sample.input:g} {self._input} and "
            f"set-point {sample.reference:g}{self._unit}, which cannot be: {self._sensor}"
        )
        return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)

    def leaping(self, before: Sample, sample: Sample, unexplained: float) -> Finding:
        """A step that the plant cannot make."""
        reason = (
            f"{self._output} went from {before.output:.4g} to {sample.output:.4g}{self._unit} at once, "
            f"{abs(unexplained):.3g}{self._unit} from where the plant can be: {self._sensor}"
        )
        return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)

    def frozen(self, sample: Sample, repeats: Repeats) -> Finding:
        """A sensor that stands still."""
        reason = (
            f"{self._output} stands still at {sample.output:g}{self._unit} for "
            f"{repeats.count * self._period:g} s, in which the plant should have moved "
            f"{_signed(repeats.expected)}{self._unit} and the reading shown its noise: {self._sensor}"
        )
        return Finding(Fault.SENSOR_FROZEN, True, sample.index - repeats.count, reason)

    def late(self, index: int, effect: Effect, lag: float, *, sure: bool) -> Finding:
        """Readings that come too late."""
        reason = f"{self._output} follows the drive {lag:g} s late: {self._sensor}"
        return Finding(Fault.SENSOR_LATE, sure, index - effect.length, reason)

    def lost(self, index: int, effect: Effect, *, sure: bool) -> Finding:
        """A drive without effect."""
        moved, shown = _signed(effect.expected), _signed(effect.share * effect.expected)
        reason = (
            f"the drive should have moved {self._output} by {moved}{self._unit} in "
            f"{effect.length * self._period:g} s, but what it did shows {shown}{self._unit} of that: "
            "look at drive, wires and supply"
        )
        return Finding(Fault.DRIVE_LOST, sure, index - effect.length, reason)

    def weak(self, index: int, effect: Effect, lasts: int, *, sure: bool) -> Finding:
        """A drive with too small an effect, for so many samples."""
        reason = (
            f"the drive does {max(effect.share, 0.0):.0%} of what it should to {self._output}, and that for "
            f"{lasts * self._period:g} s: look at drive, wires and supply"
        )
        return Finding(Fault.DRIVE_WEAK, sure, index - effect.length - lasts, reason)

    def drifting(self, index: int, drift: Drift, *, sure: bool) -> Finding:
        """A slow change."""
        rate = f"{_signed(drift.rate)}{self._unit}/s"
        reason = (
            f"{self._output} moves by {rate} that neither drive nor surroundings explain, "
            f"{drift.size:.1f} times what is uncertain: {self._surroundings}"
        )
        return Finding(Fault.DRIFT, sure, index - round(DRIFT_TIME / self._period), reason)


def _signed(value: float) -> str:
    """As many digits as can be meant."""
    return f"{value:+.0f}" if abs(value) >= 100 else f"{value:+.2g}"
