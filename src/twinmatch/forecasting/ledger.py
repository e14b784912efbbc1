"""What the forecasts of candidates have cost, and how much better they were than those of the baselines.

The paper's information gain is the number of characters that a model saves when writing the data to which
it was fitted. Here it is computed on data that no model has seen: a forecast gives a probability density for
a reading, and minus the density's logarithm to base ten, for the decimals with which readings are written, is
the length of the reading in digits, given the forecast (Dawid's prequential principle, 1984; Rissanen's
predictive code, 1986). The density is Laplace's, because the errors of a thermal camera have long tails; its
width is the mean of this candidate's previous errors. The trivial code, the reference for gains, is
the first baseline: no change.

Who leads a family need not be of use. So each candidate's errors are also compared with those that the
baselines made on the same samples: its skill is 1 − (its mean |error|) / (the baseline's), as in meteorology
(Murphy 1988), positive where the twin adds something. How certain that is follows from the differences of
both errors, forecast by forecast, since most of what makes one large makes the other large (Diebold and
Mariano 1995); of forecasts that overlap, only the part that the one before did not cover counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from typing import Final

import numpy as np

from twinmatch.comparing import BASELINES
from twinmatch.comparing.forecast_score import ONE_SIDED
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_LN10: Final = float(np.log(10.0))


class _FewForecasts(Rule):
    """How candidates with few forecasts are judged.

    Their first errors count beside the noise of the sensor, as if three forecasts had erred by it. A few
    small errors may be chance, so no density is narrower than a third of that noise. And a new candidate has
    saved nothing yet: its gain is shrunk to zero.
    """

    prior: float = 3.0
    """Weight of the noise as prior mean error of a candidate, in forecasts."""
    narrowest: float = 0.3
    """Least width, in units of the noise."""
    shrinkage: float = 5.0
    """Weight, in forecasts, with which a gain is shrunk to zero."""
    compared: float = 4.0
    """Effective number of forecasts from which on skill is computed."""


_FEW_FORECASTS: Final = _FewForecasts()


class _Columns:
    """Where the figures of an account at a horizon are: the last axis of an array of accounts."""

    LENGTH: Final = 0
    """Characters of all signals together."""
    WEIGHT: Final = 1
    """Effective number of forecasts in that sum."""
    COUNTED: Final = 2
    """The same in the means, with the prior."""

    def __init__(self, noise: FloatArray) -> None:
        """Lay out the means of signals with this noise, shape (signals,)."""
        begin = self.COUNTED + 1
        self._signals = noise.size
        self._baselines = len(BASELINES)
        sizes = np.tile(noise, 1 + self._baselines)
        squares = np.ones(self._baselines * (1 + self._signals))
        self.own_sizes = slice(begin, begin + self._signals)
        """Mean |error| of each signal."""
        self.sizes = slice(begin, begin + sizes.size)
        """The same, and behind it that of each baseline on the same samples."""
        self.squares = slice(begin + sizes.size, None)
        """Mean square of the difference of the errors from those of a baseline, relative to their means: of the
        mean over the signals, beside each baseline, and then of each signal, beside each."""
        self.of_new = np.concatenate([[0.0, 0.0, _FEW_FORECASTS.prior], sizes, squares])
        """A new account. Before there is a difference it counts as large as the errors, 1."""

    def sizes_by_source(self, accounts: FloatArray) -> FloatArray:
        """The `sizes` of accounts, shape (C, H, columns): own, then of each baseline; (C, H, sources, signals)."""
        sizes = accounts[:, :, self.sizes]
        return sizes.reshape(*sizes.shape[:2], 1 + self._baselines, self._signals)

    def squares_of_mean(self, accounts: FloatArray) -> FloatArray:
        """The `squares` of accounts of the mean over the signals, shape (C, H, baselines)."""
        squares: FloatArray = accounts[:, :, self.squares]
        return squares[:, :, : self._baselines]

    def squares_of_signal(self, accounts: FloatArray, signal: int) -> FloatArray:
        """The `squares` of accounts of one signal, shape (C, H, baselines)."""
        squares: FloatArray = accounts[:, :, self.squares]
        return squares[:, :, self._baselines + signal :: self._signals]


class Ledger:
    """The accounts of all candidates: takes errors, returns gains."""

    def __init__(self, uncovered: FloatArray, noise: FloatArray, kept: float) -> None:
        """Begin without accounts.

        Args:
            uncovered: share of a forecast that the one before did not cover, at each horizon, shape (H,).
            noise: noise of the forecast signals, shape (signals,): outputs and inputs, or only the outputs if
                inputs are given.
            kept: factor on past weights per forecast; below 1, the past is forgotten slowly.
        """
        self.horizons = uncovered.size
        self.noise = noise
        self.kept = kept
        self._uncovered = uncovered
        self._columns = _Columns(noise)
        self._rows: dict[str | int, int] = {}
        """Row of each candidate by name, and of each baseline by its place among `BASELINES`."""
        self._accounts = self._columns.of_new[None, None]
        self._set(())

    def _set(self, sources: Iterable[tuple[str | int, str | int]]) -> None:
        """Keep only the accounts with these names, and an empty one in the last row.

        Each begins as a copy of the account of its source or, if that is missing, as a new one.
        """
        new = np.tile(self._columns.of_new, (self.horizons, 1))
        accounts = {}
        for name, source in sources:
            accounts[name] = (
                self._accounts[self._rows[source]] if source in self._rows else new
            )
        self._accounts = np.array([*accounts.values(), new])
        self._rows = {name: row for row, name in enumerate(accounts)}

    def copy(self) -> Ledger:
        """An independent copy."""
        copied = copy(self)
        copied._accounts = self._accounts.copy()  # all else is replaced, not changed
        return copied

    def keep(self, names: Iterable[str]) -> None:
        """Keep only the accounts of these candidates."""
        self._set(
            (name, name)
            for name in (*range(len(BASELINES)), *names)
            if name in self._rows
        )

    def inherit(self, name: str, predecessor: str) -> None:
        """Give a candidate a copy of its predecessor's account, if there is one."""
        if predecessor in self._rows:
            standing = [(candidate, candidate) for candidate in self._rows]
            self._set([*standing, (name, predecessor)])

    def add(
        self,
        names: Sequence[str],
        errors: FloatArray,
        baselines: FloatArray,
        horizon: int,
    ) -> None:
        """Add the errors (measured minus forecast) of the forecasts from one sample.

        They are those of the candidates, shape (C, signals, N), and those of `BASELINES`, in that order.

        The N readings are those after the previous horizon up to this one; `horizon` is an index. Their
        errors are correlated, so together they count as one reading of each signal, of mean length.
        """
        rows = self._rows_of((*range(len(BASELINES)), *names))
        sizes = np.abs(np.concatenate([baselines, errors]))
        by_reading = np.ascontiguousarray(sizes.swapaxes(1, 2))
        # As `np.mean`, to the bit, without the checks that take most of its time.
        means = np.add.reduce(by_reading, axis=1) / by_reading.shape[1]
        account = self._accounts[rows, horizon]
        length = self._columns.LENGTH
        weight = self._columns.WEIGHT
        characters = self._characters(account, means)
        account[:, length] = self.kept * account[:, length] + characters
        account[:, weight] = self.kept * account[:, weight] + 1.0
        self._average_sizes(account, means)
        self._accounts[rows, horizon] = account

    def _rows_of(self, accounts: Sequence[int | str]) -> list[int]:
        """Where these accounts are; those that are missing are opened."""
        if not self._rows.keys() >= {*accounts}:
            self._set((name, name) for name in (*self._rows, *accounts))
        return [self._rows[name] for name in accounts]

    def _average_sizes(self, account: FloatArray, means: FloatArray) -> None:
        """Take mean errors, shape (accounts, signals), and those of all baselines beside them.

        Their sizes go into the running averages, and how much they differ into those of the squares.
        """
        columns = self._columns
        before = self.kept * account[:, columns.COUNTED, None]
        counted = before + 1.0
        account[:, columns.COUNTED] = counted[:, 0]
        signals = self.noise.size
        sizes = np.empty((len(means), signals * (1 + len(BASELINES))))
        sizes[:, :signals] = means
        sizes[:, signals:] = means[: len(BASELINES)].ravel()
        mean_sizes = (before * account[:, columns.sizes] + sizes) / counted
        account[:, columns.sizes] = mean_sizes
        squares = _squared_differences(sizes / mean_sizes)
        mean_squares = (before * account[:, columns.squares] + squares) / counted
        account[:, columns.squares] = mean_squares

    def _characters(self, account: FloatArray, means: FloatArray) -> FloatArray:
        """Length of the readings with these mean errors, shape (accounts, signals), in characters, each given
        a Laplace density of the mean error so far; shape (accounts,)."""
        mean_errors = account[:, self._columns.own_sizes]
        widths = np.maximum(mean_errors, _FEW_FORECASTS.narrowest * self.noise)
        characters = np.log10(2.0 * widths) + means / (widths * _LN10)
        return np.asarray(characters.sum(axis=1))

    def skills(
        self, names: Sequence[str], signal: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Skills of candidates at each horizon beside each of `BASELINES`, and the upper ends of their
        one-sided 95 % intervals, shape (C, baselines, H) each.

        Of all signals it is the geometric mean of the ratios that counts. NaN where too few forecasts
        were compared.
        """
        columns = self._columns
        accounts = self._accounts_of(names)
        sizes = columns.sizes_by_source(accounts)
        log_ratios_by_signal = np.log(sizes[:, :, :1] / sizes[:, :, 1:])
        if signal is None:
            log_ratios = log_ratios_by_signal.mean(axis=3)
            squares = columns.squares_of_mean(accounts)
        else:
            log_ratios = log_ratios_by_signal[:, :, :, signal]
            squares = columns.squares_of_signal(accounts, signal)
        independent = accounts[:, :, columns.COUNTED] * self._uncovered
        standard_errors = np.sqrt(squares / independent[:, :, None])
        log_lows = log_ratios - ONE_SIDED * standard_errors
        has_enough = accounts[:, :, columns.WEIGHT, None] >= _FEW_FORECASTS.compared
        skills = np.where(has_enough, 1.0 - np.exp(log_ratios), np.nan)
        highs = np.where(has_enough, 1.0 - np.exp(log_lows), np.nan)
        return skills.swapaxes(1, 2), highs.swapaxes(1, 2)

    def _accounts_of(self, names: Sequence[str]) -> FloatArray:
        """The accounts of candidates, shape (C, H, columns); an empty one where there is none."""
        return np.asarray(self._accounts[[self._rows.get(name, -1) for name in names]])

    def forecasts(self, name: str) -> float:
        """Effective number of a candidate's scored forecasts at all horizons, older ones weighted less."""
        if name not in self._rows:
            return 0.0
        return float(self._accounts[self._rows[name], :, self._columns.WEIGHT].sum())

    def gains(self, names: Sequence[str]) -> FloatArray:
        """Characters saved per forecast of the signals, by horizon; shape (len(names), H).

        NaN at a horizon at which no forecast could be compared yet.
        """
        if 0 not in self._rows:
            return np.full((len(names), self.horizons), np.nan)
        accounts = self._accounts_of(names)
        lengths = accounts[:, :, self._columns.LENGTH]
        weights = accounts[:, :, self._columns.WEIGHT]
        of_persistence = self._accounts[self._rows[0]]
        persistence_length = of_persistence[:, self._columns.LENGTH]
        persistence_weight = of_persistence[:, self._columns.WEIGHT]
        trivial = np.where(persistence_weight > 0.0, persistence_length, np.nan)
        trivial_mean = trivial / np.maximum(persistence_weight, 1e-300)
        saved = weights * trivial_mean - lengths
        return np.asarray(saved / (weights + _FEW_FORECASTS.shrinkage))


def _squared_differences(relative: FloatArray) -> FloatArray:
    """Square of the difference of errors from those of each baseline, both relative to their means.

    From rows of the candidate's errors and then those of every baseline, each of all signals: the mean over
    the signals beside each baseline, and then each signal beside each.
    """
    by_source = relative.reshape(len(relative), 1 + len(BASELINES), -1)
    differences = by_source[:, :1] - by_source[:, 1:]
    # As `np.mean`, to the bit; see `Ledger.add`.
    of_all = np.add.reduce(differences, axis=2) / differences.shape[2]
    of_each = differences.reshape(len(relative), -1)
    return np.asarray(np.square(np.hstack([of_all, of_each])))
