"""The loop around a plant: its PID controller and its sensor, with the compiled arithmetic of one sample.

The controller has the parallel form, forward Euler, and back-calculation against windup. The sensor has
noise, quantisation, and pauses in which it repeats its reading.
"""

# ruff: noqa: PLR0917 (kernels take arrays in a row)

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.declarations import PlantError
from twinmatch.signals import FloatArray, Window

_MOST_AMPLIFICATION = 1e3


class Gains(NamedTuple):
    """The values of `PidGains`, for compiled code."""

    proportional: float
    integral: float
    derivative: float
    back_calculation: float
    period: float
    low: float
    high: float
    on_measurement: bool


_NUMBERS = attrgetter(*Gains._fields[:-1])


@compiled
def pid_step(
    gains: Gains, integral: float, previous: float, reference: float, output: float
) -> tuple[float, float, float]:
    """Command u of one sample, and the controller's new state: integral and differentiated signal."""
    error = reference - output
    moved = -output if gains.on_measurement else error
    unlimited = gains.proportional * error + integral + gains.derivative * (moved - previous) / gains.period
    u = min(max(unlimited, gains.low), gains.high)
    integral += gains.period * (gains.integral * error + gains.back_calculation * (u - unlimited))
    return u, integral, moved


@compiled(innermost=True)
def loop_step(
    gains: Gains, integral: float, previous_error: float, reference: float, y: float, dy: FloatArray,
    d_integral: FloatArray, d_error: FloatArray, du: FloatArray, n: int,
) -> tuple[float, float, float, float]:  # fmt: skip
    """The controller's step with the derivatives of its state; d_error is that of `previous_error`."""
    u, after, error = pid_step(gains, integral, previous_error, reference, y)
    per_second = gains.derivative / gains.period
    free = 1.0 if gains.low < u < gains.high else 0.0
    for j in range(n):
        unlimited = d_integral[j] - (gains.proportional + per_second) * dy[j] - per_second * d_error[j]
        du[j] = free * unlimited
        d_integral[j] += gains.period * (
            gains.back_calculation * (du[j] - unlimited) - gains.integral * dy[j]
        )
        d_error[j] = -dy[j]
    return u, after, error, free


@compiled
def reading(seen: float, noise: float, frozen: bool, resolution: float, last: float) -> float:
    """The reading of a value: noisy and quantised; the last reading while the sensor is frozen."""
    if frozen:
        return last
    value = seen + noise
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@dataclass(frozen=True, slots=True)
class PidGains:
    """Gains and limits of the controller, in units of the plant's input u and output y.

    Raises:
        PlantError: a value is not finite, the period is not positive, or the limits are not in order.
    """

    proportional: float
    """u per y."""
    integral: float
    """u per y and second."""
    derivative: float
    """u per y/s."""
    back_calculation: float
    """Back-calculation gain Kb, by which the integral tracks the limited u, 1/s."""
    low: float
    """Least u."""
    high: float
    """Greatest u."""
    period: float = 1.0
    """Sample time Ts, s."""
    on_measurement: bool = False
    """Whether the derivative is that of −y, which avoids derivative kick at set-point steps."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in self.constants):
            msg = f"PID gains: {self} holds a value that is not finite"
            raise PlantError(msg)
        if self.period <= 0 or not self.low < self.high:
            raise PlantError(
                f"PID gains: the period {self.period} s must be positive and the limits {self.low} and "
                f"{self.high} in increasing order"
            )

    @property
    def constants(self) -> Gains:
        """The same numbers for compiled code."""
        return Gains._make((*map(float, _NUMBERS(self)), bool(self.on_measurement)))

    def saturates(self, u: float) -> bool:
        """Whether a command is on a limit."""
        return not self.low < u < self.high


@dataclass(frozen=True, slots=True)
class PidState:
    """State of the controller between two samples."""

    integral: float = 0.0
    """Integral part of the next u, in its unit."""
    previous: float = 0.0
    """The differentiated signal at the last sample: e = r − y, or −y."""


class Pid:
    """A controller in operation.

    At each sample e = r − y, v = P·e + x + D·(e − e_prev)/Ts, u = clip(v, low, high), and then
    x += Ts·(I·e + Kb·(u − v)). It starts with x = 0 and e_prev = 0.
    """

    def __init__(self, gains: PidGains, state: PidState | None = None) -> None:
        self.gains = gains
        self.state = state or PidState()
        self._constants = self.gains.constants

    def step(self, reference: float, output: float) -> float:
        """Compute u of one sample from set-point and output.

        Raises:
            PlantError: reference or output is not finite; the state is unchanged.
        """
        _require_finite(reference=reference, output=output)
        u, integral, previous = pid_step(
            self._constants,
            float(self.state.integral),
            float(self.state.previous),
            float(reference),
            float(output),
        )
        self.state = PidState(integral, previous)
        return u

    def follow(self, reference: float, output: float, u: float) -> None:
        """Adopt the state after a sample whose u was computed by another controller with the same gains.

        With Kb·Ts = 1 the sample and the one before it determine the new state. Otherwise they do so if
        u was not limited; if it was, this controller's own integral is updated by the back-calculation,
        which forgets by the factor 1 − Kb·Ts each sample.

        Raises:
            PlantError: a value is not finite; the state is unchanged.
        """
        _require_finite(reference=reference, output=output, input=u)
        error = reference - output
        moved = -output if self.gains.on_measurement else error
        consistent = _consistent_integral(self.gains, error, moved - self.state.previous, u)
        before = self.state.integral if self.gains.saturates(u) else consistent
        self.state = PidState(_next_integral(self.gains, before, consistent, error), moved)


def controller_state(window: Window, gains: PidGains) -> PidState:
    """State of the controller after the window's second sample, found from the recorded signals.

    With Kb·Ts = 1 it follows exactly from the first two samples. Otherwise it is exact if the second
    sample is not limited; if it is, the state is computed backwards from the first sample that is not
    limited, unless there is none or that would amplify rounding more than a thousandfold: then the
    smallest state that explains the limited sample is used.

    Raises:
        PlantError: the window holds fewer than two samples.
    """
    if len(window) < 2:
        msg = f"controller state: the window holds {len(window)} sample; give at least two"
        raise PlantError(msg)
    error = window.reference - window.output
    moved = -window.output if gains.on_measurement else error
    kept = 1.0 - gains.back_calculation * gains.period
    free = next((k for k in range(1, len(window)) if not gains.saturates(float(window.input[k]))), None)

    def consistent(k: int) -> float:
        change = float(moved[k] - moved[k - 1])
        return _consistent_integral(gains, float(error[k]), change, float(window.input[k]))

    integral = consistent(1)
    if free is not None and free > 1 and abs(kept) ** (free - 1) * _MOST_AMPLIFICATION >= 1:
        integral = consistent(free)
        for k in range(free - 1, 0, -1):
            integral += (1 - kept) * (integral - consistent(k)) / kept
            integral -= gains.period * gains.integral * float(error[k]) / kept
    return PidState(_next_integral(gains, integral, consistent(1), float(error[1])), float(moved[1]))


def _consistent_integral(gains: PidGains, error: float, change: float, u: float) -> float:
    """The integral with which the unlimited controller gives exactly this u."""
    return u - gains.proportional * error - gains.derivative * change / gains.period


def _next_integral(gains: PidGains, integral: float, consistent: float, error: float) -> float:
    # u − v = consistent − integral; with Kb·Ts = 1 the integral before the sample drops out.
    excess = gains.back_calculation * gains.period * (consistent - integral)
    return integral + excess + gains.period * gains.integral * error


def _require_finite(**signals: float) -> None:
    for name, value in signals.items():
        if not math.isfinite(value):
            msg = f"PID: {name} is {value}; the controller takes only finite values"
            raise PlantError(msg)


@dataclass(frozen=True, slots=True, eq=False)
class SensorRealisation:
    """One camera over one run, with all its random values drawn in advance.

    Raises:
        PlantError: the arrays differ in length or the resolution is negative or not finite.
    """

    noise: FloatArray
    """Noise of each reading, unit of the output, shape (N,)."""
    frozen: NDArray[np.bool_]
    """Where the camera repeats its last reading, shape (N,)."""
    resolution: float
    """Step of the reading, unit of the output; 0 for none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise", np.array(self.noise, dtype=np.float64))
        object.__setattr__(self, "frozen", np.array(self.frozen, dtype=np.bool_))
        if self.noise.ndim != 1 or self.noise.shape != self.frozen.shape:
            raise PlantError(
                f"sensor realisation: noise has shape {self.noise.shape} and frozen {self.frozen.shape}; "
                "give one value per sample in both"
            )
        if not (np.isfinite(self.noise).all() and math.isfinite(self.resolution) and self.resolution >= 0):
            msg = "sensor realisation: noise and resolution must be finite, the resolution not negative"
            raise PlantError(msg)
        self.noise.flags.writeable = False
        self.frozen.flags.writeable = False

    def __len__(self) -> int:
        return int(self.noise.size)

    def reading(self, index: int, seen: float, last: float | None = None) -> float:
        """The reading at one tick of the value `seen`; `last` is the reading before.

        Without a reading before, a frozen sensor reads the value itself.

        Raises:
            PlantError: the realisation has no such index.
        """
        if not 0 <= index < len(self):
            msg = f"sensor realisation: reading {index} of {len(self)}; realise more samples"
            raise PlantError(msg)
        frozen = bool(self.frozen[index]) and last is not None
        return reading(float(seen), float(self.noise[index]), frozen, float(self.resolution), last or 0.0)


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
                msg = f"sensor: {name} is {value}; it must be finite and not negative"
                raise PlantError(msg)
        period = self.pause_period
        if period is not None and not (math.isfinite(period) and period > self.pause_duration):
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
            frozen = (since >= 0) & (np.mod(since, self.pause_period) < self.pause_duration)
        return SensorRealisation(noise, frozen, self.resolution)
