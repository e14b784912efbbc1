"""Settings of the monitor: the twin it begins with, and the limits of healthy."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from twinmatch.dynamics import Parameters, Plant
from twinmatch.dynamics.pace import slow_scale
from twinmatch.errors import TwinmatchError
from twinmatch.plants import Peltier
from twinmatch.settings import setting


class HealthError(TwinmatchError):
    """Settings that cannot separate healthy from faulty."""


_JUMP: Final = 80.0
"""Units of the output's noise."""


def _typical(plant: type[Plant] = Peltier) -> Parameters:
    return plant.model().typical()


@dataclass(frozen=True)
class HealthSettings:
    """When a trace in the signals becomes a fault; docs/health.md has the measured margin of each limit.

    Raises:
        HealthError: a value is not positive, or `lost` and `weak` are not shares in growing order.
    """

    period: float = 1.0
    """Sample time, s."""
    reference: Parameters = field(default_factory=_typical)
    """The twin to judge by until a better one is known, in the structure used for the balance. Only the gain
    of the drive and the time constant matter, within a factor of two. Default: the Peltier rig's."""
    lost: float = setting(
        0.4,
        "Share of the drive's expected effect below which it is lost.",
        "",
        0.01,
        0.99,
    )
    """A healthy plant shows 0.65 and more."""
    weak: float = setting(
        0.6, "Share below which it is weak, if that lasts.", "", 0.01, 0.99
    )
    jump: float = setting(
        8.0, "Step of a reading that is physically impossible.", "{y}", 1e-6, 1e6
    )
    """Within one sample. Corrections of the rig's healthy camera make 3 °C."""
    frozen: float = setting(
        10.0,
        "Time for which one repeated reading means a frozen sensor.",
        "s",
        1.0,
        1e7,
    )
    """Healthy cameras repeat theirs for 5 s at most."""
    change: float = setting(
        3.0,
        "Log-likelihood gain from which a change is reported, beyond its price.",
        "nats",
        0.1,
        1e3,
    )
    """The price is that of saying what has changed and when; exp(−change) of healthy sessions reach both."""
    lead: float = setting(
        4.0,
        "Log-likelihood gain over the next best from which it is named.",
        "nats",
        0.1,
        1e3,
    )
    start: float = setting(
        30.0, "Time after the first sample without alarms.", "s", 0.1, 1e7
    )
    """After a gap too: only suspicions are reported then. Cameras that deliver their first pictures late are
    common and recover without help."""

    @cached_property
    def pace(self) -> float:
        """Sample time, s, in the time of a plant as fast as the rig: fixed limits in seconds refer to it."""
        return self.period / slow_scale(self.reference.model.plant, self.period)

    @property
    def followed(self) -> Parameters:
        """Initial parameters for tracking the plant, in the structure that its file names, or that of
        `reference`: the typical ones, or the values of `reference` where the file declares none."""
        plant = self.reference.model.plant
        model = plant.model(plant.followed) if plant.followed else self.reference.model
        if plant.typical:
            return model.typical()
        return model.parameters(
            **{n: v for n, v in self.reference.items() if n in model.declared}
        )

    @classmethod
    def of(cls, plant: type[Plant], period: float = 1.0) -> HealthSettings:
        """Settings for a plant: its first structure with typical parameters, and a jump of 80 times the
        output's noise; `frozen` and `start` are longer for slow plants."""
        scale = slow_scale(plant, period)
        return cls(
            period=period,
            reference=_typical(plant),
            jump=_JUMP * next(iter(plant.outputs.values())).noise,
            frozen=cls.frozen * scale,
            start=cls.start * scale,
        )

    def __post_init__(self) -> None:
        for name in (
            "period",
            "lost",
            "weak",
            "jump",
            "frozen",
            "change",
            "lead",
            "start",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise HealthError(f"health: {name} is {value}; it must be positive")
        if not self.lost <= self.weak < 1:
            raise HealthError(
                f"health: lost is {self.lost} and weak is {self.weak}; give shares of the expected effect, "
                "lost at most weak and weak below 1"
            )
