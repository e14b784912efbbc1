"""Thermal runaway: the plant does not go where the drive pushes it.

After the heater checks of 3D-printer firmware (Klipper's `verify_heater`, Marlin's thermal protection),
for both directions, since a Peltier plate is cooled as well as heated. The monitor knows nothing of
models; it catches a lost drive, a sensor that fell off, a reversed cable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.safety.errors import SafetyError

__all__ = ["Runaway", "RunawayLimits"]


@dataclass(frozen=True)
class RunawayLimits:
    """When pushing without effect becomes a fault."""

    hysteresis: float = 5.0
    """Error of the loop that is always tolerated, °C."""
    patience: float = 120.0
    """Error beyond the hysteresis, summed over the time without progress, °C·s."""
    gain: float = 2.0
    """Movement towards the set-point that counts as progress, °C …"""
    gain_time: float = 20.0
    """… within this time, s."""
    wrong_way: float = 3.0
    """Movement away from the set-point at full drive that is a fault at once, °C."""
    full_drive: float = 250.0
    """Command from which the drive is taken to be full, in its unit."""

    def __post_init__(self) -> None:
        for name in ("hysteresis", "patience", "gain", "gain_time", "wrong_way", "full_drive"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                msg = f"runaway limits: {name} is {value}; it must be positive"
                raise SafetyError(msg)


class Runaway:
    """Watches set-point, temperature and drive; says what is wrong, once something is."""

    def __init__(self, limits: RunawayLimits | None = None, thing: str = "plate") -> None:
        """Begin with nothing seen of the `thing` that is heated or cooled."""
        self._thing = thing
        self.limits = limits or RunawayLimits()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._time: float | None = None
        self._reference = 0.0
        self._heating = True
        self._unexplained = 0.0  # °C·s
        self._goal = 0.0  # distance from the set-point that will count as progress, °C
        self._deadline = 0.0
        self._nearest_at_full = math.inf  # smallest distance seen since the drive went full

    def check(self, now: float, reference: float, temperature: float, drive: float) -> str | None:
        """Take one tick (s, °C, °C, the drive's unit); returns what is wrong, or None.

        A clock that steps back starts the watch anew.
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
                f"full {word}, yet the {self._thing} moved {away:.1f} °C away from the set-point; "
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
            f"nearer in {limits.gain_time:g} s; check drive, fan and sensor"
        )
