"""Every number a user may turn, in one place; nodes and command line fill it from their parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from twinmatch.discrimination import spans_of
from twinmatch.dynamics import FILED, Closing, Parameters, PidGains, Plant, Sensor, gains_for, gains_of
from twinmatch.errors import TwinmatchError
from twinmatch.health import HealthSettings
from twinmatch.matching import Noise
from twinmatch.plants import Peltier
from twinmatch.twin.entrant import ForecastSettings
from twinmatch.twin.schedule import ScheduleSettings

__all__ = ["TrustLimits", "TwinError", "TwinSettings"]

_REGIME: Final = 100.0
"""Width of a regime, in units of the output's noise."""


class TwinError(TwinmatchError):
    """The twin was set up or fed in a way it cannot work with."""


@dataclass(frozen=True)
class TrustLimits:
    """Where the leader becomes doubtful.

    A promise kept leaves 0.6 half widths. Errors last for about half a minute, so that a minute holds two
    independent ones; that they come to twice the half width, 3.3 standard deviations, has a chance of less
    than one in ten thousand.
    """

    doubtful: float = 2.0
    """RMS of what came minus what was foretold, in half widths of the band, over the newest samples."""

    def __post_init__(self) -> None:
        if not self.doubtful > 0:
            raise TwinError(f"trust limits: doubtful is {self.doubtful}; it must be positive")


def _start() -> Parameters:
    return Peltier.model().parameters()


def _gains() -> PidGains:
    return gains_of(Peltier, 1.0)


@dataclass(frozen=True)
class TwinSettings:
    """How the twin is matched and judged; without arguments for the Peltier rig, `of` gives any plant's."""

    plant: type[Plant] = Peltier
    """What is judged."""
    period: float = 1.0
    """Sample time, s."""
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    free: tuple[str, ...] = next(iter(Peltier.structures.values())).free
    """Names of the parameters a match may change."""
    start: Parameters = field(default_factory=_start)
    """Start values, and the values of all that is not free; the structure that is matched is theirs."""
    noise: Noise = Noise.of(Peltier)  # noqa: RUF009 (immutable)
    gains: PidGains | None = field(default_factory=_gains)
    """Of the running controller; None: the loop is not known, and twins are driven by the recorded input."""
    sensor: Sensor = Peltier.sensor
    """The twin is seen through it when its models are identified."""
    seed: int = 2022
    """Of its noise; the window's first sample is added, so that windows differ and replays do not."""
    decimals: int = 2
    """Decimal places of the information gain's tables."""
    most_candidates: int = 8
    regime_width: float = 10.0
    """Operating points closer than half of this, in the output's unit, are one regime."""
    limits: TrustLimits = field(default_factory=TrustLimits)
    health: HealthSettings = field(default_factory=HealthSettings)
    """Of the monitor of the plant's health; its period is `period`."""
    forecasts: ForecastSettings = field(default_factory=ForecastSettings)
    """How the candidates are held to what they foretell."""

    @classmethod
    def of(
        cls,
        plant: type[Plant],
        structure: str | None = None,
        period: float = 1.0,
        gains: Closing = FILED,
    ) -> TwinSettings:
        """Those for a plant in one of its structures (the first, if none is named).

        Its controller is what the plant file says, unless `gains` says another, or None: that it is not
        known.

        Raises:
            PlantError: there is no such structure.
        """
        model = plant.model(structure)
        noise = plant.output.noise
        held = gains_for(plant, period, gains)
        return cls(
            plant=plant,
            period=period,
            schedule=ScheduleSettings(
                min_step=plant.output.least_step, min_input_step=plant.drive.least_step
            ),
            free=model.structure.free,
            start=model.parameters(),
            noise=Noise.of(plant),
            gains=held,
            sensor=plant.sensor or Sensor(),
            decimals=plant.output.decimals + 1,
            regime_width=_REGIME * noise,
            health=HealthSettings.of(plant, period),
        )

    @property
    def least_movement(self) -> float:
        """Of what excites the plant: the set-point, or the input where the loop is not known; in its unit."""
        schedule = self.schedule
        return schedule.min_input_step if self.gains is None else schedule.min_step

    @property
    def model_scale(self) -> float | None:
        """In which units `identify` has to compare models from input to output; None: the loop is known, and
        models start from its set-point."""
        return None if self.gains is not None else spans_of(self.plant).ratio

    def __post_init__(self) -> None:
        for name, of in (("start", self.start), ("health.reference", self.health.reference)):
            if of.model.plant is not self.plant:
                msg = f"twin: {name} has parameters of {of.model.plant.title}; it takes {self.plant.title}'s"
                raise TwinError(msg)
        if self.most_candidates < 1:
            msg = f"twin: most_candidates is {self.most_candidates}; a family needs at least one"
            raise TwinError(msg)
        if not self.regime_width > 0:
            msg = f"twin: regime_width is {self.regime_width}; it must be positive"
            raise TwinError(msg)
        if self.gains is not None and self.gains.period != self.period:
            msg = (
                f"twin: the controller runs every {self.gains.period} s but samples come every "
                f"{self.period} s; give both the same period"
            )
            raise TwinError(msg)
