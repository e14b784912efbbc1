"""Forecasts of an ARX model, a simple least-squares alternative to a twin.

The two equations of a sampled loop, plant and controller, each on its past:

    y[k] = a₀ + Σ (a y[k−i] + b u[k−i] + c r[k−i] + h d[k−i]) + e           i = 1 … p
    u[k] = d₀ + f r[k] + g y[k] + Σ (the same of the past) + v

with the measured disturbances d, if there are any.

A drive at its limit violates the controller's equation. Those samples are kept nevertheless: without them the
fit has the least data on steps, and forecasts these worse. All orders up to the highest are fitted at once:
the columns are ordered by lag, so that every lower order is a leading block of one triangular factor.
"""

# ruff: noqa: PLR0912, PLR0917 (a kernel is long and takes arrays in a row)

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import ndtri

from twinmatch.compiled import compiled
from twinmatch.forecasting import Band, Forecast
from twinmatch.offline.backtest.peer import Peer, with_disturbances
from twinmatch.signals import FloatArray, Window

_RIDGE = 1e-4
"""Ridge weight of a coefficient, for residuals in units of the noise: it affects only what the data leave
open, such as the coefficient of a set-point that never moved."""


class Equation(NamedTuple):
    """One of the two equations, at one order p."""

    constant: float
    direct: FloatArray
    """Coefficients of r[k] and y[k]; empty in the plant's equation."""
    past: FloatArray
    """Coefficients of past y, u, in closed loop r, and the disturbances, one row per lag, shape
    (p, signals)."""
    variance: float
    """Variance of the residuals."""
    bic: float
    """Schwarz (1978), up to a constant: N ln V + m ln N with m coefficients."""

    @property
    def radius(self) -> float:
        """Largest absolute root for given inputs; above 1 the forecast diverges."""
        return float(np.abs(np.roots(np.append(1.0, -self.past[:, 0]))).max(initial=0.0))


def equations(
    reference: FloatArray, output: FloatArray, entry: FloatArray, highest: int, *others: FloatArray
) -> list[tuple[Equation, Equation]]:
    """The plant's and the controller's equation at every order from 1 to `highest`.

    Args:
        reference: set-points r, shape (N,), like y in units of the output's noise and relative to a level.
        output: outputs y, shape (N,).
        entry: inputs u, shape (N,), in units of the drive's noise.
        highest: highest order, at least 1 and less than N.
        others: measured disturbances, shape (N,) each, in any unit and relative to a level.
    """
    past = (output, entry, reference, *others)
    y, u, r = (signal[highest:] for signal in (output, entry, reference))
    lags, one = _lags(past, highest), np.ones(y.size)
    found = (
        _nested([one, *lags], y, highest, direct=0, signals=len(past)),
        _nested([one, r, y, *lags], u, highest, direct=2, signals=len(past)),
    )
    return list(zip(*found, strict=True))


def input_equations(
    output: FloatArray, entry: FloatArray, highest: int, *others: FloatArray
) -> list[Equation]:
    """The equation of a plant whose loop is not known: y on the past of y, u and the disturbances; see
    `equations`."""
    past = (output, entry, *others)
    columns = [np.ones(output.size - highest), *_lags(past, highest)]
    return _nested(columns, output[highest:], highest, direct=0, signals=len(past))


def _lags(signals: tuple[FloatArray, ...], highest: int) -> list[FloatArray]:
    """The signals' past, lag by lag, highest · signals columns of shape (N − highest,)."""
    count = signals[0].size - highest
    return [s[highest - lag :][:count] for lag in range(1, highest + 1) for s in signals]


def _nested(
    columns: list[FloatArray], target: FloatArray, highest: int, direct: int, signals: int
) -> list[Equation]:
    count = len(columns)
    held = np.vstack([np.column_stack([*columns, target]), _RIDGE * np.eye(count, count + 1)])
    factor = np.asarray(np.linalg.qr(held, mode="r"), dtype=np.float64)
    samples = max(target.size, 1)
    found = []
    for order in range(1, highest + 1):
        m = 1 + direct + signals * order
        solved = np.asarray(np.linalg.solve(factor[:m, :m], factor[:m, -1]), dtype=np.float64)
        left = float(np.sum(factor[m:, -1] ** 2))
        variance = max(left / samples, _RIDGE**2)
        bic = samples * math.log(variance) + m * math.log(samples)
        constant, now, past = np.split(solved, [1, 1 + direct])
        found.append(Equation(float(constant[0]), now, past.reshape(order, signals), variance, bic))
    return found


MIN_SAMPLES = 60
HIGHEST = 10
PER_ORDER = 15
"""Samples needed per order, so that a short past is not fitted with a high order."""


class _Loop(NamedTuple):
    """Both equations at one order."""

    plant: Equation
    controller: Equation

    @property
    def rows(self) -> FloatArray:
        """Coefficients of y and u on the past of y and u, shape (2, 2p)."""
        y, u = (np.concatenate([e.past[:, 0], e.past[:, 1]]) for e in self)
        return np.array([y, u + self.controller.direct[1] * y])

    @property
    def transition(self) -> FloatArray:
        """Transition matrix of the past of y and u, newest first, shape (2p, 2p)."""
        order = len(self.plant.past)
        matrix = np.eye(2 * order, k=-1)
        matrix[[0, order]] = self.rows
        return matrix

    @property
    def bic(self) -> float:
        """That of both equations."""
        return self.plant.bic + self.controller.bic

    @property
    def radius(self) -> float:
        """Largest absolute eigenvalue; above 1 the forecast diverges."""
        return float(np.max(np.abs(np.linalg.eigvals(self.transition))))


_Model = TypeVar("_Model", Equation, _Loop)


class Arx(Peer):
    """Output and input regressed on the past of both, of the set-point and of the measured disturbances,
    refitted to all samples so far; where the loop is not known, the output alone.

    The order is the one of least BIC among those that are stable. The loop is simulated ahead with the
    future set-points and the drive's limits. The band is Gaussian: the variance of the residuals, propagated
    along the simulated path; the limiter passes the share of a deviation that lies within the limits
    (statistical linearisation).
    """

    name = "ARX"

    def forecast(self, past: Window, ahead: FloatArray, disturbances: FloatArray | None = None) -> Forecast:
        """Forecast one sample for each set-point, or input, ahead; see `Peer`."""
        self._require(past, MIN_SAMPLES)
        noise = np.array([self._plant.output.noise, self._plant.drive.noise])
        level = np.array([past.output.mean(), past.input.mean()])
        output, entry = (past.output - level[0]) / noise[0], (past.input - level[1]) / noise[1]
        others, n = with_disturbances(past, ahead.size, disturbances), len(past)
        highest, measured = min(HIGHEST, n // PER_ORDER), [d[:n] for d in others.T]
        width = ndtri((1.0 + self._confidence) / 2.0)
        if self._driven:
            chosen = _chosen(input_equations(output, entry, highest, *measured))
            given = np.column_stack([np.concatenate([entry, (ahead - level[1]) / noise[1]]), others])
            middle = level[0] + noise[0] * _mean(chosen, output, given, ahead.size)
            reach = width * noise[0] * _spread(chosen, ahead.size)
            band = Band(np.clip(middle, *self._plant.output.span), middle - reach, middle + reach)
            return self._told(past, ahead, band)
        reference = (past.reference - level[0]) / noise[0]
        limits = (np.array(self._plant.drive.limits) - level[1]) / noise[1]
        span = (np.array(self._plant.output.span) - level[0]) / noise[0]
        found = equations(reference, output, entry, highest, *measured)
        mean, spread = _simulated(
            _chosen([_Loop(*pair) for pair in found]),
            (reference, output, entry),
            (ahead - level[0]) / noise[0],
            others,
            (span, limits),
        )
        reach = width * spread
        bands = [
            Band(*(level[j] + noise[j] * x[:, j] for x in (mean, mean - reach, mean + reach)))
            for j in range(2)
        ]
        return self._told(past, ahead, *bands)


def _chosen(found: list[_Model]) -> _Model:
    """The stable model of least BIC; if none is stable, the one that diverges most slowly."""
    stable = (model for model in sorted(found, key=lambda m: m.bic) if model.radius < 1.0)
    return next(stable, None) or min(found, key=lambda m: m.radius)


def _simulated(
    loop: _Loop,
    past: tuple[FloatArray, FloatArray, FloatArray],
    ahead: FloatArray,
    others: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Means and standard deviations of y and u ahead, shape (N, 2) each; u before the limiter.

    `others` are the disturbances of the past and the future samples, one row per sample; `bounds` are the
    output's span and the drive's limits.
    """
    plant, controller = loop
    order, known = len(plant.past), len(others) - ahead.size
    reference, output, entry = (signal[: -order - 1 : -1] for signal in past)
    lags = np.column_stack([output, entry, reference, others[known - order : known][::-1]])  # newest first
    found: tuple[FloatArray, FloatArray] = _run_ahead(
        np.array([[plant.constant, plant.variance], [controller.constant, controller.variance]]),
        controller.direct.copy(), np.stack([plant.past, controller.past]), loop.rows, lags,
        np.column_stack([ahead, others[known:]]), np.stack(bounds),
    )  # fmt: skip
    return found


@compiled
def _run_ahead(
    sizes: FloatArray, direct: FloatArray, past: FloatArray, rows: FloatArray, lags: FloatArray,
    ahead: FloatArray, bounds: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The simulation: `sizes` are constant and variance of each equation, `ahead` the set-points and
    disturbances, one row per sample.

    All but two rows of the transition matrix move the past on by a sample, and the covariance with it.
    """
    order, size, count = lags.shape[0], rows.shape[1], len(ahead)
    means, spreads = np.empty((count, 2)), np.empty((count, 2))
    covariance, after, reach = np.zeros((size, size)), np.zeros((size, size)), np.zeros((2, size))
    of_y, of_u = sizes[0, 1], sizes[1, 1]
    gain, now, square = direct[1], np.empty(2), np.zeros((2, 2))
    for k in range(count):
        now[0], now[1] = sizes[0, 0], sizes[1, 0]
        for of in range(2):
            for i in range(order):
                for j in range(lags.shape[1]):
                    now[of] += past[of, i, j] * lags[i, j]
        y = min(max(now[0], bounds[0, 0]), bounds[0, 1])
        u = now[1] + direct[0] * ahead[k, 0] + gain * y
        for of in range(2):
            for i in range(size):
                reach[of, i] = 0.0
                for j in range(size):
                    reach[of, i] += covariance[i, j] * rows[of, j]
        for of in range(2):
            for other in range(2):
                square[of, other] = 0.0
                for i in range(size):
                    square[of, other] += rows[of, i] * reach[other, i]
        means[k, 0], means[k, 1] = y, u
        spreads[k, 0] = np.sqrt(square[0, 0] + of_y)
        wanted = square[1, 1] + gain**2 * of_y + of_u
        spreads[k, 1] = np.sqrt(wanted)
        above = math.erfc((u - bounds[1, 1]) / spreads[k, 1] * math.sqrt(0.5))
        passed = 0.5 * (above - math.erfc((u - bounds[1, 0]) / spreads[k, 1] * math.sqrt(0.5)))
        for i in range(size):
            for j in range(size):
                if i % order and j % order:
                    after[i, j] = covariance[i - 1, j - 1]
            if i % order:
                after[0, i] = after[i, 0] = reach[0, i - 1]
                after[order, i] = after[i, order] = passed * reach[1, i - 1]
        after[0, 0] = square[0, 0] + of_y
        after[0, order] = after[order, 0] = passed * (square[0, 1] + gain * of_y)
        after[order, order] = passed**2 * wanted
        covariance, after = after, covariance
        for i in range(order - 1, 0, -1):
            for j in range(lags.shape[1]):
                lags[i, j] = lags[i - 1, j]
        lags[0, 0], lags[0, 1] = y, min(max(u, bounds[1, 0]), bounds[1, 1])
        for j in range(ahead.shape[1]):
            lags[0, 2 + j] = ahead[k, j]
    return means, spreads


def _mean(equation: Equation, output: FloatArray, given: FloatArray, count: int) -> FloatArray:
    """The future output, shape (count,); `given` holds past and future inputs and disturbances, shape
    (N + count, 1 + d)."""
    order = len(equation.past)
    held = output[-order:].tolist()
    known = output.size
    for k in range(count):
        others = given[known + k - order : known + k][::-1]
        own = np.array(held[-order:][::-1])
        held.append(
            float(equation.constant + own @ equation.past[:, 0] + np.sum(others * equation.past[:, 1:]))
        )
    return np.array(held[order:], dtype=np.float64)


def _spread(equation: Equation, count: int) -> FloatArray:
    """Standard deviation of the future output, shape (count,)."""
    weights = np.zeros(count)
    for k in range(count):
        newest = weights[max(k - len(equation.past), 0) : k][::-1]
        weights[k] = 1.0 if k == 0 else newest @ equation.past[: newest.size, 0]
    return np.asarray(np.sqrt(equation.variance * np.cumsum(np.square(weights))), dtype=np.float64)
