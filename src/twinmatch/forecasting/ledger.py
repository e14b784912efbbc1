"""What every candidate's forecasts have cost so far, in characters.

The paper's information gain is what a model saves of the characters in which the data are written down, taken
on the data it was fitted to. Here it is taken on data that no model has seen: whoever foretells a reading has
said with what density he expects it, and minus its logarithm to base ten, with as many decimals as the
reading is written with, is the length of the reading in digits, given the forecast (Dawid's prequential
principle, 1984; Rissanen's predictive code, 1986). The density is Laplace's, since the errors of a thermal
camera have long tails; its width is the mean of the errors that this candidate made before, so that each pays
for its own. The trivial code, to which gains are compared, foretells that everything stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["PERSISTENCE", "Ledger"]

PERSISTENCE: Final = ""
"""Under this name errors of the trivial forecast are entered."""
_AT_FIRST: Final = 3.0
"""Forecasts that the noise of the signals stands for, before a candidate has errors of its own."""
_NARROWEST: Final = 0.3
"""Least width, in units of the noise: a run of lucky readings is no promise."""
_COMMON: Final = 5.0
"""Forecasts with which a candidate is taken for an average one of its family."""
_LN10: Final = float(np.log(10.0))


@dataclass(eq=False)
class _Account:
    """Discounted sums of one candidate."""

    lengths: FloatArray
    """Characters by horizon, all signals together, shape (H,)."""
    weights: FloatArray
    """Forecasts they are the sums of, shape (H,)."""
    sizes: FloatArray
    """Mean |error| of each signal, shape (signals, H)."""
    counted: FloatArray
    """Forecasts those means are of, shape (H,)."""

    @property
    def mean(self) -> FloatArray:
        """Characters per forecast by horizon, NaN where none has come, shape (H,)."""
        return np.where(self.weights > 0.0, self.lengths, np.nan) / np.maximum(self.weights, 1e-300)

    def copy(self) -> _Account:
        return _Account(self.lengths.copy(), self.weights.copy(), self.sizes.copy(), self.counted.copy())


@dataclass
class Ledger:
    """Accounts of all candidates; errors go in, gains come out."""

    horizons: int
    """How many horizons H are kept apart."""
    noise: FloatArray
    """Of the signals that are foretold, shape (signals,): output and input, or, where inputs are given, the
    output alone."""
    kept: float
    """Share of the past that is left after one more forecast; below 1, it is forgotten slowly."""
    _accounts: dict[str, _Account] = field(default_factory=dict)

    def keep(self, names: Iterable[str]) -> None:
        """Close the accounts of all others."""
        held = {*names, PERSISTENCE}
        self._accounts = {name: account for name, account in self._accounts.items() if name in held}

    def inherit(self, name: str, predecessor: str) -> None:
        """Give a candidate a copy of another's account, if there is one: whose work it goes on with."""
        if predecessor in self._accounts:
            self._accounts[name] = self._accounts[predecessor].copy()

    def add(self, errors: Mapping[str, FloatArray], horizon: int) -> None:
        """Enter what came minus what was foretold from one sample, of the signals, shape (signals, N).

        The N readings are those up to the horizon and beyond the one before; `horizon` counts from 0. Their
        errors last, so that together they count as one reading of each signal, of mean length.
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
        """Forecasts at all horizons on which a candidate's gain stands, those long ago counting less."""
        return float(self._accounts[name].weights.sum()) if name in self._accounts else 0.0

    def gains(self, names: Sequence[str]) -> FloatArray:
        """Characters saved for each forecast of the signals, by horizon; shape (len(names), H).

        NaN at a horizon of which nothing could be compared with what came.
        """
        trivial = self._accounts.get(PERSISTENCE)
        if trivial is None:
            return np.full((len(names), self.horizons), np.nan)
        accounts = [self._accounts.get(name) or self._opened() for name in names]
        known = np.array([a.mean for a in accounts]).reshape(len(names), self.horizons)
        seen = np.isfinite(known)
        count = np.maximum(seen.sum(axis=0), 1)
        common = np.where(seen.any(axis=0), np.where(seen, known, 0.0).sum(axis=0) / count, trivial.mean)
        rows = [(a.lengths + _COMMON * common) / (a.weights + _COMMON) for a in accounts]
        return np.asarray(trivial.mean - np.array(rows).reshape(len(names), self.horizons))

    def _opened(self) -> _Account:
        none = np.zeros(self.horizons)
        sizes = np.repeat(self.noise[:, None], self.horizons, axis=1)
        return _Account(none, none.copy(), sizes, none + _AT_FIRST)
