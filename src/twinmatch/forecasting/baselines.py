"""Baselines: what can be forecast without a twin. A twin that does not beat them is of no use.

One says that nothing changes (persistence). The other is an ARX model of second order,

    y[k+1] = y[k] + c₀ + c₁ y[k] + c₂ (y[k] − y[k−1]) + c₃ u[k] + c₄ u[k−1] + Σ c d[k],

fitted by least squares to all samples so far, older ones weighted less, and simulated ahead with the running
controller, or under the given inputs. `twinmatch backtest` compares with larger models.
"""

# ruff: noqa: PLR0917 (kernels take arrays in a row)

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics import Law
from twinmatch.dynamics.laws import LawCode, law_step
from twinmatch.dynamics.simulation import law_of
from twinmatch.signals import FloatArray, Sample

_ROWS: Final = 3
"""Samples needed per coefficient."""
_RANK: Final = 1e-12
"""Relative size of a singular value of the normal equations that counts as zero: inputs that never moved."""
_NONE: Final = Sample(-9, 0, 0.0, 0.0, 0.0)
"""Stands before the first sample."""


@compiled
def _simulated(
    coefficients: FloatArray, start: FloatArray, rows: FloatArray, law: LawCode, memory: FloatArray,
    ahead: FloatArray, low: float, high: float,
) -> FloatArray:  # fmt: skip
    """Outputs and inputs, shape (2, N); `start` holds y, y before, u, u before."""
    found = np.empty((2, ahead.size))
    y, y_before, u, u_before = start
    z, after, signals = memory.copy(), memory.copy(), np.empty((3, 1))
    for k in range(ahead.size):
        c = coefficients
        rate = c[0] + c[1] * y + c[2] * (y - y_before) + c[3] * u + c[4] * u_before
        for j in range(rows.shape[1]):
            rate += c[5 + j] * rows[k, j]
        y_before, u_before = y, u
        y = min(max(y + rate, low), high)
        signals[0, 0], signals[1, 0] = ahead[k], y
        law_step(law, z, signals, 0, signals[1], signals[2], after)
        z[:], u = after, signals[2, 0]
        found[0, k], found[1, k] = y, u
    return found


class ArxForecast(NamedTuple):
    """The ARX model at one sample, ready to forecast; immutable."""

    coefficients: FloatArray
    """Shape (5 + d,); empty until there are enough samples: then it says that nothing changes."""
    start: FloatArray
    """y, y before, u and u before, shape (4,)."""
    span: tuple[float, float]
    """Limits of the forecast output: one width beyond what was visited."""
    gains: Law | None
    controller: FloatArray

    def forecast(self, ahead: FloatArray, rows: FloatArray | None) -> FloatArray:
        """Output and input under these set-points, or inputs if the loop is not known, shape (2, N).

        `rows` are the disturbances from the newest sample on, shape (N + 1, d), if there are any.
        """
        if not self.coefficients.size:
            return np.repeat(self.start[[0, 2], None], ahead.size, axis=1)
        found: FloatArray = _simulated(
            self.coefficients, self.start, np.zeros((ahead.size, 0)) if rows is None else rows,
            *law_of(self.gains, self.controller), ahead, *self.span,
        )  # fmt: skip
        return found


class Arx:
    """The ARX model of one plant, sample by sample."""

    def __init__(self, gains: Law | None, kept: float) -> None:
        """Begin without samples; `kept` is the factor on past weights per sample."""
        self._gains, self._kept = gains, kept
        self._normal, self._count = np.zeros((0, 0)), 0
        self._rows: list[tuple[float, ...]] = []  # not yet in the normal equations
        self._before = self._now = _NONE
        self._low, self._high = math.inf, -math.inf

    def push(self, sample: Sample) -> None:
        """Take one sample; from one that was lost, or does not follow the last one, nothing is learned."""
        before, now = self._before, self._now
        follows = before.index + 2 == now.index + 1 == sample.index
        if follows and before.seen and now.seen and sample.seen:
            self._rows.append((
                1.0, now.output, now.output - before.output, now.input, before.input, *now.disturbances,
                sample.output - now.output,
            ))  # fmt: skip
        self._low, self._high = min(self._low, sample.output), max(self._high, sample.output)
        self._before, self._now = now if now.index + 1 == sample.index else sample, sample

    def departure(self, controller: FloatArray) -> ArxForecast:
        """The model at the newest sample, with the controller's state after it."""
        self._learn()
        size, normal = len(self._normal), self._normal
        coefficients = np.zeros(0)
        if self._count >= max(_ROWS * size, 1):
            scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
            right, normal = normal[:, -1] / scale, normal[:, :-1] / np.outer(scale, scale)
            coefficients = np.linalg.lstsq(normal, right, rcond=_RANK)[0] / scale
        room = self._high - self._low
        start = np.array([self._now.output, self._before.output, self._now.input, self._before.input])
        return ArxForecast(
            coefficients, start, (self._low - room, self._high + room), self._gains, controller
        )

    def _learn(self) -> None:
        if not self._rows:
            return
        rows = np.array(self._rows)
        ages = np.arange(len(rows))[::-1]
        learned = (rows[:, :-1] * (self._kept**ages)[:, None]).T @ rows
        if self._count:
            learned += self._kept ** len(rows) * self._normal
        self._normal, self._count = learned, self._count + len(rows)
        self._rows.clear()
