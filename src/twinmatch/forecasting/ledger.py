"""Code length of every candidate's forecasts so far, in characters.

The paper's information gain is the number of characters that a model saves when writing the data to which
it was fitted. Here it is computed on data that no model has seen: a forecast gives a probability density for
a reading, and minus the density's logarithm to base ten, for the decimals with which readings are written, is
the length of the reading in digits, given the forecast (Dawid's prequential principle, 1984; Rissanen's
predictive code, 1986). The density is Laplace's, because the errors of a thermal camera have long tails; its
width is the mean of this candidate's previous errors. The trivial code, the reference for gains, is a
forecast of no change.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["PERSISTENCE", "Ledger"]

PERSISTENCE: Final = ""
"""Name under which errors of the trivial forecast are entered."""
_PRIOR: Final = 3.0
"""Weight of the noise as prior mean error of a candidate, in forecasts."""
_NARROWEST: Final = 0.3
"""Least width, in units of the noise: a few small errors may be chance."""
_SHRINKAGE: Final = 5.0
"""Weight, in forecasts, with which a candidate's mean is shrunk to that of its family."""
_LN10: Final = float(np.log(10.0))


@dataclass(eq=False)
class _Account:
    """Discounted sums of one candidate."""

    lengths: FloatArray
    """Characters by horizon, all signals together, shape (H,)."""
    weights: FloatArray
    """Effective number of forecasts in these sums, shape (H,)."""
    sizes: FloatArray
    """Mean |error| of each signal, shape (signals, H)."""
    counted: FloatArray
    """Effective number of forecasts in these means, shape (H,)."""

    @property
    def mean(self) -> FloatArray:
        """Characters per forecast by horizon, NaN without a forecast, shape (H,)."""
        return np.where(self.weights > 0.0, self.lengths, np.nan) / np.maximum(self.weights, 1e-300)

    def copy(self) -> _Account:
        return _Account(self.lengths.copy(), self.weights.copy(), self.sizes.copy(), self.counted.copy())


@dataclass
class Ledger:
    """The accounts of all candidates: takes errors, returns gains."""

    horizons: int
    """Number of horizons H."""
    noise: FloatArray
    """Noise of the forecast signals, shape (signals,): output and input, or only the output if inputs are
    given."""
    kept: float
    """Factor on past weights per forecast; below 1, the past is forgotten slowly."""
    _accounts: dict[str, _Account] = field(default_factory=dict)

    def keep(self, names: Iterable[str]) -> None:
        """Keep only the accounts of these candidates."""
        held = {*names, PERSISTENCE}
        self._accounts = {name: account for name, account in self._accounts.items() if name in held}

    def inherit(self, name: str, predecessor: str) -> None:
        """Give a candidate a copy of its predecessor's account, if there is one."""
        if predecessor in self._accounts:
            self._accounts[name] = self._accounts[predecessor].copy()

    def add(self, errors: Mapping[str, FloatArray], horizon: int) -> None:
        """Add the errors (measured minus forecast) of the forecasts from one sample, shape (signals, N).

        The N readings are those after the previous horizon up to this one; `horizon` is an index. Their
        errors are correlated, so together they count as one reading of each signal, of mean length.
        """
        h = horizon
        for name, error in errors.items():
            account = self._accounts.setdefault(name, self._opened())
            sizes = np.abs(error).mean(axis=1)
            widths = np.maximum(account.sizes[:, h], _NARROWEST * self.noise)
            characters = np.log10(2.0 * widths) + sizes / (widths * _LN10)
            account.lengths[h] = self.kept * account.lengths[h] + characters.sum()
            account.weights[h] = self.kept * account.weights[h] + 1.0
            before = self.kept * account.counted[h]
            account.counted[h] = before + 1.0
            account.sizes[:, h] = (before * account.sizes[:, h] + sizes) / account.counted[h]

    def forecasts(self, name: str) -> float:
        """Effective number of a candidate's scored forecasts at all horizons, older ones weighted less."""
        return float(self._accounts[name].weights.sum()) if name in self._accounts else 0.0

    def gains(self, names: Sequence[str]) -> FloatArray:
        """Characters saved per forecast of the signals, by horizon; shape (len(names), H).

        NaN at a horizon at which no forecast could be compared yet.
        """
        trivial = self._accounts.get(PERSISTENCE)
        if trivial is None:
            return np.full((len(names), self.horizons), np.nan)
        accounts = [self._accounts.get(name) or self._opened() for name in names]
        known = np.array([a.mean for a in accounts]).reshape(len(names), self.horizons)
        seen = np.isfinite(known)
        count = np.maximum(seen.sum(axis=0), 1)
        common = np.where(seen.any(axis=0), np.where(seen, known, 0.0).sum(axis=0) / count, trivial.mean)
        rows = [(a.lengths + _SHRINKAGE * common) / (a.weights + _SHRINKAGE) for a in accounts]
        return np.asarray(trivial.mean - np.array(rows).reshape(len(names), self.horizons))

    def _opened(self) -> _Account:
        none = np.zeros(self.horizons)
        sizes = np.repeat(self.noise[:, None], self.horizons, axis=1)
        return _Account(none, none.copy(), sizes, none + _PRIOR)
