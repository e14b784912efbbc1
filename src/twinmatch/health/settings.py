"""The numbers of the monitor: what the twin is before it is known, and where healthy ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from twinmatch.errors import TwinmatchError
from twinmatch.plant import RigParameters

__all__ = ["HealthError", "HealthSettings"]


class HealthError(TwinmatchError):
    """Settings that can tell nothing apart."""


def _typical() -> RigParameters:
    """Parameters in the middle of those that five hours of the rig were matched with."""
    return RigParameters(seebeck=0.06, conductance=0.65, heat_capacity=28.0)


@dataclass(frozen=True)
class HealthSettings:
    """When a trace in the signals becomes a fault; docs/health.md measures what each limit leaves.

    Raises:
        HealthError: a value is not positive, or `lost` is no share.
    """

    period: float = 1.0
    """Sample time, s."""
    reference: RigParameters = field(default_factory=_typical)
    """The twin until one is known that explains the plate better. Heat per count and time constant matter,
    and those roughly: half or twice will do."""
    lost: float = 0.4
    """Share of the drive's expected effect below which it is lost. The healthy rig shows 0.65 and more."""
    jump: float = 8.0
    """Step of a reading within one sample that no plate can make, °C. Healthy camera corrections make 3."""
    frozen: float = 10.0
    """How long the same reading has to be repeated, s. Healthy cameras repeat theirs for 5 s at most."""
    drift: float = 2.6
    """Slow heating or cooling that nothing explains, in units of its uncertainty. Healthy hours reach 1.3."""
    start: float = 30.0
    """Time after the first sample, and after a gap, in which there is no more than a suspicion, s: cameras
    that deliver their first pictures late are common and mend themselves."""

    def __post_init__(self) -> None:
        for name in ("period", "lost", "jump", "frozen", "drift", "start"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                msg = f"health: {name} is {value}; it must be positive"
                raise HealthError(msg)
        if self.lost >= 1:
            msg = f"health: lost is {self.lost}; it is a share of the expected effect, between 0 and 1"
            raise HealthError(msg)
