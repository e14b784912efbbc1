"""Temperature Control Labs whose heater is lost, and healthy ones.

Two kinds: the model of the package `tclab`, which is linear; and the published balance with radiation and a
second heater, in a room whose temperature wanders. Either is held by the PID published for the kit.
"""

from __future__ import annotations

import contextlib
import io
import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tests.support.watched import Watched, watched
from twinmatch.control import Loop
from twinmatch.dynamics import advance, begin, read
from twinmatch.health import Alarm, HealthSettings, Monitor
from twinmatch.plants import TCLab
from twinmatch.plants.tclab import RESOLUTION
from twinmatch.signals import FloatArray, Sample

SECOND = 1_000_000_000
NEVER = 1_000_000_000
NOISE = 0.043
"""Standard deviation of the noise of a reading, °C."""
_PROFILE = (35.0, 50.0, 40.0, 60.0)
"""Levels of config/tclab.yaml, °C, 450 s each."""


@dataclass(frozen=True)
class Broken:
    """What happens to heater 1 and its surroundings, from which sample to which."""

    lost: int = NEVER
    back: int = NEVER
    frozen: int = NEVER
    """From here on the reading stays what it was."""
    draught: int = NEVER
    losses: float = 1.0
    """Factor on the losses from the draught on."""
    gain: float = 1.0
    """Share of the command that the heater always does."""

    def heat(self, k: int, command: float) -> float:
        """Power that arrives, %."""
        return 0.0 if self.lost <= k < self.back else self.gain * command

    def factor(self, k: int) -> float:
        """Factor on the losses."""
        return self.losses if k >= self.draught else 1.0


HEALTHY = Broken()


class Simulated:
    """The model of the package, with a draught on heater 1."""

    def __init__(self, seed: int) -> None:
        import tclab

        random.seed(seed)
        with contextlib.redirect_stdout(io.StringIO()):
            self._model: Any = tclab.TCLabModel(synced=False)
        self._model.tlast = 0.0

    def read(self) -> float:
        return float(self._model.T1)

    def advance(self, heat: float, second: float, factor: float) -> None:
        model = self._model
        model.Q1(heat)
        model.Q2(second)
        for _ in range(5):
            model.update(model.tlast + model.maxstep)
            model._H1 -= model.maxstep * (factor - 1.0) * (model._H1 - model.Ta) / 20.0


class Published:
    """A kit of the published balance, its parameters within what is published, in a room that wanders."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        between = self._random.uniform
        self._room = between(289.0, 299.0)
        self._losses = between(4.0, 10.0)
        self._plant = TCLab.model("sensor lag, radiation, neighbour").parameters(
            losses=self._losses,
            heating=between(0.007, 0.014),
            second_heating=between(0.005, 0.01),
            ambient=self._room,
            sensor_lag=between(5.0, 25.0),
            exchange=between(5.0, 30.0),
        )
        self._states = begin(self._plant, self._room - 273.15)

    def read(self) -> float:
        reading = read(self._plant, self._states) + self._random.normal(0.0, NOISE)
        return float(np.floor(reading / RESOLUTION) * RESOLUTION)

    def advance(self, heat: float, second: float, factor: float) -> None:
        self._room += self._random.normal(0.0, 0.02)
        plant = self._plant.replace(ambient=self._room, losses=factor * self._losses)
        self._states = advance(plant, self._states, heat, 1.0, np.array([second]))


def _constant(level: float, _: int) -> float:
    return level


def run(
    kit: Simulated | Published,
    reference: FloatArray,
    broken: Broken = HEALTHY,
    second: FloatArray | None = None,
) -> list[Sample]:
    """Samples of a kit whose T1 is held at `reference`, °C; `second`: power of heater 2, %."""
    loop = Loop(TCLab)
    samples = list[Sample]()
    for k, level in enumerate(reference.tolist()):
        shown = samples[-1].output if k >= broken.frozen else kit.read()
        loop.measure(shown, k * SECOND)
        beside = 0.0 if second is None else float(second[k])
        sample = loop.tick(k * SECOND, partial(_constant, level))
        assert sample is not None
        samples.append(
            Sample(k, k * SECOND, level, sample.output, sample.input, (beside,))
        )
        kit.advance(broken.heat(k, sample.input), beside, broken.factor(k))
    return samples


def watch(samples: Sequence[Sample]) -> tuple[Alarm, ...]:
    """The alarms of a monitor that knows of the kit what the plant file says."""
    return watched(
        "kit", lambda: Watched(Monitor(HealthSettings.of(TCLab))), samples
    ).monitor.alarms


def levels(size: int) -> FloatArray:
    """The set-points of config/tclab.yaml, °C."""
    return np.array([_PROFILE[k // 450 % len(_PROFILE)] for k in range(size)])


def rest_level(power: float) -> float:
    """Temperature at which the simulated kit needs this power, %, with heater 2 at rest."""
    # what heater 1 loses by way of its neighbour
    neighbour_losses = 0.01 * (1.0 - 0.01 / 0.06)
    return 21.0 + power * 200.0 / 5720.0 / (0.05 + neighbour_losses)


def hold(power: float, size: int) -> FloatArray:
    """Set-points that end at rest at this power, %, after another level."""
    return np.where(np.arange(size) < 450, 40.0, rest_level(power))


def some_levels(seed: int, size: int, low: float, high: float, most: int) -> FloatArray:
    """Values between `low` and `high`, each held for 100 samples to `most`."""
    chosen = np.random.default_rng(seed + 10_000)
    level_of_sample: list[float] = []
    while len(level_of_sample) < size:
        level_of_sample += [float(chosen.uniform(low, high))] * int(
            chosen.integers(100, most)
        )
    return np.array(level_of_sample[:size])
