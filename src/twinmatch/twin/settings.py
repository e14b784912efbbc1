"""All settings of the twin in one place; nodes and command line fill them from their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from twinmatch.comparing import Candidate, spans_of
from twinmatch.dynamics import (
    FROM_PLANT_FILE,
    Law,
    LoopLaw,
    Parameters,
    Plant,
    Sensor,
    law_for,
    pid_of,
)
from twinmatch.dynamics.movement import InputEffect, effect_of
from twinmatch.dynamics.pace import plant_scale
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Expectation, Noise, Prior
from twinmatch.forecasting import HORIZONS, ForecastError
from twinmatch.health import HealthSettings
from twinmatch.plants import Peltier
from twinmatch.settings import setting
from twinmatch.signals import Signals
from twinmatch.twin.schedule import ScheduleSettings

_FEWEST_BETWEEN: Final = 10
"""Fewest samples from one forecast to the next."""
_REGIME_WIDTH: Final = 100.0
"""Width of a regime, in units of the output's noise."""


class TwinError(TwinmatchError):
    """Settings or data that the twin cannot work with."""


@dataclass(frozen=True)
class ForecastSettings:
    """Horizons and intervals at which the candidates' forecasts are scored.

    Raises:
        ForecastError: a value is not positive.
    """

    horizons: tuple[float, ...] = setting(
        HORIZONS, "Horizons at which forecasts are scored.", "s", 1e-6, 1e9
    )
    every: float = setting(
        30.0, "Time between two forecasts of all candidates.", "s", 1e-6, 1e9
    )
    """The stretches by which new candidates and structures are compared scale with it."""
    memory: float = setting(
        1800.0,
        "Time after which the weight of a forecast has fallen to 1/e.",
        "s",
        1e-6,
        1e9,
    )

    @classmethod
    def of(cls, scale: float, period: float) -> ForecastSettings:
        """Settings with times multiplied by `scale`, horizons in whole samples of `period` s, and forecasts
        at least ten samples apart: at each, all candidates are simulated."""
        interval_scale = max(scale, _FEWEST_BETWEEN * period / cls.every)
        rounded = tuple(
            max(round(horizon * scale / period), 1) * period for horizon in HORIZONS
        )
        horizons = (
            HORIZONS if scale == 1.0 else tuple(float(f"{h:.12g}") for h in rounded)
        )
        return cls(horizons, cls.every * interval_scale, cls.memory * interval_scale)

    @property
    def scale(self) -> float:
        """Factor on other times that are meant for the rig."""
        return self.every / type(self).every

    def __post_init__(self) -> None:
        if not self.horizons:
            raise ForecastError(
                "forecasts: there is no horizon; give at least one, in seconds"
            )
        for name, value in (
            ("horizons", min(self.horizons)),
            ("every", self.every),
            ("memory", self.memory),
        ):
            if not value > 0:
                raise ForecastError(
                    f"forecasts: {name} is {value} s; it must be positive"
                )


@dataclass(frozen=True)
class TrustLimits:
    """The limit beyond which the leader is doubtful.

    Errors that fit the band have an RMS of 0.6 half widths. They last for about half a minute, so that a
    minute holds two independent ones; the probability that they reach twice the half width, 3.3 standard
    deviations, is less than one in ten thousand.
    """

    doubtful: float = setting(
        2.0,
        "RMS forecast error, in half widths of the band, from which the twin is doubtful.",
        "",
        1e-6,
        1e6,
    )

    def __post_init__(self) -> None:
        if not self.doubtful > 0:
            raise TwinError(
                f"trust limits: doubtful is {self.doubtful}; it must be positive"
            )


def _start() -> Parameters:
    return Peltier.model().parameters()


def _law() -> Law:
    return pid_of(Peltier)


@dataclass(frozen=True)
class TwinSettings:
    """How the twin is matched and judged; the defaults are for the Peltier rig, `of` is for any plant."""

    plant: type[Plant] = Peltier
    """The plant that is judged."""
    period: float = 1.0
    """Sample time, s."""
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    free: tuple[str, ...] = next(iter(Peltier.structures.values())).free
    """Names of the parameters that a match may change."""
    start: Parameters = field(default_factory=_start)
    """Start values, and values of the parameters not free; their structure is the one that is matched."""
    noise: Noise = Noise.of(Peltier)  # noqa: RUF009
    law: Law | None = field(default_factory=_law)
    """The running controller; None if the loop is not known: twins then get the recorded input."""
    sensor: Sensor = Peltier.sensor
    """Sensor model applied to the twin's response before its models are identified."""
    seed: int = setting(2022, "Seed of that sensor's noise.", "", 0, 2**31)
    """A window's first sample is added to it: windows differ, replays agree."""
    decimals: int = setting(
        2, "Decimal places of the information gain's tables.", "", 0, 9
    )
    most_candidates: int = setting(8, "Candidates kept in the family.", "", 1, 64)
    regime_width: float = setting(
        10.0,
        "Operating points closer than half of this are one regime.",
        "{y}",
        1e-6,
        1e6,
    )
    """Of several outputs of the first; of the others in proportion to the noise."""
    limits: TrustLimits = field(default_factory=TrustLimits)
    health: HealthSettings = field(default_factory=HealthSettings)
    """Settings of the health monitor; their period is replaced by `period`."""
    forecasts: ForecastSettings = field(default_factory=ForecastSettings)
    """Horizons and intervals of the forecasts by which candidates are scored."""
    read_through: tuple[str, ...] = ()
    """Names of the outputs whose estimates the law takes while their sensors are not believed."""
    prior: Mapping[str, Prior] = field(default_factory=dict)
    """What earlier sessions have shown of the parameters, by structure and name."""

    @classmethod
    def of(
        cls,
        plant: type[Plant],
        structure: str | None = None,
        period: float = 1.0,
        law: LoopLaw = FROM_PLANT_FILE,
        scale: float = 1.0,
    ) -> TwinSettings:
        """Settings for a plant in one of its structures (the first, if none is named).

        The controller is the plant file's unless `law` gives another; None: the loop is not known. Windows
        and horizons follow the plant's time constant; `scale` lengthens them.

        Raises:
            PlantError: there is no such structure.
        """
        model = plant.model(structure)
        first = next(iter(plant.outputs.values()))
        running = law_for(plant, period, law)
        return cls(
            plant=plant,
            period=period,
            schedule=ScheduleSettings.of(plant, period, scale),
            free=model.structure.free,
            start=model.parameters(),
            noise=Noise.of(plant),
            law=running,
            sensor=plant.sensor or Sensor(),
            decimals=first.decimals + 1,
            regime_width=_REGIME_WIDTH * first.noise,
            health=HealthSettings.of(plant, period),
            forecasts=ForecastSettings.of(plant_scale(plant, period, scale), period),
        )

    def informed_by(self, given: Sequence[Candidate]) -> TwinSettings:
        """These settings with what remembered candidates say: of each structure the first one is the prior.

        Matches are then made in the structure of the first of all, unless another one than the plant's first,
        or other free parameters than its, were asked for.

        Raises:
            TwinError: one is of another plant.
        """
        remembered = [candidate for candidate in given if candidate.remembered]
        if not remembered:
            return self
        prior: dict[str, Prior] = {}
        for candidate in remembered:
            if candidate.parameters.model.plant is not self.plant:
                title = candidate.parameters.model.plant.title
                own_title = self.plant.title
                raise TwinError(
                    f"twin: candidate {candidate.name} has parameters of {title}; give {own_title}'s"
                )
            deviations = np.sqrt(np.diag(candidate.covariance)).tolist()
            values = zip(candidate.free, deviations, strict=True)
            expectations = {
                name: Expectation(candidate.parameters[name], deviation)
                for name, deviation in values
            }
            prior.setdefault(candidate.parameters.model.structure_name, expectations)
        start = remembered[0].parameters
        usual = self.plant.model()
        if self.start.model is not usual or self.free != usual.structure.free:
            return replace(self, prior=prior)
        return replace(self, prior=prior, start=start, free=start.model.structure.free)

    @property
    def effect(self) -> InputEffect | None:
        """What the inputs do to the outputs where that begins windows; None: the set-points of a loop do."""
        return effect_of(self.plant, self.period) if self.law is None else None

    @property
    def units(self) -> Signals:
        """Noise of each output, in units of the first one's: steps and widths are in proportion to it."""
        noise = [y.noise for y in self.plant.outputs.values()]
        return tuple(deviation / noise[0] for deviation in noise)

    @property
    def model_scale(self) -> float | None:
        """`scale` for `identify` if models are from input to output; None if the loop is known and models are
        from its set-point."""
        return None if self.law is not None else spans_of(self.plant).ratio

    def __post_init__(self) -> None:
        for name, parameters in (
            ("start", self.start),
            ("health.reference", self.health.reference),
        ):
            title = parameters.model.plant.title
            if parameters.model.plant is not self.plant:
                raise TwinError(
                    f"twin: {name} has parameters of {title}; give {self.plant.title}'s"
                )
        numbers = np.size(self.noise.outputs), np.size(self.noise.inputs)
        signals = len(self.plant.outputs), len(self.plant.drives)
        if numbers != signals:
            raise TwinError(
                f"twin: noise has {numbers[0]} outputs and {numbers[1]} inputs; plant {self.plant.name} has "
                f"{signals[0]} and {signals[1]}: give one number for each"
            )
        if self.most_candidates < 1:
            raise TwinError(
                f"twin: most_candidates is {self.most_candidates}; a family needs at least one"
            )
        if not self.regime_width > 0:
            raise TwinError(
                f"twin: regime_width is {self.regime_width}; it must be positive"
            )
        if self.law is not None and self.law.period != self.period:
            raise TwinError(
                f"twin: the controller runs every {self.law.period} s but samples come every "
                f"{self.period} s; give both the same period"
            )
