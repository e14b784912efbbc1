"""The energy balance of the plate: what should have moved it since the sample before, and what did.

The plant's equations say how far the plate goes in one period under the PWM and how far without; the
difference is the drive's part, the rest the surroundings'. Both are taken at the measured temperature, so
that no error of the twin is carried from one sample to the next. What they get wrong on this rig is slow,
and is learned as four numbers: a share too much of the drive's part, one of the surroundings' part, a
constant, and a share of the drive's mean over some minutes, which is what a heat sink with mass looks like.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.plant import Driver, PlantState, RigParameters, advance
from twinmatch.signals import KELVIN, FloatArray

__all__ = ["BLOCK", "PRIOR", "TRIAL", "Balance", "Movement", "uncertainty"]

BLOCK: Final = 10.0
"""Learning goes by means over this many seconds."""
_SINK_TIME: Final = 150.0
"""Time over which the drive's part is averaged to stand for the warmth of the heat sink, s."""
PRIOR: Final = np.square([0.3, 0.4, 0.1, 0.3])
"""Variances of the four corrections before anything is known; the third in (°C/s)²."""
_BLOCK_NOISE: Final = 0.2
"""What a block is off by for other reasons, °C/s: weighs one block against what is known."""
_MEMORY: Final = 360
"""Blocks (an hour) after which what was learned counts as old."""
_LARGEST_SURPRISE: Final = 0.3
"""A block teaches no more than this, °C/s."""
_WARY: Final = 3
"""Blocks that have to pass in health before one is learned from."""
TRIAL: Final = 30
"""Newest blocks on which new parameters are tried."""
_ROUGH: Final = 0.15
"""Roughness up to which there is no reason to try others, °C/s: a healthy rig reaches it."""
_BETTER: Final = 0.25
"""Share of the mean square left so far that they have to get below: half the error."""


_DRIVER: Final = Driver()


@dataclass(frozen=True, slots=True)
class Movement:
    """One period of the plate, °C."""

    drive: float
    """Done by the PWM."""
    passive: float
    """Done by everything else."""
    unexplained: float
    """Measured minus both."""


class _Correction:
    """Recursive least squares of the four numbers."""

    def __init__(self) -> None:
        self.values: FloatArray = np.zeros(4)
        self.covariance: FloatArray = np.diag(PRIOR)

    def learn(self, parts: FloatArray, surplus: float) -> None:
        """Take the mean parts of one block and what they leave unexplained uncorrected, °C/s."""
        surprise = surplus - float(parts @ self.values)
        surprise = min(max(surprise, -_LARGEST_SURPRISE), _LARGEST_SURPRISE)
        reach = self.covariance @ parts
        gain = reach / (_BLOCK_NOISE**2 + float(parts @ reach))
        self.values = self.values + gain * surprise
        self.covariance = self.covariance - np.outer(gain, reach)
        self.covariance = self.covariance + (np.diag(PRIOR) - self.covariance) / _MEMORY


class Balance:
    """Keeps the balance of one twin and learns what the twin gets wrong."""

    def __init__(self, parameters: RigParameters, period: float) -> None:
        """Begin with the twin's parameters and the sample time in s."""
        self.parameters = parameters
        self._period = period
        self._block = max(2, round(BLOCK / period))
        self._correction = _Correction()
        self._values = [0.0, 0.0, 0.0, 0.0]
        self._sink = parameters.ambient
        self._warmth = 0.0
        self._waiting: deque[tuple[FloatArray, float]] = deque()
        self._past: deque[tuple[float, float]] = deque(maxlen=TRIAL * self._block)  # temperature, pwm
        self._errors: deque[float] = deque(maxlen=TRIAL)
        self.roughness = 0.0
        """RMS over the newest minutes of what blocks left unexplained, °C/s."""
        self._clear()

    @property
    def knowledge(self) -> tuple[FloatArray, FloatArray]:
        """The four corrections as learned so far, and their covariance."""
        return self._correction.values, self._correction.covariance

    def restart(self) -> None:
        """Begin anew behind a gap, keeping what was learned."""
        self._clear()
        self._waiting.clear()
        self._past.clear()
        self._warmth = 0.0
        self._sink = self.parameters.ambient

    def step(self, temperature: float, pwm: float, after: float) -> Movement:
        """The movement from a temperature (°C), under a PWM, to that of one period after."""
        drive, passive = self._parts(temperature, pwm)
        self._past.append((temperature, pwm))
        a, b, c, d = self._values
        moved = after - temperature
        constant = (c + d * self._warmth) * self._period
        self._sums[0] += drive
        self._sums[1] += passive
        self._sums[2] += self._period
        self._sums[3] += self._warmth * self._period
        self._moved += moved
        self._count += 1
        self._warmth += (drive / self._period - self._warmth) * self._period / _SINK_TIME
        explained = (1.0 + a) * drive + (1.0 + b) * passive + constant
        # The drive's part may be corrected, but not away.
        return Movement(max(1.0 + a, 0.5) * drive, (1.0 + b) * passive + constant, moved - explained)

    def block(self) -> tuple[FloatArray, float] | None:
        """When a block is full: its mean parts, and what they leave unexplained uncorrected, °C/s."""
        if self._count < self._block:
            return None
        span = self._count * self._period
        parts = np.array(self._sums) / span
        surplus = (self._moved - self._sums[0] - self._sums[1]) / span
        self._clear()
        return parts, surplus

    def learn(self, parts: FloatArray, surplus: float, *, healthy: bool) -> None:
        """Take in a block; it is learned from once those after it were healthy too."""
        if not healthy:
            self._waiting.clear()
            return
        self._errors.append(surplus - float(parts @ self._correction.values))
        self.roughness = math.sqrt(sum(e * e for e in self._errors) / len(self._errors))
        self._waiting.append((parts, surplus))
        if len(self._waiting) > _WARY:
            self._correction.learn(*self._waiting.popleft())
            self._values = self._correction.values.tolist()

    @property
    def rough(self) -> bool:
        """Whether there is reason to try other parameters."""
        return len(self._errors) >= TRIAL // 3 and self.roughness > _ROUGH

    def tried(self, parameters: RigParameters) -> Balance:
        """The balance to go on with: one of these parameters if, as they are, they explain the newest
        minutes better than this one with all it learned; else this one."""
        trial = Balance(parameters, self._period)
        errors = []
        past = list(self._past)
        for (temperature, pwm), (after, _) in itertools.pairwise(past):
            trial.step(temperature, pwm, after)
            full = trial.block()
            if full is not None:
                errors.append(full[1])
                trial.learn(*full, healthy=True)
        better = errors and np.mean(np.square(errors)) < _BETTER * self.roughness**2
        return trial if better else self

    def _parts(self, temperature: float, pwm: float) -> tuple[float, float]:
        state = PlantState(plate=temperature + KELVIN, sink=self._sink)
        driven = advance(self.parameters, state, pwm, self._period, _DRIVER)
        idle = advance(self.parameters, state, 0.0, self._period, _DRIVER)
        self._sink = driven.sink
        return driven.plate - idle.plate, idle.plate - state.plate

    def _clear(self) -> None:
        self._sums = [0.0, 0.0, 0.0, 0.0]
        self._moved = 0.0
        self._count = 0


def uncertainty(parts: FloatArray, covariance: FloatArray, floor: float) -> float:
    """Standard error of a corrected prediction for these parts, °C/s, never below the floor."""
    return math.sqrt(floor**2 + float(parts @ covariance @ parts))
