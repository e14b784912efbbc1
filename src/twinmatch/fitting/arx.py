"""Referees: what can be forecast without a twin. A twin that does not beat them is of no use.

One says that nothing changes (persistence). The other is a vector ARX model, which knows no physics:

    y[k+1] = y[k] + c + Σ (A y[k−i] + B u[k−i] + D d[k−i]) + e[k+1]         i = 0 … p − 1

of all outputs, inputs and measured disturbances, fitted by least squares to all samples so far, older ones
weighted less, and simulated ahead with the running controller, or under the given inputs. The order p is that
of least AICc (Hurvich and Tsai 1989; of several outputs Bedrick and Tsai 1994) up to `MAX_ORDER`.

All orders are fitted at once: columns are ordered by lag, so that every lower order is a leading block of one
triangular factor. That factor is updated, so that the model is fitted live at every forecast.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics import Law
from twinmatch.dynamics.kernels import copy_into
from twinmatch.dynamics.laws import LawCode, law_step
from twinmatch.dynamics.simulation import law_code
from twinmatch.signals import FloatArray, Sample

Visited = tuple[tuple[float, float], ...]
"""Lowest and highest value of each output."""

MAX_ORDER: Final = 10
"""Highest order of the ARX model."""
_BLOCK: Final = 20
"""Samples with which the factor is updated at once."""
_MIN_ROWS: Final = 3
"""Samples needed per coefficient of an output."""
_RANK: Final = 1e-9
"""Relative size of a singular value that counts as zero: inputs that never moved."""
_TINY: Final = float(np.finfo(np.float64).tiny)


@compiled
def simulate_arx(  # noqa: PLR0917
    coefficients: FloatArray,
    level: FloatArray,
    past: FloatArray,
    rows: FloatArray,
    law: LawCode,
    memory: FloatArray,
    ahead: FloatArray,
    spans: FloatArray,
) -> FloatArray:
    """Outputs and inputs, shape (o + m, N); `past` holds outputs, inputs and disturbances, newest first."""
    o = len(coefficients)
    p = len(past)
    size = past.shape[1]
    m = size - o - rows.shape[1]
    simulated = np.empty((o + m, len(ahead)))
    y = past[0, :o].copy()
    u = past[0, o : o + m].copy()
    z = memory.copy()
    after = memory.copy()
    lags = past.copy()
    for lag in range(p):
        for j in range(size):
            lags[lag, j] -= level[j]
    for k in range(len(ahead)):
        for j in range(o + m, size):
            lags[0, j] = rows[k, j - o - m] - level[j]
        for i in range(o):
            rate = coefficients[i, 0]
            for lag in range(p):
                for j in range(size):
                    rate += coefficients[i, 1 + lag * size + j] * lags[lag, j]
            y[i] = min(max(y[i] + rate, spans[i, 0]), spans[i, 1])
        law_step(law, z, ahead, k, y, u, after)
        copy_into(after, z)
        for lag in range(p - 1, 0, -1):
            copy_into(lags[lag - 1], lags[lag])
        for j in range(o + m):
            simulated[j, k] = y[j] if j < o else u[j - o]
            lags[0, j] = simulated[j, k] - level[j]
    return simulated


class ArxForecast(NamedTuple):
    """The ARX model at one sample, ready to forecast; immutable."""

    coefficients: FloatArray
    """Of each output, shape (o, 1 + p·(o + m + d)), lag by lag; empty before there are enough samples."""
    level: FloatArray
    """Values of all signals that the coefficients are relative to, shape (o + m + d,)."""
    past: FloatArray
    """Outputs, inputs and disturbances of the newest p samples, newest first, shape (p, o + m + d); in place
    of outputs that were not read, what the model expected of them."""
    standing: FloatArray
    """Outputs, as they were read last, and newest inputs, shape (o + m,)."""
    spans: FloatArray
    """Limits of each forecast output, shape (o, 2): one width beyond what was visited."""
    law: Law | None
    controller: FloatArray
    """State of the controller after the newest sample."""

    @property
    def order(self) -> int:
        """The order p; 0 before there are enough samples."""
        return len(self.past) if self.coefficients.size else 0

    def referees(self, ahead: FloatArray, rows: FloatArray | None) -> FloatArray:
        """Forecasts of all `BASELINES`, in their order, shape (baselines, o + m, N); see `forecast`."""
        of_arx = self.forecast(ahead, rows)
        of_all = np.empty((2, *of_arx.shape))
        of_all[0] = self.standing[:, None]
        of_all[1] = of_arx
        return of_all

    def forecast(self, ahead: FloatArray, rows: FloatArray | None) -> FloatArray:
        """Outputs and inputs, shape (o + m, N), under these set-points, or inputs if the loop is not known.

        `ahead` has shape (N,) or (N, r). Until there are coefficients, nothing changes.

        `rows` are the disturbances from the newest sample on, shape (N + 1, d), if there are any.
        """
        # Copies: read-only rows would need a kernel of their own.
        disturbances = np.zeros((len(ahead), 0)) if rows is None else np.array(rows)
        if not self.coefficients.size:
            return np.repeat(self.standing[:, None], len(ahead), axis=1)
        means: FloatArray = simulate_arx(
            self.coefficients,
            self.level,
            self.past,
            disturbances,
            *law_code(self.law, self.controller),
            np.array(ahead).reshape(len(ahead), -1),
            self.spans,
        )
        return means


class _Fit(NamedTuple):
    """What an ARX model has learned."""

    factor: FloatArray
    """Triangular factor of [1, lags, step of the outputs], weighted by age."""
    samples: int
    """Number of samples that are in it."""
    weight: float
    """Sum of their weights."""
    level: FloatArray
    """Values of all signals to which the lags are relative; empty before the first sample."""

    def with_rows(self, rows: FloatArray, kept: float) -> _Fit:
        """The fit with further samples, one per row as in `factor`, oldest first.

        `kept` is the factor on past weights per sample.
        """
        count, width = rows.shape
        ages = np.arange(count - 1, -1, -1)
        weights = kept**ages
        weighted_rows = np.sqrt(weights)[:, None] * rows
        factor = self.factor if self.samples else np.zeros((width, width))
        aged_factor = kept ** (count / 2) * factor
        return self._replace(
            factor=np.asarray(
                np.linalg.qr(np.vstack([aged_factor, weighted_rows]), mode="r")
            ),
            samples=self.samples + count,
            weight=kept**count * self.weight + float(weights.sum()),
        )

    def coefficients(self, outputs: int) -> FloatArray:
        """The coefficients of the order with the least AICc, shape (o, 1 + p·(o + m + d)).

        Empty while there are too few samples.
        """
        size = self._best_size(outputs)
        if size == 0:
            return np.zeros((0, 0))
        columns = self.factor[:size, :size]
        targets = self.factor[:size, -outputs:]
        scale = np.maximum(np.linalg.norm(columns, axis=0), _TINY)
        scaled = np.linalg.lstsq(columns / scale, targets, rcond=_RANK)[0]
        return np.ascontiguousarray((scaled / scale[:, None]).T)

    def _best_size(self, outputs: int) -> int:
        """How many coefficients each output has in the order with the least AICc; 0 while there are too few
        samples."""
        sizes = 1 + self.level.size * np.arange(1, MAX_ORDER + 1)
        sizes = sizes[sizes * _MIN_ROWS <= self.weight + 1e-9]
        if not sizes.size:
            return 0
        targets = self.factor[:, -outputs:]
        # Below its first n rows, the factor holds what n coefficients leave of the targets.
        products = targets[:, :, None] * targets[:, None, :]
        left_open = np.cumsum(products[::-1], axis=0)[::-1]
        criteria = _aicc(left_open[sizes] / self.weight, sizes, self.weight)
        return int(sizes[np.argmin(criteria)])


class Arx:
    """The ARX model of one plant, sample by sample."""

    def __init__(self, law: Law | None, kept: float) -> None:
        """Begin without samples; `kept` is the factor on past weights per sample."""
        self._law = law
        self._kept = kept
        self._fit = _Fit(np.zeros((0, 0)), 0, 0.0, np.zeros(0))
        self._newest: list[Sample] = []
        """Consecutive samples: those that are not yet in the factor, behind the `MAX_ORDER` before them."""
        self._learned = 0
        """How many of the `_newest` precede those that are not yet in the factor."""
        self.visited: Visited = ()
        """Lowest and highest value of each output so far."""

    def push(self, sample: Sample) -> None:
        """Take one sample; from one that was lost, or does not follow the last one, nothing is learned."""
        if self._newest and not sample.follows(self._newest[-1]):
            self._fit = self._fit_now()
            self._newest = []
            self._learned = 0
        self._newest.append(sample)
        if sample.seen:
            self.visited = self._visited_with(sample)
        if len(self._newest) - self._learned >= _BLOCK:
            self._fit = self._fit_now()
            if not self._is_whole:
                coefficients = self._fit.coefficients(len(self.visited))
                self._newest = self._without_lost(coefficients, self._fit.level)
            self._newest = self._newest[-MAX_ORDER:]
            self._learned = MAX_ORDER

    def _visited_with(self, sample: Sample) -> Visited:
        if not self.visited:
            return tuple((y, y) for y in sample.outputs)
        spans = zip(self.visited, sample.outputs, strict=True)
        return tuple((min(low, y), max(high, y)) for (low, high), y in spans)

    def departure(self, controller: FloatArray) -> ArxForecast:
        """The model at the newest sample, with the controller's state after it."""
        fit = self._fit_now()
        coefficients = fit.coefficients(len(self.visited))
        newest = (
            self._newest
            if self._is_whole
            else self._without_lost(coefficients, fit.level)
        )
        past = _rows_of(newest)[::-1]
        # After a gap the model waits until it has as many samples as its order.
        order = coefficients.shape[1] // past.shape[1]
        if order > len(past):
            coefficients = np.zeros((0, 0))
            order = 0
        newest_rows = np.ascontiguousarray(past[: max(order, 1)])
        standing = self._standing()
        return ArxForecast(
            coefficients,
            fit.level,
            newest_rows,
            standing,
            self._spans,
            self._law,
            controller,
        )

    @property
    def _spans(self) -> FloatArray:
        """Limits of each forecast output: one width beyond what was visited."""
        return np.array(
            [(low - (high - low), high + (high - low)) for low, high in self.visited]
        )

    @property
    def _is_whole(self) -> bool:
        """Whether all of the newest samples were read."""
        return all(sample.seen for sample in self._newest)

    def _without_lost(
        self, coefficients: FloatArray, level: FloatArray
    ) -> list[Sample]:
        """The newest samples, with the model's own expectation in place of outputs that were not read: what
        stands in for those is the twin's."""
        rows = _rows_of(self._newest)
        order = coefficients.shape[1] // rows.shape[1]
        spans = self._spans
        outputs = len(spans)
        samples = list(self._newest)
        for k, sample in enumerate(self._newest):
            if sample.seen or not 0 < order <= k:
                continue
            lags = (rows[k - order : k][::-1] - level).ravel()
            expected = (
                rows[k - 1, :outputs] + coefficients[:, 0] + coefficients[:, 1:] @ lags
            )
            rows[k, :outputs] = np.clip(expected, spans[:, 0], spans[:, 1])
            samples[k] = replace(sample, outputs=tuple(rows[k, :outputs].tolist()))
        return samples

    def _standing(self) -> FloatArray:
        """Outputs as they were read last, and the newest inputs."""
        newest = self._newest[-1]
        read = next(
            (sample for sample in reversed(self._newest) if sample.seen), newest
        )
        return np.array([*read.outputs, *newest.inputs])

    def _fit_now(self) -> _Fit:
        """The fit with the new samples.

        It is kept after every `_BLOCK` of them and never when a forecast is asked for: the blocks in which a
        factor is updated change its last bits.
        """
        signals = _rows_of(self._newest)
        first = max(self._learned, MAX_ORDER)
        fit = self._fit
        if first >= len(signals):
            return fit
        is_received = np.array([sample.seen for sample in self._newest])
        if not fit.level.size:
            fit = fit._replace(level=signals[int(np.argmax(is_received))])
        places = _with_whole_past(is_received, first)
        if not places.size:
            return fit
        rows = _regression_rows(signals, places, fit.level, outputs=len(self.visited))
        return fit.with_rows(rows, self._kept)


def _aicc(
    covariances: FloatArray, sizes: NDArray[np.int64], samples: float
) -> FloatArray:
    """AICc of models with these covariances of the residuals, shape (n, o, o), and numbers of coefficients of
    each output, shape (n,)."""
    o = covariances.shape[1]
    spread = np.maximum(np.linalg.det(covariances), _TINY)
    estimated = o * sizes + o * (o + 1) / 2
    return np.asarray(
        samples * np.log(spread)
        + 2.0 * estimated * samples / (samples - sizes - o - 1.0)
    )


def _regression_rows(
    signals: FloatArray, places: NDArray[np.int64], level: FloatArray, *, outputs: int
) -> FloatArray:
    """Rows [1, lags relative to the level, step of the outputs] of the samples at these places.

    `signals` have one sample per row, the outputs first; each place has `MAX_ORDER` rows before it.
    """
    places_of_lags = places[:, None] - np.arange(1, MAX_ORDER + 1)
    lags = (signals - level)[places_of_lags].reshape(places.size, -1)
    steps = signals[places, :outputs] - signals[places - 1, :outputs]
    return np.hstack([np.ones((places.size, 1)), lags, steps])


def _with_whole_past(is_received: NDArray[np.bool_], first: int) -> NDArray[np.int64]:
    """Places from `first` on at which a sample and the `MAX_ORDER` before it were received."""
    lost = np.concatenate([[0], np.cumsum(~is_received)])
    places = np.arange(first, is_received.size)
    return np.asarray(places[lost[places + 1] == lost[places - MAX_ORDER]])


def _rows_of(samples: list[Sample]) -> FloatArray:
    """Outputs, inputs and disturbances, one sample per row."""
    return np.array(
        [(*sample.outputs, *sample.inputs, *sample.disturbances) for sample in samples]
    )
