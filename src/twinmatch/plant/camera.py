"""The thermal camera as the loop sees it: noise, quantisation, and pauses for flat-field correction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinmatch.plant import kernels
from twinmatch.plant.parameters import PlantError
from twinmatch.signals import FloatArray

__all__ = ["Camera", "CameraRealisation"]


@dataclass(frozen=True, slots=True, eq=False)
class CameraRealisation:
    """One camera over one run: everything random about it, drawn beforehand.

    Raises:
        PlantError: the arrays differ in length or the resolution is negative or not finite.
    """

    noise: FloatArray
    """Noise of each reading, °C, shape (N,)."""
    frozen: NDArray[np.bool_]
    """Where the camera repeats its last reading, shape (N,)."""
    resolution: float
    """Step of the reading, °C; 0 for none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise", np.array(self.noise, dtype=np.float64))
        object.__setattr__(self, "frozen", np.array(self.frozen, dtype=np.bool_))
        if self.noise.ndim != 1 or self.noise.shape != self.frozen.shape:
            msg = (
                f"camera realisation: noise has shape {self.noise.shape} and frozen {self.frozen.shape}; "
                "give one value per sample in both"
            )
            raise PlantError(msg)
        if not (np.isfinite(self.noise).all() and math.isfinite(self.resolution) and self.resolution >= 0):
            msg = "camera realisation: noise and resolution must be finite, the resolution not negative"
            raise PlantError(msg)
        self.noise.flags.writeable = False
        self.frozen.flags.writeable = False

    def __len__(self) -> int:
        return int(self.noise.size)

    def reading(self, index: int, seen: float, last: float | None = None) -> float:
        """What the camera says at one tick, °C, of what it sees in kelvin; `last` is its reading before.

        It sees the plate, or what the sensor's lag makes of it (`PlantState.sensor`). Without a reading
        before, a frozen camera shows what it sees.

        Raises:
            PlantError: the realisation is shorter than that.
        """
        if not 0 <= index < len(self):
            msg = f"camera realisation: reading {index} asked of {len(self)}; realise more samples"
            raise PlantError(msg)
        frozen = bool(self.frozen[index]) and last is not None
        noise = float(self.noise[index])
        return kernels.reading(float(seen), noise, frozen, float(self.resolution), float(last or 0.0))


@dataclass(frozen=True, slots=True)
class Camera:
    """A radiometric camera whose shutter closes now and then for flat-field correction.

    Raises:
        PlantError: a value is not finite or negative, or the correction lasts as long as its period.
    """

    noise: float = 0.1
    """Standard deviation of a reading, °C; white."""
    resolution: float = 0.01
    """Step of the reading, °C; 0 for none."""
    flat_field_period: float | None = 180.0
    """Time between two corrections, s; None for a camera that never corrects."""
    flat_field_duration: float = 0.9
    """How long the picture stands still during a correction, s."""

    def __post_init__(self) -> None:
        for name in ("noise", "resolution", "flat_field_duration"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                msg = f"camera: {name} is {value}; it must be finite and not negative"
                raise PlantError(msg)
        period = self.flat_field_period
        if period is not None and not (math.isfinite(period) and period > self.flat_field_duration):
            msg = (
                f"camera: a flat-field period of {period} s leaves no time between corrections of "
                f"{self.flat_field_duration} s; make it longer or None"
            )
            raise PlantError(msg)

    def realise(self, samples: int, period: float, seed: int) -> CameraRealisation:
        """Draw noise and corrections for `samples` ticks of `period` seconds; the same seed, the same run.

        The first correction comes at a random moment of the first flat-field period.

        Raises:
            PlantError: the number of samples is negative or the period not positive.
        """
        if samples < 0 or not (math.isfinite(period) and period > 0):
            msg = f"camera: cannot realise {samples} samples of {period} s"
            raise PlantError(msg)
        random = np.random.Generator(np.random.PCG64(seed))
        noise = self.noise * random.standard_normal(samples)
        frozen = np.zeros(samples, dtype=np.bool_)
        if self.flat_field_period is not None:
            since = np.arange(samples) * period - random.uniform(0, self.flat_field_period)
            frozen = (since >= 0) & (np.mod(since, self.flat_field_period) < self.flat_field_duration)
        return CameraRealisation(noise, frozen, self.resolution)
