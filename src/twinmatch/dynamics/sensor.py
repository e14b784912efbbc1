"""The sensor of a loop: noise, quantisation, and pauses in which it repeats its reading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.declarations import PlantError
from twinmatch.signals import FloatArray


@compiled
def reading(
    seen: float, noise: float, frozen: bool, resolution: float, last: float
) -> float:
    """The reading of a value: noisy and quantised; the last reading while the sensor is frozen."""
    if frozen:
        return last
    value = seen + noise
    return (
        math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value
    )


@dataclass(frozen=True, slots=True, eq=False)
class SensorRealisation:
    """One camera over one run, with all its random values drawn in advance.

    Raises:
        PlantError: the arrays differ in length or the resolution is negative or not finite.
    """

    noise: FloatArray
    """Noise of each reading, unit of the output, shape (N,) for all outputs or (N, o)."""
    frozen: NDArray[np.bool_]
    """Where the camera repeats its last reading, shape (N,)."""
    resolution: float
    """Step of the reading, unit of the output; 0 for none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise", np.array(self.noise, dtype=np.float64))
        object.__setattr__(self, "frozen", np.array(self.frozen, dtype=np.bool_))
        if self.noise.ndim not in (1, 2) or self.noise.shape[:1] != self.frozen.shape:
            raise PlantError(
                f"sensor realisation: noise has shape {self.noise.shape} and frozen {self.frozen.shape}; "
                "give one value per sample in both"
            )
        has_resolution = math.isfinite(self.resolution) and self.resolution >= 0
        if not (has_resolution and np.isfinite(self.noise).all()):
            msg = "sensor realisation: noise and resolution must be finite, the resolution not negative"
            raise PlantError(msg)
        self.noise.flags.writeable = False
        self.frozen.flags.writeable = False

    def __len__(self) -> int:
        return len(self.noise)

    def reading(self, index: int, seen: float, last: float | None = None) -> float:
        """The reading at one tick of the value `seen`; `last` is the reading before.

        Without a reading before, a frozen sensor reads the value itself.

        Raises:
            PlantError: the realisation has no such index.
        """
        if not 0 <= index < len(self):
            raise PlantError(
                f"sensor realisation: reading {index} of {len(self)}; realise more samples"
            )
        frozen = bool(self.frozen[index]) and last is not None
        return reading(
            float(seen),
            float(self.noise[index]),
            frozen,
            float(self.resolution),
            last or 0.0,
        )


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor that may freeze for a moment now and then, like a camera that corrects its flat field.

    Raises:
        PlantError: a value is not finite or negative, or a pause lasts as long as its period.
    """

    noise: float = 0.0
    """Standard deviation of a reading, unit of the output; white."""
    resolution: float = 0.0
    """Step of the reading; 0 for none."""
    pause_period: float | None = None
    """Time between two pauses, s; None for a sensor that never pauses."""
    pause_duration: float = 0.9
    """Duration of a pause, in which the reading repeats, s."""

    def __post_init__(self) -> None:
        for name in ("noise", "resolution", "pause_duration"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise PlantError(
                    f"sensor: {name} is {value}; it must be finite and not negative"
                )
        period = self.pause_period
        if period is not None and not (
            math.isfinite(period) and period > self.pause_duration
        ):
            raise PlantError(
                f"sensor: a pause every {period} s leaves no time between pauses of "
                f"{self.pause_duration} s; make the period longer or None"
            )

    def realise(self, samples: int, period: float, seed: int) -> SensorRealisation:
        """Draw noise and pauses for `samples` ticks of `period` seconds; the same seed gives the same run.

        The first pause comes at a random moment of the first pause period.

        Raises:
            PlantError: the number of samples is negative or the period not positive.
        """
        if samples < 0 or not (math.isfinite(period) and period > 0):
            msg = f"sensor: cannot realise {samples} samples of {period} s; give a positive period"
            raise PlantError(msg)
        random = np.random.Generator(np.random.PCG64(seed))
        noise = self.noise * random.standard_normal(samples)
        frozen = np.zeros(samples, dtype=np.bool_)
        if self.pause_period is not None:
            since = np.arange(samples) * period - random.uniform(0, self.pause_period)
            frozen = (since >= 0) & (
                np.mod(since, self.pause_period) < self.pause_duration
            )
        return SensorRealisation(noise, frozen, self.resolution)
