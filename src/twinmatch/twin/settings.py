"""Every number a user may turn, in one place; nodes and command line fill it from their parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

from twinmatch.errors import TwinmatchError
from twinmatch.health import HealthSettings
from twinmatch.matching import Noise
from twinmatch.plant import Camera, PidGains, RigParameters
from twinmatch.twin.schedule import ScheduleSettings

__all__ = ["TrustLimits", "TwinError", "TwinSettings"]


class TwinError(TwinmatchError):
    """The twin was set up or fed in a way it cannot work with."""


@dataclass(frozen=True)
class TrustLimits:
    """Where the trust level changes: RMS of the nominal twin's residuals over the newest samples.

    Over six healthy hours of the rig, minute by minute, the driven twin was off by at most 6 °C with
    parameters matched anywhere in the family and the closed-loop twin by at most 40 counts after the
    first minute; a lost drive makes it 24 °C and 155 counts within the minute in which it shows.
    """

    doubtful_y: float = 7.0
    """Measured minus driven-twin temperature, °C."""
    fault_y: float = 12.0
    doubtful_u: float = 55.0
    """Measured minus closed-loop-twin control, PWM counts."""
    fault_u: float = 100.0

    def __post_init__(self) -> None:
        for name in ("y", "u"):
            doubtful, fault = getattr(self, f"doubtful_{name}"), getattr(self, f"fault_{name}")
            if not 0 < doubtful < fault:
                msg = (
                    f"trust limits: doubtful_{name} {doubtful} and fault_{name} {fault} "
                    "must be positive and grow"
                )
                raise TwinError(msg)


@dataclass(frozen=True)
class TwinSettings:
    """How the twin is matched and judged."""

    period: float = 1.0
    """Sample time, s."""
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    free: tuple[str, ...] = ("seebeck", "conductance", "heat_capacity")
    """Names of the rig parameters a match may change."""
    start: RigParameters = field(default_factory=RigParameters)
    """Start values, and the values of all that is not free."""
    noise: Noise = field(default_factory=Noise)
    gains: PidGains = field(default_factory=PidGains)
    camera: Camera = field(default_factory=Camera)
    """Noise of the camera the twin is seen through when its models are identified."""
    seed: int = 2022
    """Of that noise; the window's first sample is added, so that windows differ and replays do not."""
    decimals: int = 2
    """Decimal places of the information gain's tables."""
    most_candidates: int = 8
    regime_width: float = 10.0
    """Operating points closer than half of this are one regime, °C."""
    limits: TrustLimits = field(default_factory=TrustLimits)
    health: HealthSettings = field(default_factory=HealthSettings)
    """Of the monitor of the plant's health; its period is `period`."""

    def __post_init__(self) -> None:
        if self.most_candidates < 1:
            msg = f"twin: most_candidates is {self.most_candidates}; a family needs at least one"
            raise TwinError(msg)
        if not self.regime_width > 0:
            msg = f"twin: regime_width is {self.regime_width} °C; it must be positive"
            raise TwinError(msg)
        if self.gains.period != self.period:
            msg = (
                f"twin: the controller runs every {self.gains.period} s but samples come every "
                f"{self.period} s; give both the same period"
            )
            raise TwinError(msg)
