"""The energy balance of the plant: expected and measured movement of its output from sample to sample.

The plant's equations give the movement of the output in one period under the input and with the drive at
rest; the difference is the drive's part, the rest the surroundings'. Both start at the measured output, so
that no error of the twin accumulates from one sample to the next. Their errors are assumed to be slow, and
are learned as four corrections: a share of the drive's part, a share of the surroundings' part, a constant,
and a share of the drive's mean over some minutes, which is how a heat sink with mass shows.

Sizes are counted in units of the output's noise, rates in that per second.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.pace import slow_scale
from twinmatch.health.earned import Record
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Sample

BLOCK: Final = 10.0
"""Length of a block, s: corrections are learned from the means of blocks."""


class _CorrectionRule(Rule):
    """How the four corrections of a balance are learned."""

    warmth: float = 150.0
    """Time over which the drive's part is averaged to stand for the warmth of a heat sink, s."""
    noise: float = 2.0
    """Standard deviation of a block's error from other causes: sets the weight of one block."""
    memory: int = 360
    """Forgetting time of the corrections, blocks (an hour)."""
    largest_error: float = 3.0
    """Limit on the error of a block that is learned from."""
    confirming: int = 3
    """Healthy blocks that must follow before a block is learned from."""
    counted_after: int = 6
    """Blocks after which one counts against a record that was earned: by then a fault has been reported."""


_CORRECTIONS: Final = _CorrectionRule()


_PRIOR: Final = (0.3, 0.4, 1.0, 0.3)
"""Standard deviations of the four corrections before anything is known; the third in noises per second."""
_KEPT: Final = 1.0 - 1.0 / 60.0
"""Factor by which a block reduces the weight of the record before: its memory is ten minutes, so that a start
that went wrong is soon forgotten."""
TRIAL: Final = 30
"""Number of newest blocks on which other parameters are tried."""


class _OtherParameters(Rule):
    """When other parameters are tried, and taken."""

    rough: float = 1.5
    """Roughness below which no other parameters are tried: a healthy rig reaches it."""
    better: float = 0.25
    """Share of the mean square error that they must get below: half the error."""


_OTHERS: Final = _OtherParameters()


@dataclass(frozen=True, slots=True)
class Movement:
    """One period of the plant, in the output's unit."""

    drive: float
    """Part due to the input."""
    passive: float
    """Part due to everything else."""
    unexplained: float
    """Measured minus both."""


class _LearnedCorrections:
    """Recursive least squares of the four corrections."""

    def __init__(self, noise: float) -> None:
        self.values: FloatArray = np.zeros(4)
        self._prior = _prior(noise)
        self._noise = noise
        self.covariance: FloatArray = self._prior

    def learn(self, parts: FloatArray, surplus: float) -> None:
        """Take the mean parts of one block and the error of the uncorrected balance, per second."""
        error = surplus - float(parts @ self.values)
        largest = _CORRECTIONS.largest_error * self._noise
        error = min(max(error, -largest), largest)
        reach = self.covariance @ parts
        gain = reach / ((_CORRECTIONS.noise * self._noise) ** 2 + float(parts @ reach))
        self.values = self.values + gain * error
        self.covariance = self.covariance - np.outer(gain, reach)
        self.covariance = (
            self.covariance + (self._prior - self.covariance) / _CORRECTIONS.memory
        )


class Balance:
    """Keeps the balance of one twin and learns to correct the twin's errors."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with the twin's parameters and the sample time in s."""
        self.parameters = parameters
        self.noise = parameters.model.plant.output.noise
        """Standard deviation of a reading's noise: the unit of every limit."""
        self._drive_at_rest = float(parameters.model.plant.drive.rest)
        self._steps = parameters.steps(period)
        self._sample_time = period
        self._pace = period / slow_scale(parameters.model.plant, period)
        """The sample time of a plant as fast as the rig, s: rates are per second of such a plant."""
        self._block = max(2, round(BLOCK / self._pace))
        self._block_time = self._block * self._pace
        self._corrections = _LearnedCorrections(self.noise)
        self._values = [0.0, 0.0, 0.0, 0.0]
        self._states: FloatArray = np.full(len(parameters.model.states), np.nan)
        self._warmth = 0.0
        self._waiting: deque[tuple[FloatArray, float]] = deque()
        self._past: deque[Sample] = deque(maxlen=TRIAL * self._block)
        self._errors: deque[float] = deque(maxlen=TRIAL)
        # errors if the drive had no effect
        self._resting: deque[float] = deque(maxlen=TRIAL)
        self._record = Record()
        self._unsettled = deque[tuple[float, float]]()
        self.roughness = 0.0
        """RMS error of the corrected balance over the newest blocks, per second."""
        self.at_rest = 0.0
        """RMS error over these blocks of the balance without its drive's part: that after the loss of a
        drive."""
        self._clear()

    @property
    def knowledge(self) -> tuple[FloatArray, FloatArray]:
        """The four corrections as learned so far, and their covariance."""
        return self._corrections.values, self._corrections.covariance

    def restart(self) -> None:
        """Start over after a gap, keeping the learned corrections."""
        self._clear()
        self._waiting.clear()
        self._past.clear()
        self._warmth = 0.0
        self._states = np.full_like(self._states, np.nan)

    def step(self, sample: Sample, after: float) -> Movement:
        """The movement from a sample's output, under its input, to the output `after` one period."""
        drive, passive = self._parts(sample)
        self._past.append(sample)
        more_drive, more_passive, rate, rate_of_warmth = self._values
        moved = after - sample.output
        constant = (rate + rate_of_warmth * self._warmth) * self._pace
        self._sums[0] += drive
        self._sums[1] += passive
        self._sums[2] += self._pace
        self._sums[3] += self._warmth * self._pace
        self._moved += moved
        self._count += 1
        self._warmth += (
            (drive / self._pace - self._warmth) * self._pace / _CORRECTIONS.warmth
        )
        explained = (
            (1.0 + more_drive) * drive + (1.0 + more_passive) * passive + constant
        )
        # The drive's part may be corrected, but not to nothing.
        corrected_drive = max(1.0 + more_drive, 0.5) * drive
        return Movement(
            corrected_drive,
            (1.0 + more_passive) * passive + constant,
            moved - explained,
        )

    def block(self) -> tuple[FloatArray, float] | None:
        """The mean parts of a full block and the error of the uncorrected balance, per second; else None."""
        if self._count < self._block:
            return None
        span = self._count * self._pace
        parts = np.array(self._sums) / span
        surplus = (self._moved - self._sums[0] - self._sums[1]) / span
        self._clear()
        return parts, surplus

    def learn(self, parts: FloatArray, surplus: float, *, healthy: bool) -> None:
        """Queue a block; it is learned from once the blocks after it were healthy too."""
        if not healthy:
            self._waiting.clear()
            return
        self._errors.append(self._error_of(parts, surplus))
        self._resting.append(surplus + float(parts[0]))
        self.roughness = _root_mean_square(self._errors)
        self.at_rest = _root_mean_square(self._resting)
        self._waiting.append((parts, surplus))
        if len(self._waiting) > _CORRECTIONS.confirming:
            self._corrections.learn(*self._waiting.popleft())
            self._values = self._corrections.values.tolist()

    @property
    def earned(self) -> bool:
        """Whether it has predicted the plant."""
        return self._record.earned(self.noise / self._block_time)

    @property
    def sees_drive(self) -> bool:
        """Whether it may say that the drive is missing."""
        return self._record.sees_drive(self.noise / self._block_time)

    def compare(self, parts: FloatArray, surplus: float) -> None:
        """Compare a block with what was expected of it; it counts unless a fault is reported soon after."""
        self._unsettled.append(
            (self._error_of(parts, surplus), surplus + float(parts[0] + parts[1]))
        )
        while len(self._unsettled) > (_CORRECTIONS.counted_after if self.earned else 0):
            self._record = self._record.after(*self._unsettled.popleft(), _KEPT)

    def forget_newest(self) -> None:
        """A fault began: the newest blocks do not count."""
        self._unsettled.clear()

    @property
    def rough(self) -> bool:
        """Whether the balance is so inaccurate that other parameters should be tried."""
        return self._enough_blocks and self.roughness > _OTHERS.rough * self.noise

    @property
    def smooth(self) -> bool:
        """Whether the balance has proved to explain the plant well."""
        return self._enough_blocks and self.roughness <= _OTHERS.rough * self.noise

    @property
    def _enough_blocks(self) -> bool:
        return len(self._errors) >= TRIAL // 3

    def better_of(self, parameters: Parameters) -> Balance:
        """Choose the balance to continue with: a new one with these parameters if it explains the newest
        blocks better, without corrections, than this one with its corrections; else this one."""
        trial = Balance(parameters, self._sample_time)
        errors = []
        past = list(self._past)
        for sample, after in itertools.pairwise(past):
            trial.step(sample, after.output)
            full = trial.block()
            if full is not None:
                errors.append(full[1])
                trial.learn(*full, healthy=True)
        better = (
            errors and np.mean(np.square(errors)) < _OTHERS.better * self.roughness**2
        )
        return trial if better else self

    def _parts(self, sample: Sample) -> tuple[float, float]:
        """The drive's part and the rest; unmeasured states are carried over from sample to sample."""
        model = self.parameters.model
        row = model.disturbance_row(sample.disturbances or None)
        drive, passive, self._states = model.kernels.parts(
            self.parameters.vector,
            float(sample.output),
            self._states,
            float(sample.input),
            self._drive_at_rest,
            row,
            self._sample_time,
            self._steps,
        )
        return drive, passive

    def _error_of(self, parts: FloatArray, surplus: float) -> float:
        """Error of the corrected balance in a block, per second."""
        return surplus - float(parts @ self._corrections.values)

    def _clear(self) -> None:
        """Begin a block."""
        # What each correction multiplies: drive's part, rest, time, and warmth of a heat sink times time.
        self._sums = [0.0, 0.0, 0.0, 0.0]
        self._moved = 0.0
        self._count = 0


def _prior(noise: float) -> FloatArray:
    """Covariance of the four corrections before anything is known, for an output of this noise."""
    return np.diag(np.square(_PRIOR) * np.square([1.0, 1.0, noise, 1.0]))


def _root_mean_square(errors: deque[float]) -> float:
    return math.sqrt(sum(error * error for error in errors) / len(errors))
