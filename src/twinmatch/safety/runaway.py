"""Whether the plant follows its drive at all, without a model."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.safety.limits import positive
from twinmatch.settings import setting


@dataclass(frozen=True)
class RunawayLimits:
    """Limits from which a drive without effect is a fault."""

    hysteresis: float = setting(
        5.0, "Control error that is always tolerated.", "{y}", 0.1, 100.0
    )
    patience: float = setting(
        120.0,
        "Integral of the error beyond it, without progress, that is a fault.",
        "{y}·s",
        1.0,
        1e5,
    )
    gain: float = setting(
        2.0,
        "Movement towards the set-point that counts as progress.",
        "{y}",
        0.01,
        100.0,
    )
    gain_time: float = setting(20.0, "Time for that movement.", "s", 1.0, 3600.0)
    wrong_way: float = setting(
        3.0, "Movement away at full drive that is a fault.", "{y}", 0.1, 100.0
    )
    full_drive: float = setting(
        250.0, "Magnitude from which the drive counts as full.", "{u}", 1.0, 255.0
    )

    def __post_init__(self) -> None:
        positive("runaway", vars(self))


class Runaway:
    """Monitors set-point, temperature and drive for runaway: the plant does not follow the drive.

    Modelled on the heater checks of 3D-printer firmware (Klipper's `verify_heater`, Marlin's thermal
    protection), but for both directions, since a Peltier plate is cooled as well as heated. It uses no model
    of the plant; it detects a lost drive, a detached sensor, or reversed polarity.
    """

    def __init__(
        self,
        limits: RunawayLimits | None = None,
        thing: str = "plate",
        unit: str = "°C",
    ) -> None:
        """Start without history; `thing` names what is driven, `unit` is that of its output, for messages."""
        self._thing = thing
        self._unit = unit
        self.limits = limits or RunawayLimits()
        self.reset()

    def reset(self) -> None:
        """Forget the history."""
        self._time: float | None = None
        self._reference = 0.0
        self._heating = True
        self._unexplained = 0.0  # in the output's unit times s
        self._goal = 0.0  # distance from the set-point that will count as progress
        self._deadline = 0.0
        # smallest distance since the drive became full
        self._nearest_at_full = math.inf

    def check(
        self, now: float, reference: float, temperature: float, drive: float
    ) -> str | None:
        """Take one tick (s, twice the output's unit, the drive's unit); returns an error message, or None.

        If the clock jumps back, the check starts over.
        """
        heating = reference >= temperature
        distance = abs(reference - temperature)
        elapsed = 0.0 if self._time is None else now - self._time
        new_task = (
            heating != self._heating
            or abs(reference - self._reference) >= self.limits.gain
        )
        if self._time is None or elapsed < 0 or new_task:
            self._heating = heating
            self._reference = reference
            self._start(now, distance)
            elapsed = 0.0
        self._time = now
        limits = self.limits
        pushing = drive >= limits.full_drive if heating else drive <= -limits.full_drive
        self._nearest_at_full = (
            min(self._nearest_at_full, distance) if pushing else math.inf
        )
        if pushing and distance - self._nearest_at_full >= limits.wrong_way:
            word = "heating" if heating else "cooling"
            away = distance - self._nearest_at_full
            return (
                f"at full {word} the {self._thing} moved {away:.1f} {self._unit} away from the set-point; "
                "check drive, polarity and sensor"
            )
        return self._progress(now, elapsed, distance, drive)

    def _start(self, now: float, distance: float) -> None:
        self._unexplained = 0.0
        self._nearest_at_full = math.inf
        self._goal = distance - self.limits.gain
        self._deadline = now + self.limits.gain_time

    def _progress(
        self, now: float, elapsed: float, distance: float, drive: float
    ) -> str | None:
        limits = self.limits
        if distance <= limits.hysteresis or distance <= self._goal:
            self._start(now, distance)
            return None
        if now < self._deadline:
            return None
        pushing = abs(drive) >= limits.full_drive / 2
        self._unexplained += (
            (distance - limits.hysteresis) * elapsed if pushing else 0.0
        )
        if self._unexplained < limits.patience:
            return None
        word = "heating" if self._heating else "cooling"
        far = f"{distance:.1f} {self._unit}"
        closer = f"{limits.gain:g} {self._unit}"
        return (
            f"{word} the {self._thing} makes no progress: {far} from the set-point, and less than {closer} "
            f"closer in {limits.gain_time:g} s; check drive, fan and sensor"
        )
