"""A budget of heat, without a model: how much drive a plant may get beyond what holds its reading."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.safety.limits import SafetyError, positive
from twinmatch.settings import setting


@dataclass(frozen=True)
class BudgetLimits:
    """Limits of the budget; a reading at `rest` needs no drive."""

    rest: float = setting(
        15.0,
        "Output that the plant holds without drive, at the least.",
        "{y}",
        -50.0,
        150.0,
    )
    hold: float = setting(
        5.0,
        "Drive that holds the plant one {y} above rest, at the most.",
        "{u}/{y}",
        0.01,
        255.0,
    )
    least: float = setting(
        2000.0,
        "Integral of the drive beyond it that is a fault at rest.",
        "{u}·s",
        10.0,
        1e6,
    )
    each: float = setting(
        120.0, "What a set-point adds for each {y} above rest.", "{u}·s/{y}", 0.0, 1e5
    )

    def __post_init__(self) -> None:
        positive("budget", {"hold": self.hold, "least": self.least})
        if not (math.isfinite(self.rest) and 0 <= self.each < math.inf):
            msg = f"budget limits: each is {self.each}, rest {self.rest}; give finite values, each not below 0"
            raise SafetyError(msg)


class HeatBudget:
    """A leaky bucket of the drive beyond what the reading explains.

    A plant that is heated gets warmer, and then needs the drive that holds it. Drive for which the reading
    shows nothing adds up, near the set-point or far from it; it drains while less drive passes than the
    reading needs. So a sensor that reads too cold runs out of budget, whatever the set-point. Clearing a
    fault does not refill it. Only drive that heats counts.
    """

    def __init__(
        self,
        limits: BudgetLimits | None = None,
        thing: str = "plate",
        unit: str = "PWM",
    ) -> None:
        """Start full; `thing` names what is driven, `unit` is that of the drive, for messages."""
        self.limits = limits or BudgetLimits()
        self._thing = thing
        self._unit = unit
        self.spent = 0.0
        """What the readings have not explained, in the drive's unit times s."""

    def allowed(self, reference: float) -> float:
        """The most that may be spent at a set-point."""
        return self.limits.least + self.limits.each * max(
            0.0, reference - self.limits.rest
        )

    def take(
        self, elapsed: float, drive: float, reference: float, reading: float
    ) -> str | None:
        """Take the drive of the last `elapsed` seconds; returns an error message, or None."""
        limits = self.limits
        explained = limits.hold * max(0.0, reading - limits.rest)
        self.spent = max(0.0, self.spent + (max(0.0, drive) - explained) * elapsed)
        if drive <= 0.0 or self.spent <= self.allowed(reference):
            return None
        return (
            f"the {self._thing} got {self.spent:.0f} {self._unit}·s more drive than the readings explain: "
            "the drive is lost, or the sensor does not see it; check both"
        )
