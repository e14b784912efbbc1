"""Baselines: what can be forecast without a twin. A twin that does not beat them is of no use.

One says that nothing changes (persistence). The other is an ARX model of second order,

    y[k+1] = y[k] + c₀ + c₁ y[k] + c₂ (y[k] − y[k−1]) + c₃ u[k] + c₄ u[k−1] + Σ c d[k]

(of several outputs, each with those of all signals), fitted by least squares to all samples so far, older
ones weighted less, and simulated ahead with the running controller, or under the given inputs. `twinmatch
backtest` compares with larger models.
"""

# ruff: noqa: PLR0917 (kernels take arrays in a row)

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics import Law
from twinmatch.dynamics.laws import LawCode, law_step
from twinmatch.dynamics.simulation import law_code
from twinmatch.signals import FloatArray, Sample, Signals

Visited = tuple[tuple[float, float], ...]
"""Lowest and highest value of each output."""

_ROWS: Final = 3
"""Samples needed per coefficient."""
_RANK: Final = 1e-12
"""Relative size of a singular value of the normal equations that counts as zero: inputs that never moved."""
_NONE: Final = Sample(-9, 0, 0.0, 0.0, 0.0)
"""Stands before the first sample."""


@compiled
def _simulated(
    coefficients: FloatArray, start: FloatArray, rows: FloatArray, law: LawCode, memory: FloatArray,
    ahead: FloatArray, spans: FloatArray,
) -> FloatArray:  # fmt: skip
    """Outputs and inputs, shape (o + m, N); `start` holds those of now and, below, those before."""
    o, m = len(coefficients), start.shape[1] - len(coefficients)
    found = np.empty((o + m, len(ahead)))
    y, u = start[0, :o].copy(), start[0, o:].copy()
    y_before, u_before = start[1, :o].copy(), start[1, o:].copy()
    z, after = memory.copy(), memory.copy()
    known = np.ones(coefficients.shape[1])
    for k in range(len(ahead)):
        known[1 : 1 + o], known[1 + o : 1 + 2 * o] = y, y - y_before
        known[1 + 2 * o : 1 + 2 * o + m], known[1 + 2 * o + m : 1 + 2 * (o + m)] = u, u_before
        known[1 + 2 * (o + m) :] = rows[k]
        y_before[:], u_before[:] = y, u
        for i in range(o):
            rate = coefficients[i, 0]
            for j in range(1, known.size):
                rate += coefficients[i, j] * known[j]
            y[i] = min(max(y[i] + rate, spans[i, 0]), spans[i, 1])
        law_step(law, z, ahead, k, y, u, after)
        z[:] = after
        found[:o, k], found[o:, k] = y, u
    return found


class ArxForecast(NamedTuple):
    """The ARX model at one sample, ready to forecast; immutable."""

    coefficients: FloatArray
    """Of each output, shape (o, 1 + 2·(o + m) + d); empty before there are enough samples."""
    start: FloatArray
    """Outputs and inputs of now and of the sample before, shape (2, o + m)."""
    spans: FloatArray
    """Limits of each forecast output, shape (o, 2): one width beyond what was visited."""
    law: Law | None
    controller: FloatArray

    def forecast(self, ahead: FloatArray, rows: FloatArray | None) -> FloatArray:
        """Outputs and inputs, shape (o + m, N), under these set-points, or inputs if the loop is not known.

        `ahead` has shape (N,) or (N, r). Until there are coefficients, nothing changes.

        `rows` are the disturbances from the newest sample on, shape (N + 1, d), if there are any.
        """
        if not self.coefficients.size:
            return np.repeat(self.start[0][:, None], len(ahead), axis=1)
        found: FloatArray = _simulated(
            self.coefficients, self.start, np.zeros((len(ahead), 0)) if rows is None else rows,
            *law_code(self.law, self.controller), ahead.reshape(len(ahead), -1), self.spans,
        )  # fmt: skip
        return found


class Arx:
    """The ARX model of one plant, sample by sample."""

    def __init__(self, law: Law | None, kept: float) -> None:
        """Begin without samples; `kept` is the factor on past weights per sample."""
        self._law, self._kept = law, kept
        self._normal, self._count = np.zeros((0, 0)), 0
        self._rows: list[tuple[Signals, ...]] = []  # not yet in the normal equations
        self._before = self._now = _NONE
        self.visited: Visited = ()
        """Lowest and highest value of each output so far."""

    def push(self, sample: Sample) -> None:
        """Take one sample; from one that was lost, or does not follow the last one, nothing is learned."""
        before, now = self._before, self._now
        follows = before.index + 2 == now.index + 1 == sample.index
        if follows and before.seen and now.seen and sample.seen:
            self._rows.append(
                (now.outputs, before.outputs, now.inputs, before.inputs, now.disturbances, sample.outputs)
            )
        seen = self.visited or [(y, y) for y in sample.outputs]
        self.visited = tuple(
            (min(low, y), max(high, y)) for (low, high), y in zip(seen, sample.outputs, strict=True)
        )
        self._before, self._now = now if now.index + 1 == sample.index else sample, sample

    def departure(self, controller: FloatArray) -> ArxForecast:
        """The model at the newest sample, with the controller's state after it."""
        self._learn()
        size, normal = len(self._normal), self._normal
        coefficients = np.zeros(0)
        if self._count >= max(_ROWS * size, 1):
            scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
            right, normal = normal[:, size:] / scale[:, None], normal[:, :size] / np.outer(scale, scale)
            found = np.linalg.lstsq(normal, right, rcond=_RANK)[0] / scale[:, None]
            coefficients = np.ascontiguousarray(found.T)
        start = np.array([(*sample.outputs, *sample.inputs) for sample in (self._now, self._before)])
        spans = np.array([(low - (high - low), high + (high - low)) for low, high in self.visited])
        return ArxForecast(coefficients, start, spans, self._law, controller)

    def _learn(self) -> None:
        if not self._rows:
            return
        now, before, inputs, inputs_before, disturbances, after = map(np.array, zip(*self._rows, strict=True))
        ones, steps = np.ones((len(now), 1)), after - now
        rows = np.hstack([ones, now, now - before, inputs, inputs_before, disturbances, steps])
        size = rows.shape[1] - steps.shape[1]
        ages = np.arange(len(rows))[::-1]
        learned = (rows[:, :size] * (self._kept**ages)[:, None]).T @ rows
        if self._count:
            learned += self._kept ** len(rows) * self._normal
        self._normal, self._count = learned, self._count + len(rows)
        self._rows.clear()
