"""What a trace amounts to at one sample, in words."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.health.record import Fault
from twinmatch.health.traces import DRIFT_TIME, Drift, Effect, Repeats
from twinmatch.signals import Sample

__all__ = ["Finding", "drifting", "frozen", "impossible", "late", "leaping", "lost"]


class Finding(NamedTuple):
    """One trace of one fault."""

    fault: Fault
    sure: bool
    """Whether it has lasted long enough, or is large enough, to be told."""
    first: int
    """Sample at which it begins."""
    reason: str


def impossible(sample: Sample) -> Finding:
    """A sample that is none."""
    reason = (
        f"the temperature is {sample.output:g} °C at PWM {sample.input:g} and set-point "
        f"{sample.reference:g} °C, which cannot be: look at the camera"
    )
    return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)


def leaping(before: Sample, sample: Sample, unexplained: float) -> Finding:
    """A step that no plate can make."""
    reason = (
        f"the temperature went from {before.output:.1f} to {sample.output:.1f} °C at once, "
        f"{abs(unexplained):.1f} °C from where the plate can be: look at the camera"
    )
    return Finding(Fault.SENSOR_IMPLAUSIBLE, True, sample.index, reason)


def frozen(sample: Sample, repeats: Repeats, period: float) -> Finding:
    """A sensor that stands still."""
    reason = (
        f"the temperature stands still at {sample.output:g} °C for {repeats.count * period:g} s, in "
        f"which the plate should have moved {repeats.expected:+.1f} °C and the reading shown its noise: "
        "look at the camera"
    )
    return Finding(Fault.SENSOR_FROZEN, True, sample.index - repeats.count, reason)


def late(index: int, effect: Effect, lag: float, *, sure: bool) -> Finding:
    """Readings that come too late."""
    reason = f"the temperature follows the drive {lag:g} s late: look at the camera"
    return Finding(Fault.SENSOR_LATE, sure, index - effect.length, reason)


def lost(index: int, effect: Effect, period: float, *, sure: bool) -> Finding:
    """A drive without effect."""
    word, expected = "heated" if effect.expected > 0 else "cooled", abs(effect.expected)
    reason = (
        f"the drive should have {word} the plate by {expected:.1f} °C in {effect.length * period:g} s, "
        f"but what it did shows {effect.share * expected:.1f} °C of that: look at drive, wires and supply"
    )
    return Finding(Fault.DRIVE_LOST, sure, index - effect.length, reason)


def drifting(index: int, drift: Drift, period: float, *, sure: bool) -> Finding:
    """A slow change."""
    reason = (
        f"the plate gains {drift.rate:+.2f} °C/s that neither drive nor surroundings explain, "
        f"{drift.size:.1f} times what is uncertain: look at fan, heat sink and room"
    )
    return Finding(Fault.DRIFT, sure, index - round(DRIFT_TIME / period), reason)
