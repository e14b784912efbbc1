"""Past errors of forecasts: the width of the bands that follows from them, and their code length.

A twin propagates the uncertainty of its parameters, states and sensor to every future sample. It does not
know the errors of its structure. So each past error is divided by the standard deviation of its forecast, and
the band is as many standard deviations wide as contained 90 % of these quotients: split conformal prediction,
one lead at a time, with slow forgetting (Vovk et al. 2005; weights: Barber et al. 2023). The first few
forecasts of a session are too few for a quantile, so quotients of a normal distribution are added as a prior.

How noisy a sensor is, how far from its equations a plant drifts and how much a twin overestimates both change
faster than a quantile can follow. So quotients are kept in units of their newest mean, and the width that
follows from them is multiplied by it: conformal prediction with a local scale (Lei et al. 2018). Forecasts
that overlap share most of their errors, so at long leads they move that mean less, and it begins with the one
at the next shorter lead, where more is known by then.

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

import math
from collections.abc import Iterable, Sequence
from copy import copy, deepcopy
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.comparing import BASELINES
from twinmatch.comparing.forecast_score import ONE_SIDED
from twinmatch.forecasting.forecast import CONFIDENCE
from twinmatch.signals import FloatArray

LEADS: Final = (1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0)
"""Leads at which quotients are learned, s; between them the width is interpolated over log time."""
_HALF_NORMAL: Final = np.array([
    0.09655861528963908, 0.1940281424239262, 0.29338123212119344, 0.3957252958144873, 0.5024022233733555,
    0.6151411045959737, 0.7363159173761293, 0.8694237732888861, 1.0200762327862014, 1.1983797023069247,
    1.4260768722728474, 1.7688250385187065,
])  # fmt: skip
"""The prior quotients: quantiles of |z|, z standard normal, at levels 1/13, 2/13 … 12/13."""
_TRUSTED: Final = 3.0
"""Weight, in forecasts that do not overlap, of the next shorter lead in the local scale; at the first lead,
of the twin's own deviations."""
_MEAN: Final = float(np.sqrt(2.0 / np.pi))
"""Mean of |z|, z standard normal."""
_NEGLIGIBLE: Final = 1e-3
"""Weight below which a quotient is dropped."""


def leads_of(period: float, longest: int) -> tuple[int, ...]:
    """Leads at which a band is learned, samples, for a sample time (s) and the longest horizon (samples)."""
    leads = {min(max(round(lead / period), 1), longest) for lead in LEADS}
    return (*sorted(leads | {longest}),)


class Calibration:
    """Quotients |error| / standard deviation of one twin, by lead, and the widths that follow."""

    def __init__(
        self,
        leads: tuple[int, ...],
        kept: float,
        recent: float,
        signals: int = 2,
        stride: int = 1,
        *,
        outputs: int = 1,
    ) -> None:
        """Begin with the prior only.

        Args:
            leads: leads at which quotients are learned, samples, shape (L,).
            kept: factor on past weights per forecast.
            recent: the same in the local scale, which follows the newest forecasts.
            signals: number of forecast signals: outputs and inputs, or only the outputs if inputs are given.
            stride: samples between two forecasts.
            outputs: number of outputs among the signals, which come first.
        """
        self._is_output = np.arange(signals) < outputs
        self._outputs = range(min(outputs, signals))
        """Indices of the outputs among the signals."""
        self.leads = leads
        self._kept = kept
        self._recent = recent
        self._uncovered = np.minimum(stride / np.array(leads), 1.0)
        """Share of a forecast that the one before did not cover, shape (L,)."""
        # In units of the local scale, beginning with the prior; those from `_first` to `_end` count.
        self._quotients = np.zeros((len(leads), signals, 2 * _HALF_NORMAL.size))
        self._quotients[:, :, : _HALF_NORMAL.size] = _HALF_NORMAL
        self._first = [0] * len(leads)
        self._end = [_HALF_NORMAL.size] * len(leads)
        self._learned = [0] * len(leads)
        # By age, beginning with the weight of the newest quotient.
        self._weights: list[float] = np.cumprod(
            [1.0, *[kept] * _HALF_NORMAL.size]
        ).tolist()
        # of the newest quotients, weighted
        self._sums = np.zeros((signals, len(leads)))
        self._counts = np.zeros(len(leads))  # sums of their weights
        self._quantiles = np.zeros((signals, len(leads)))
        self._inside = np.zeros((signals, len(leads)))
        """Readings within the band, weighted, of the `_compared` ones."""
        self._compared = np.zeros(len(leads))
        """Readings compared with a band, weighted."""
        self._stale = set(range(len(leads)))
        """Leads whose quantile has to be computed again."""

    def copy(self) -> Calibration:
        """An independent copy."""
        copied = copy(self)
        for name, value in vars(self).items():
            # what else there is never changes; `deepcopy` would look at every number in the lists
            if isinstance(value, np.ndarray | list | set):
                setattr(copied, name, value.copy())
        return copied

    def learn(self, quotients: FloatArray, before: int, widths: FloatArray) -> None:
        """Learn from one forecast, at the leads after `before`.

        Args:
            quotients: those of the signals at N samples ahead, shape (signals, N); NaN where a sample was
                lost.
            before: lead up to which it has been learned from already, samples.
            widths: those that its bands had, shape (signals, L).
        """
        size = quotients.shape[1]
        reached = [k for k, lead in enumerate(self.leads) if before < lead <= size]
        at_reached = quotients[:, [self.leads[k] - 1 for k in reached]]
        is_read = [not math.isnan(quotient) for quotient in at_reached[0].tolist()]
        if all(is_read):
            self._learn_at(reached, at_reached, widths)
            return
        read = [
            k for k, has_reading in zip(reached, is_read, strict=True) if has_reading
        ]
        if read:
            self._learn_at(read, at_reached[:, is_read], widths)

    def _learn_at(
        self, leads: list[int], quotients: FloatArray, widths: FloatArray
    ) -> None:
        """Learn from the quotients at n leads, given by index; shape (signals, n)."""
        places = _places(leads)
        is_inside = quotients <= widths[:, places]
        self._inside[:, places] = self._kept * self._inside[:, places] + is_inside
        self._compared[places] = self._kept * self._compared[places] + 1.0
        self.add(leads, quotients)

    def coverage(
        self, before: int, last: int, signal: int | None = None
    ) -> tuple[float, float]:
        """Share of the readings that the bands have held, and how many forecasts that rests on.

        It is the share at leads after `before` up to `last`, of one `signal` or the least of all. The number
        is effective and of forecasts that do not overlap. Both are NaN without any.
        """
        compared = [
            k
            for k, lead in enumerate(self.leads)
            if before < lead <= last and self._compared[k] > 0.0
        ]
        if not compared:
            return np.nan, np.nan
        places = _places(compared)
        inside = np.add.reduce(self._inside[:, places] / self._compared[places], axis=1)
        shares = (inside / len(compared)).tolist()
        share = min(shares) if signal is None else shares[signal]
        longest = compared[-1]
        return share, float(self._compared[longest] * self._uncovered[longest])

    def add(self, leads: Sequence[int], quotients: FloatArray) -> None:
        """Learn the signals' quotients of one forecast at n leads, given by index; shape (signals, n)."""
        places = _places(leads)
        scaled = quotients / self._scales[:, places]
        for k, lead in enumerate(leads):
            size = self._end[lead] - self._first[lead]
            if self._end[lead] == self._quotients.shape[2]:
                self._make_room(lead)
            self._quotients[lead, :, self._end[lead]] = scaled[:, k]
            self._end[lead] += 1
            self._learned[lead] += 1
            if size == len(self._weights):
                self._weights.append(self._weights[-1] * self._kept)
            # Those of the prior are as old as the first that was learned.
            weight_of_oldest = self._weights[min(size, self._learned[lead])]
            if weight_of_oldest < _NEGLIGIBLE:
                self._first[lead] += 1
        self._sums[:, places] = (
            self._recent * self._sums[:, places] + self._uncovered[places] * quotients
        )
        self._counts[places] = (
            self._recent * self._counts[places] + self._uncovered[places]
        )
        self._stale.update(leads)

    def _make_room(self, lead: int) -> None:
        """Move the quotients that count to the front, or double the room if they fill more than half."""
        first = self._first[lead]
        end = self._end[lead]
        if 2 * (end - first) > end:
            self._quotients = np.concatenate(
                [self._quotients, np.zeros_like(self._quotients)], axis=2
            )
            return
        self._quotients[lead, :, : end - first] = self._quotients[lead, :, first:end]
        self._first[lead] = 0
        self._end[lead] = end - first

    @property
    def widths(self) -> FloatArray:
        """Half width of a band in standard deviations, at every lead, shape (signals, L)."""
        if self._stale:
            # Leads up to the same horizon have learned as much.
            leads_by_history: dict[tuple[int, int, int], list[int]] = {}
            for lead in sorted(self._stale):
                history = self._first[lead], self._end[lead], self._learned[lead]
                leads_by_history.setdefault(history, []).append(lead)
            weights_by_age = np.array(self._weights)
            for (first, end, learned), leads in leads_by_history.items():
                ages = np.arange(end - first - 1, -1, -1)
                # Those of the prior are as old as the first that was learned.
                weights = weights_by_age[np.minimum(ages, learned)]
                places = _places(leads)
                self._quantiles[:, places] = self._quantiles_of(
                    self._quotients[places, :, first:end], places, weights
                )
            self._stale.clear()
        return self._quantiles * self._scales

    @property
    def _scales(self) -> FloatArray:
        """How large errors are now, in units of the twin's standard deviations, shape (signals, L).

        A lead with few forecasts of an output takes it from the next shorter one; the first lead then takes
        the deviations as they are, a scale of 1. Inputs always take 1: what a controller commands errs at
        short leads as a reading does, at long ones as a level, so one lead says nothing of the next.
        """
        shares = _TRUSTED / (_TRUSTED + self._counts)
        of_errors = self._sums / (_MEAN * (_TRUSTED + self._counts))
        scales = shares + of_errors
        for signal in self._outputs:
            scale = 1.0
            scales_of_output = []
            for share, of_error in zip(
                shares.tolist(), of_errors[signal].tolist(), strict=True
            ):
                scale = share * scale + of_error
                scales_of_output.append(scale)
            scales[signal] = scales_of_output
        return scales

    def _quantiles_of(
        self, quotients: FloatArray, places: slice | list[int], weights: FloatArray
    ) -> FloatArray:
        """The quantiles, shape (signals, n), of quotients, shape (n, signals, N), at n leads, with weights,
        shape (N,)."""
        # The next forecast counts as one more, with an unknown quotient: at long leads as more than one,
        # since it shares less with those before than they do with each other.
        of_outputs = self._uncovered[places] ** -0.5
        weight_of_next = np.where(self._is_output, of_outputs[:, None], 1.0)
        weight_of_all = np.add.reduce(weights)
        order = quotients.argsort(axis=2, kind="stable")
        cumulated = weights[order].cumsum(axis=2)
        share = cumulated / (weight_of_all + weight_of_next)[:, :, None]
        # As shares rise, this is the first place at which the share reaches the confidence.
        rank = np.add.reduce(share < CONFIDENCE, axis=2, keepdims=True)
        rank = np.minimum(rank, len(weights) - 1)
        chosen = np.take_along_axis(order, rank, axis=2)
        return np.take_along_axis(quotients, chosen, axis=2)[:, :, 0].T


def _places(leads: Sequence[int]) -> slice | list[int]:
    """Ascending indices as a slice, by which arrays are read and written in a third of the time, if none is
    left out between them."""
    if leads and leads[-1] - leads[0] == len(leads) - 1:
        return slice(leads[0], leads[-1] + 1)
    return list(leads)


_LN10: Final = float(np.log(10.0))
_LENGTH, _WEIGHT, _COUNTED, _MEANS = range(4)
"""Columns of an account at a horizon.

`_LENGTH`: characters of all signals together. `_WEIGHT`: effective number of forecasts in that sum.
`_COUNTED`: the same in the means, with the prior. From `_MEANS` on: the means themselves; see `Ledger`."""


@dataclass(frozen=True, slots=True)
class _Accounts:
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


_ACCOUNTS: Final = _Accounts()


class Ledger:
    """The accounts of all candidates: takes errors, returns gains."""

    def __init__(self, new: FloatArray, noise: FloatArray, kept: float) -> None:
        """Begin without accounts.

        Args:
            new: share of a forecast that the one before did not cover, at each horizon, shape (H,).
            noise: noise of the forecast signals, shape (signals,): outputs and inputs, or only the outputs if
                inputs are given.
            kept: factor on past weights per forecast; below 1, the past is forgotten slowly.
        """
        self.horizons = new.size
        self.noise = noise
        self.kept = kept
        self._uncovered = new
        sizes = np.tile(noise, 1 + len(BASELINES))
        squares = np.ones(len(BASELINES) * (1 + noise.size))
        self._sizes = slice(_MEANS, _MEANS + sizes.size)
        """Columns of the mean |error| of each signal, and of those of the baselines on the same samples."""
        self._squares = slice(_MEANS + sizes.size, None)
        """Columns, one for each baseline and then for each baseline and signal, of the mean square of the
        difference of both errors, relative to their means; before there is one it counts as large as the
        errors, 1. The first are those of the mean over the signals."""
        self._new_account = np.concatenate(
            [[0.0, 0.0, _ACCOUNTS.prior], sizes, squares]
        )
        """A new account at a horizon: see `_LENGTH` and those after it."""
        self._rows: dict[str | int, int] = {}
        """Row of each candidate by name, and of each baseline by its place among `BASELINES`."""
        self._accounts = self._new_account[None, None]
        self._set(())

    def _set(self, sources: Iterable[tuple[str | int, str | int]]) -> None:
        """Keep only the accounts with these names, and an empty one in the last row.

        Each begins as a copy of the account of its source or, if that is missing, as a new one.
        """
        new = np.tile(self._new_account, (self.horizons, 1))
        accounts = {}
        for name, source in sources:
            accounts[name] = (
                self._accounts[self._rows[source]] if source in self._rows else new
            )
        self._accounts = np.array([*accounts.values(), new])
        self._rows = {name: row for row, name in enumerate(accounts)}

    def copy(self) -> Ledger:
        """An independent copy."""
        return deepcopy(self)

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
        account[:, _LENGTH] = self.kept * account[:, _LENGTH] + self._characters(
            account, means
        )
        account[:, _WEIGHT] = self.kept * account[:, _WEIGHT] + 1.0
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
        before = self.kept * account[:, _COUNTED, None]
        counted = before + 1.0
        account[:, _COUNTED] = counted[:, 0]
        sizes_beside = np.empty((len(means), self.noise.size * (1 + len(BASELINES))))
        sizes_beside[:, : self.noise.size] = means
        sizes_beside[:, self.noise.size :] = means[: len(BASELINES)].ravel()
        account[:, self._sizes] = (
            before * account[:, self._sizes] + sizes_beside
        ) / counted
        squares = _squared_differences(sizes_beside / account[:, self._sizes])
        account[:, self._squares] = (
            before * account[:, self._squares] + squares
        ) / counted

    def _characters(self, account: FloatArray, means: FloatArray) -> FloatArray:
        """Length of the readings with these mean errors, shape (accounts, signals), in characters, each given
        a Laplace density of the mean error so far; shape (accounts,)."""
        mean_errors = account[:, _MEANS : _MEANS + self.noise.size]
        widths = np.maximum(mean_errors, _ACCOUNTS.narrowest * self.noise)
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
        count = len(BASELINES)
        accounts = self._accounts_of(names)
        sizes = accounts[:, :, self._sizes]
        sizes_by_source = sizes.reshape(*sizes.shape[:2], 1 + count, self.noise.size)
        ratios = np.log(sizes_by_source[:, :, :1] / sizes_by_source[:, :, 1:])
        squares = accounts[:, :, self._squares]
        if signal is None:
            ratios = ratios.mean(axis=3)
            squares = squares[:, :, :count]
        else:
            ratios = ratios[:, :, :, signal]
            squares = squares[:, :, count + signal :: self.noise.size]
        compared = accounts[:, :, _COUNTED] * self._uncovered
        errors = np.sqrt(squares / compared[:, :, None])
        has_enough = accounts[:, :, _WEIGHT, None] >= _ACCOUNTS.compared
        skills = np.where(has_enough, 1.0 - np.exp(ratios), np.nan)
        highs = np.where(has_enough, 1.0 - np.exp(ratios - ONE_SIDED * errors), np.nan)
        return skills.swapaxes(1, 2), highs.swapaxes(1, 2)

    def _accounts_of(self, names: Sequence[str]) -> FloatArray:
        """The accounts of candidates, shape (C, H, columns); an empty one where there is none."""
        return np.asarray(self._accounts[[self._rows.get(name, -1) for name in names]])

    def forecasts(self, name: str) -> float:
        """Effective number of a candidate's scored forecasts at all horizons, older ones weighted less."""
        return (
            float(self._accounts[self._rows[name], :, _WEIGHT].sum())
            if name in self._rows
            else 0.0
        )

    def gains(self, names: Sequence[str]) -> FloatArray:
        """Characters saved per forecast of the signals, by horizon; shape (len(names), H).

        NaN at a horizon at which no forecast could be compared yet.
        """
        if 0 not in self._rows:
            return np.full((len(names), self.horizons), np.nan)
        accounts = self._accounts_of(names)
        lengths = accounts[:, :, _LENGTH]
        weights = accounts[:, :, _WEIGHT]
        first, counts = self._accounts[self._rows[0], :, :_COUNTED].T
        trivial = np.where(counts > 0.0, first, np.nan) / np.maximum(counts, 1e-300)
        return np.asarray(
            (weights * trivial - lengths) / (weights + _ACCOUNTS.shrinkage)
        )


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
