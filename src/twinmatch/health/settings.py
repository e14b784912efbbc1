"""The numbers of the monitor: what the twin is before it is known, and where healthy ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from twinmatch.dynamics import Parameters, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.plants import Peltier

__all__ = ["HealthError", "HealthSettings"]


class HealthError(TwinmatchError):
    """Settings that can tell nothing apart."""


_JUMP: Final = 80.0
"""Units of the output's noise."""


def _typical(plant: type[Plant] = Peltier) -> Parameters:
    return plant.model().typical()


@dataclass(frozen=True)
class HealthSettings:
    """When a trace in the signals becomes a fault; docs/health.md measures what each limit leaves.

    Raises:
        HealthError: a value is not positive, or `lost` and `weak` are no shares.
    """

    period: float = 1.0
    """Sample time, s."""
    reference: Parameters = field(default_factory=_typical)
    """The twin until one is known that explains the plant better, in the structure that is judged by. How
    much the drive does and the time constant matter, and those roughly: half or twice will do. Of the
    Peltier rig, if not given."""
    lost: float = 0.4
    """Share of the drive's expected effect below which it is lost. A healthy plant shows 0.65 and more."""
    weak: float = 0.6
    """The same below which it is weak, if that lasts."""
    jump: float = 8.0
    """Step of a reading within one sample that the plant cannot make, in the output's unit. Corrections of
    the rig's healthy camera make 3 °C."""
    frozen: float = 10.0
    """How long the same reading has to be repeated, s. Healthy cameras repeat theirs for 5 s at most."""
    change: float = 9.0
    """By how much better a change has to explain the readings than none does, in nats, to be told."""
    lead: float = 4.0
    """The same against the next best change, for it to be told by name."""
    start: float = 30.0
    """Time after the first sample, and after a gap, in which there is no more than a suspicion, s: cameras
    that deliver their first pictures late are common and mend themselves."""

    @property
    def followed(self) -> Parameters:
        """Where the plant begins to be followed, in the structure its file names: at what it calls
        typical, or at the values of `reference` where it calls nothing so."""
        plant = self.reference.model.plant
        model = plant.model(plant.followed or None)
        if plant.typical:
            return model.typical()
        return model.parameters(**{n: v for n, v in self.reference.items() if n in model.declared})

    @classmethod
    def of(cls, plant: type[Plant], period: float = 1.0) -> HealthSettings:
        """Those for a plant: judged by its first structure with typical parameters, a jump being 80 times its
        noise."""
        return cls(period=period, reference=_typical(plant), jump=_JUMP * plant.output.noise)

    def __post_init__(self) -> None:
        for name in ("period", "lost", "weak", "jump", "frozen", "change", "lead", "start"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                msg = f"health: {name} is {value}; it must be positive"
                raise HealthError(msg)
        if not self.lost <= self.weak < 1:
            msg = (
                f"health: lost is {self.lost} and weak {self.weak}; they are shares of the expected effect "
                "and must grow, up to 1"
            )
            raise HealthError(msg)
