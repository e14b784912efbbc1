"""Thermal runaway: the plant does not follow the drive.

Modelled on the heater checks of 3D-printer firmware (Klipper's `verify_heater`, Marlin's thermal protection),
but for both directions, since a Peltier plate is cooled as well as heated. The check uses no model of the
plant; it detects a lost drive, a detached sensor, or reversed polarity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.safety.errors import SafetyError

__all__ = ["Runaway", "RunawayLimits"]


@dataclass(frozen=True)
class RunawayLimits:
    """Limits from which a drive without effect is a fault."""

    hysteresis: float = 5.0
    """Control error that is always tolerated, °C."""
    patience: float = 120.0
    """Integral of the error beyond the hysteresis, over the time without progress, that is a fault, °C·s."""
    gain: float = 2.0
    """Movement towards the set-point within `gain_time` that counts as progress, °C."""
    gain_time: float = 20.0
    """s"""
    wrong_way: float = 3.0
    """Movement away from the set-point at full drive that is a fault at once, °C."""
    full_drive: float = 250.0
    """Magnitude of the command from which the drive counts as full, in its unit."""

    def __post_init__(self) -> None:
        for name in ("hysteresis", "patience", "gain", "gain_time", "wrong_way", "full_drive"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                msg = f"runaway limits: {name} is {value}; it must be positive"
                raise SafetyError(msg)


class Runaway:
    """Monitors set-point, temperature and drive for runaway."""

    def __init__(self, limits: RunawayLimits | None = None, thing: str = "plate") -> None:
        """Start without history; `thing` names what is heated or cooled, for messages."""
        self._thing = thing
        self.limits = limits or RunawayLimits()
        self.reset()

    def reset(self) -> None:
        """Forget the history."""
        self._time: float | None = None
        self._reference = 0.0
        self._heating = True
        self._unexplained = 0.0  # °C·s
        self._goal = 0.0  # distance from the set-point that will count as progress, °C
        self._deadline = 0.0
        self._nearest_at_full = math.inf  # smallest distance since the drive became full

    def check(self, now: float, reference: float, temperature: float, drive: float) -> str | None:
        """Take one tick (s, °C, °C, the drive's unit); returns an error message, or None.

        If the clock jumps back, the check starts over.
        """
        heating = reference >= temperature
        distance = abs(reference - temperature)
        elapsed = 0.0 if self._time is None else now - self._time
        new_task = heating != self._heating or abs(reference - self._reference) >= self.limits.gain
        if self._time is None or elapsed < 0 or new_task:
            self._heating, self._reference = heating, reference
            self._start(now, distance)
            elapsed = 0.0
        self._time = now
        limits = self.limits
        pushing = drive >= limits.full_drive if heating else drive <= -limits.full_drive
        self._nearest_at_full = min(self._nearest_at_full, distance) if pushing else math.inf
        if pushing and distance - self._nearest_at_full >= limits.wrong_way:
            word, away = "heating" if heating else "cooling", distance - self._nearest_at_full
            return (
                f"at full {word} the {self._thing} moved {away:.1f} °C away from the set-point; "
                "check drive, polarity and sensor"
            )
        return self._progress(now, elapsed, distance, drive)

    def _start(self, now: float, distance: float) -> None:
        self._unexplained = 0.0
        self._nearest_at_full = math.inf
        self._goal = distance - self.limits.gain
        self._deadline = now + self.limits.gain_time

    def _progress(self, now: float, elapsed: float, distance: float, drive: float) -> str | None:
        limits = self.limits
        if distance <= limits.hysteresis or distance <= self._goal:
            self._start(now, distance)
            return None
        if now < self._deadline:
            return None
        pushing = abs(drive) >= limits.full_drive / 2
        self._unexplained += (distance - limits.hysteresis) * elapsed if pushing else 0.0
        if self._unexplained < limits.patience:
            return None
        word = "heating" if self._heating else "cooling"
        return (
            f"{word} makes no progress: {distance:.1f} °C from the set-point, less than {limits.gain:g} °C "
            f"closer in {limits.gain_time:g} s; check drive, fan and sensor"
        )
