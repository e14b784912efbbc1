"""The closed loop and, in the same pass, its derivatives by the rig parameters.

For a plate on a held sink without further structure. Within a tick the temperature difference x follows
x' = second·x² + first·x + zeroth with constant coefficients (see `kernels`), whose solution has closed
derivatives by the three coefficients; these are carried through camera and PID with the chain rule. Where
the current limiter switches, the rate is continuous, so the derivatives simply go on; where the PWM is
saturated, the loop is cut for that tick.

numba's disk cache looks only at the file of the function that is called from Python; that is why this
file has a tick of its own. A test holds it against that of `kernels`.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 (kernels take scalars in a row and are long)

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.compiled import compiled
from twinmatch.plant.driver import Driver
from twinmatch.plant.kernels import Gains, riccati_arrival
from twinmatch.plant.parameters import PARAMETER_NAMES, PlantError, RigParameters, require_kelvin
from twinmatch.plant.pid import PidGains, PidState
from twinmatch.signals import KELVIN, FloatArray

__all__ = ["DIFFERENTIABLE", "LoopSensitivity", "Tangents", "noise_scores"]

DIFFERENTIABLE = ("seebeck", "resistance", "conductance", "heat_capacity", "ambient")
"""Names of the parameters by which `LoopSensitivity` differentiates."""

_NOTHING, _NO_WEIGHTS = np.zeros((2, 0)), np.zeros(2)


class Tangents(NamedTuple):
    """A closed loop and its derivatives; n parameters, N samples."""

    temperature: FloatArray
    """Temperature, °C, shape (N,)."""
    pwm: FloatArray
    """Command, shape (N,)."""
    derivative: FloatArray
    """Of temperature and PWM by each parameter in its own unit, shape (2, N, n)."""
    slopes: FloatArray
    """Derivative of the next temperature by this one and by the PWM, and 1 where the PWM is not
    saturated, shape (N, 3)."""


class LoopSensitivity:
    """The closed loop over one reference, ready to be run with one rig after another.

    Arguments as in `simulate_closed_loop`; the camera is noise-free.

    Raises:
        PlantError: a name is not among `DIFFERENTIABLE`, or the start is not in kelvin.
    """

    def __init__(
        self,
        names: Sequence[str],
        reference: ArrayLike,
        *,
        plate: float,
        controller: PidState | None = None,
        gains: PidGains | None = None,
        driver: Driver | None = None,
    ) -> None:
        unknown = [name for name in names if name not in DIFFERENTIABLE]
        if unknown:
            msg = f"sensitivity: {unknown[0]!r} is none of {', '.join(DIFFERENTIABLE)}"
            raise PlantError(msg)
        self._which = np.array([DIFFERENTIABLE.index(name) for name in names], dtype=np.int64)
        self._reference = np.array(reference, dtype=np.float64)
        self._plate = require_kelvin("sensitivity: plate", plate)
        self._controller = controller or PidState()
        self._gains = (gains or PidGains()).constants
        self._driver = driver or Driver()

    @staticmethod
    def handles(parameters: RigParameters) -> bool:
        """Whether this rig is of the kind differentiated here: a plate on a held sink, and nothing else."""
        plain = RigParameters()
        others = (name for name in PARAMETER_NAMES if name not in DIFFERENTIABLE)
        return all(getattr(parameters, name) == getattr(plain, name) for name in others)

    def __call__(self, values: FloatArray) -> Tangents:
        """Run the loop with these values of all `DIFFERENTIABLE` parameters, shape (5,)."""
        return Tangents(*self._run(values, _NOTHING, _NO_WEIGHTS, stored=True)[:4])

    def normal_equations(
        self, values: FloatArray, measured: FloatArray, weights: tuple[float, float]
    ) -> tuple[float, FloatArray, FloatArray]:
        """Sum of squares, gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n), without any array over time.

        `measured` holds temperature and PWM, shape (2, N); a residual of each is multiplied by its weight.
        """
        squares = np.square(np.array(weights))
        normal = self._run(values, measured, squares, stored=False)[4]
        n = self._which.size
        return float(normal[n, n]), normal[:n, n].copy(), normal[:n, :n].copy()

    def _run(
        self, values: FloatArray, measured: FloatArray, weights: FloatArray, *, stored: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        driver = self._driver
        return _loop_with_tangents(
            values,
            driver.bridge_resistance,
            driver.volts_per_count,
            float(driver.current_limit),
            self._gains,
            self._which,
            self._reference,
            self._plate,
            float(self._controller.integral),
            float(self._controller.previous_error),
            measured,
            weights,
            stored,
        )


def noise_scores(
    tangents: Tangents, weighed: FloatArray, weights: tuple[float, float], gains: PidGains
) -> tuple[FloatArray, float]:
    """What the camera's white noise does to the sums Σ_j weighed_j·residual_j.

    Args:
        tangents: the loop.
        weighed: rows of the weighed residuals' Jacobian, shape (2, N, n).
        weights: of a residual of temperature and of PWM for noise of 1 in the readings.
        gains: the controller.

    Returns:
        The sums that noise of size 1 at each sample alone would leave, shape (N, n), and the mean
        squared residual left by all of them. Noise of the first reading also misplaces the twin's start.
    """
    return _noise_scores(tangents.slopes, np.ascontiguousarray(weighed), *weights, gains.constants)


@compiled
def _flow(quadratic: float, slope: float, speed: float, time: float) -> tuple[float, float, float, float]:
    """y(time) of y' = quadratic·y² + slope·y + speed from y(0) = 0, and its derivatives by the three.

    With s² the discriminant, σ = sinh(s·time/2)/s and κ = cosh(s·time/2): y = 2·speed·σ/(κ − slope·σ), and
    κ dσ − σ dκ = ρ ds² with ρ = (time/2 − σκ)/(2s²). For long times σ and κ are taken times
    exp(−s·time/2), for short ones, which is what a plate has, from their series.
    """
    discriminant = slope * slope - 4.0 * quadratic * speed
    half = 0.5 * time
    square = discriminant * half * half
    if abs(square) < 0.025:
        sigma = half * (
            1.0 + square * (1 / 6 + square * (1 / 120 + square * (1 / 5040 + square * (1 / 362880))))
        )
        kappa = 1.0 + square * (
            1 / 2 + square * (1 / 24 + square * (1 / 720 + square * (1 / 40320 + square * (1 / 3628800))))
        )
        below = kappa - slope * sigma
        rho = 1 / 3 + square * (1 / 15 + square * (2 / 315 + square * (1 / 2835 + square * (2 / 155925))))
        rho *= -half * half * half
    elif discriminant > 0.0:
        s = math.sqrt(discriminant)
        fading = math.exp(-s * time)
        sigma = 0.5 * (1.0 - fading) / s
        kappa = 0.5 * (1.0 + fading)
        gap = s - slope if slope <= 0.0 else -4.0 * quadratic * speed / (s + slope)
        below = gap * sigma + fading
        rho = (half * fading - sigma * kappa) / (2.0 * discriminant)
    else:
        s = math.sqrt(-discriminant)
        sigma = math.sin(s * half) / s
        kappa = math.cos(s * half)
        below = kappa - slope * sigma
        rho = (half - sigma * kappa) / (2.0 * discriminant)
    inverse = 1.0 / below
    common = 2.0 * speed * inverse * inverse
    return (
        2.0 * speed * sigma * inverse,
        common * rho * -4.0 * speed,
        common * (rho * 2.0 * slope + sigma * sigma),
        2.0 * sigma * inverse + common * rho * -4.0 * quadratic,
    )


@compiled
def _coefficients(values: FloatArray, bridge: float, which: NDArray[np.int64], limited: bool) -> FloatArray:
    """Coefficients of the rate and their derivatives, shape (1 + n, 5).

    Columns are q, f₀, f₁, z₁, z₂ of second = q, first = f₀ + f₁·I, zeroth = z₁·I + z₂·I², where I is the
    current −V/(R + bridge) that the drive alone would send, or the limit while the limiter acts.
    """
    a, r, k, c, sink = values[0], values[1], values[2], values[3], values[4]
    total = r + bridge
    free = 0.0 if limited else 1.0  # the plate feeds back into the current
    gain = a / total * free
    share = 1.0 - r / total * free
    rows = np.zeros((1 + which.size, 5))
    rows[0, 0] = -a * gain * (1.0 - 0.5 * r / total) / c
    rows[0, 1] = -(a * sink * gain + k) / c
    rows[0, 2] = -a * share / c
    rows[0, 3] = -a * sink / c
    rows[0, 4] = 0.5 * r / c
    for p in range(which.size):
        row = rows[1 + p]
        if which[p] == 0:
            row[0] = -2.0 * gain * (1.0 - 0.5 * r / total) / c
            row[1] = -2.0 * sink * gain / c
            row[2] = -share / c
            row[3] = -sink / c
        elif which[p] == 1:  # by R also through the current that the drive sends
            row[0] = a * gain / total * (1.5 - r / total) / c
            row[1] = a * sink * gain / total / c
            row[2] = free * 2.0 * a * share / total / c
            row[3] = free * a * sink / total / c
            row[4] = (0.5 - free * r / total) / c
        elif which[p] == 2:
            row[1] = -1.0 / c
        elif which[p] == 3:
            for i in range(5):
                row[i] = -rows[0, i] / c
        else:
            row[1] = -a * gain / c
            row[3] = -a / c
    return rows


@compiled
def _loop_with_tangents(
    values: FloatArray,
    bridge: float,
    volts_per_count: float,
    limit: float,
    gains: Gains,
    which: NDArray[np.int64],
    reference: FloatArray,
    plate: float,
    integral: float,
    previous_error: float,
    measured: FloatArray,
    weights: FloatArray,
    stored: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The loop; either its arrays are stored, or the normal equations are summed up on the way.

    The last array is [J r]ᵀ[J r] of the weighed residuals r = weights·(measured − simulated).
    """
    size, n = reference.size, which.size
    kept = size if stored else 0
    temperature, pwm = np.empty(kept), np.empty(kept)
    derivative, slopes = np.empty((2, kept, n)), np.empty((kept, 3))
    normal, row = np.zeros((n + 1, n + 1)), np.empty((2, n + 1))
    total = values[1] + bridge
    gain = values[0] / total
    per_gain = 1.0 / gain if gain > 0.0 else 0.0
    sink = values[4]
    resting = _coefficients(values, bridge, which, limited=False)
    limiting = _coefficients(values, bridge, which, limited=True)
    x = plate - sink
    dx, d_integral, d_error, du = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    offset_slope = -volts_per_count / total
    by_sink = np.zeros(n)
    for p in range(n):
        if which[p] == 4:
            by_sink[p] = 1.0
            dx[p] = -1.0
    per_second = gains.derivative / gains.period
    for k in range(size):
        celsius = x + sink - KELVIN
        error = reference[k] - celsius
        wanted = gains.proportional * error + integral + per_second * (error - previous_error)
        u = min(max(wanted, -gains.limit), gains.limit)
        free = 1.0 if abs(wanted) < gains.limit else 0.0
        integral += gains.period * (gains.integral * error + gains.back_calculation * (u - wanted))
        previous_error = error
        for p in range(n):
            d_reading = dx[p] + by_sink[p]
            d_wanted = d_integral[p] - gains.proportional * d_reading - per_second * (d_reading + d_error[p])
            du[p] = free * d_wanted
            d_integral[p] += gains.period * (
                gains.back_calculation * (du[p] - d_wanted) - gains.integral * d_reading
            )
            d_error[p] = -d_reading
            row[0, p] = d_reading
            row[1, p] = du[p]
        if stored:
            temperature[k], pwm[k] = celsius, u
            for p in range(n):
                derivative[0, k, p] = row[0, p]
                derivative[1, k, p] = row[1, p]
        else:
            row[0, n] = celsius - measured[0, k]
            row[1, n] = u - measured[1, k]
            for p in range(n + 1):
                of_y, of_u = weights[0] * row[0, p], weights[1] * row[1, p]
                for q in range(p + 1):
                    normal[p, q] += of_y * row[0, q] + of_u * row[1, q]
        # One tick of the plate. Segments between which the limiter switches; mostly there is one.
        offset = u * offset_slope
        current = gain * x + offset
        regime = 1 if current > limit else (-1 if current < -limit else 0)
        by_plate, by_pwm = 1.0, 0.0
        left = gains.period
        for _ in range(4):
            rows = resting if regime == 0 else limiting
            drive = offset if regime == 0 else regime * limit
            quadratic = rows[0, 0]
            first = rows[0, 1] + rows[0, 2] * drive
            zeroth = drive * (rows[0, 3] + rows[0, 4] * drive)
            slope = 2.0 * quadratic * x + first
            speed = (quadratic * x + first) * x + zeroth
            time, edge, direction = left, x, 0
            way, by_quadratic, by_slope, by_speed = _flow(quadratic, slope, speed, time)
            if speed != 0.0 and gain > 0.0:
                toward = 1 if speed > 0.0 else -1
                threshold = limit if 2 * regime + toward > 0 else -limit
                edge = (threshold - offset) * per_gain
                # x is monotone over the tick: it meets the threshold only if it ends beyond.
                if regime != toward and (way - (edge - x)) * toward > 0.0:
                    direction = toward
                    time = min(riccati_arrival(quadratic, slope, speed, edge - x), left)
                    way, by_quadratic, by_slope, by_speed = _flow(quadratic, slope, speed, time)
            # Derivatives of the segment's end by its start and by the rate's coefficients.
            by_start = 1.0 + 2.0 * quadratic * by_slope + slope * by_speed
            by_second = by_quadratic + x * (2.0 * by_slope + x * by_speed)
            by_first = by_slope + x * by_speed
            of_drive = 0.0
            if regime == 0:
                of_drive = rows[0, 2] * by_first + (rows[0, 3] + 2.0 * rows[0, 4] * drive) * by_speed
            by_command = of_drive * offset_slope
            for p in range(n):
                dx[p] = (
                    by_start * dx[p]
                    + by_command * du[p]
                    + rows[1 + p, 0] * by_second
                    + (rows[1 + p, 1] + rows[1 + p, 2] * drive) * by_first
                    + drive * (rows[1 + p, 3] + rows[1 + p, 4] * drive) * by_speed
                )
            by_pwm = by_start * by_pwm + by_command
            by_plate *= by_start
            if direction == 0:
                x += way
                break
            x = edge
            left -= time
            regime += direction
        if stored:
            slopes[k, 0], slopes[k, 1], slopes[k, 2] = by_plate, by_pwm, free
    for p in range(n + 1):
        for q in range(p):
            normal[q, p] = normal[p, q]
    return temperature, pwm, derivative, slopes, normal


@compiled
def _noise_scores(
    slopes: FloatArray, weighed: FloatArray, weight_y: float, weight_u: float, gains: Gains
) -> tuple[FloatArray, float]:
    """Backwards through the linearised loop, whose state is (plate, integral, previous error).

    `ahead` holds the gradients of the sums by that state one sample on, `power` the quadratic form
    whose value is the sum of the squared residuals that a disturbed state leaves from there on.
    """
    size, n = weighed.shape[1], weighed.shape[2]
    scores = np.empty((size, n))
    ahead = np.zeros((3, n))
    power = np.zeros((3, 3))
    squares = 0.0
    per_second = gains.derivative / gains.period
    a, ways, moved = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for k in range(size - 1, -1, -1):
        by_plate, by_pwm, free = slopes[k]
        # What noise in the reading, and the state, do to the command before the limit.
        by_reading = -gains.proportional - per_second
        wind = gains.period * gains.back_calculation * (free - 1.0)
        for p in range(n):
            by_u = weight_u * weighed[1, k, p] + by_pwm * ahead[0, p]
            by_wanted = free * by_u + wind * ahead[1, p]
            by_y = weight_y * weighed[0, k, p] + by_reading * by_wanted
            by_y -= gains.period * gains.integral * ahead[1, p] + ahead[2, p]
            # The first reading is where the twin starts, so its noise moves both and only the
            # plant's own way from there on differs.
            scores[k, p] = by_y if k > 0 else -by_plate * ahead[0, p]
            ahead[0, p] = by_plate * ahead[0, p] + by_y
            ahead[1, p] += by_wanted
            ahead[2, p] = -per_second * by_wanted
        # The same for the sum of squares: next state = a·state + b·noise, outputs likewise.
        b_u = free * by_reading
        b_x, b_i = by_pwm * b_u, wind * by_reading - gains.period * gains.integral
        c_u0, c_u1, c_u2 = b_u, free, -free * per_second
        if k == 0:
            b_x, b_i, b_e, out_y, out_u = -by_plate, 0.0, 0.0, 0.0, 0.0
        else:
            b_e, out_y, out_u = -1.0, weight_y, weight_u * b_u
        squares += out_y * out_y + out_u * out_u
        squares += power[0, 0] * b_x * b_x + power[1, 1] * b_i * b_i + power[2, 2] * b_e * b_e
        squares += 2.0 * (power[0, 1] * b_x * b_i + power[0, 2] * b_x * b_e + power[1, 2] * b_i * b_e)
        a[0, 0], a[0, 1], a[0, 2] = by_plate + by_pwm * c_u0, by_pwm * c_u1, by_pwm * c_u2
        a[1, 0] = wind * by_reading - gains.period * gains.integral
        a[1, 1], a[1, 2] = 1.0 + wind, -wind * per_second
        a[2, 0], a[2, 1], a[2, 2] = -1.0, 0.0, 0.0
        moved[0], moved[1], moved[2] = c_u0, c_u1, c_u2
        for i in range(3):
            for j in range(3):
                ways[i, j] = power[i, 0] * a[0, j] + power[i, 1] * a[1, j] + power[i, 2] * a[2, j]
        for i in range(3):
            for j in range(3):
                power[i, j] = a[0, i] * ways[0, j] + a[1, i] * ways[1, j] + a[2, i] * ways[2, j]
                power[i, j] += weight_u * weight_u * moved[i] * moved[j]
        power[0, 0] += weight_y * weight_y
    return scores, squares / (2.0 * size)
