"""Width of the bands: the twin's own standard deviations, scaled by its past errors.

A twin propagates the uncertainty of its parameters, states and sensor to every future sample. It does not
know the errors of its structure. So each past error is divided by the standard deviation of its forecast, and
the band is as many standard deviations wide as contained 90 % of these quotients: split conformal prediction,
one lead at a time, with slow forgetting (Vovk et al. 2005; weights: Barber et al. 2023). The first few
forecasts of a session are too few for a quantile, so quotients of a normal distribution are added as a prior.

Where no controller counteracts deviations, a twin may overestimate them several times: a plant follows its
equations more closely than the assumed drift, and nothing shows where its hidden states are. There, the prior
is scaled by the mean of the quotients so far. Forecasts that overlap share most of their errors, so at long
leads they move that mean less.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.forecasting.forecast import CONFIDENCE
from twinmatch.signals import FloatArray

__all__ = ["Calibration", "leads_of"]

LEADS: Final = (1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0)
"""Leads at which quotients are learned, s; between them the width is interpolated over log time."""
_PRIOR: Final = 12
"""Number of prior quotients, from a normal distribution."""
_TRUSTED: Final = 3.0
"""Weight, in forecasts that do not overlap, of the twin's own deviations in the scale of the prior."""
_MEAN: Final = float(np.sqrt(2.0 / np.pi))
"""Mean of |z|, z standard normal."""
_NEGLIGIBLE: Final = 1e-3
"""Weight below which a quotient is dropped."""


def leads_of(period: float, longest: int) -> tuple[int, ...]:
    """Leads at which a band is learned, samples, for a sample time (s) and the longest horizon (samples)."""
    found = {min(max(round(lead / period), 1), longest) for lead in LEADS}
    return (*sorted(found | {longest}),)


class Calibration:
    """Quotients |error| / standard deviation of one twin, by lead, and the widths that follow."""

    def __init__(
        self, leads: tuple[int, ...], kept: float, signals: int = 2, stride: int | None = None
    ) -> None:
        """Begin with the prior only.

        Args:
            leads: leads at which quotients are learned, samples, shape (L,).
            kept: factor on past weights per forecast.
            signals: number of forecast signals: output and input, or only the output if inputs are given.
            stride: samples between two forecasts, if past errors scale the prior; None: it stays as it is.
        """
        self.leads, self.kept, self._signals, self._stride = leads, kept, np.arange(signals), stride
        levels = (np.arange(_PRIOR) + 0.5) / _PRIOR
        start = np.repeat(_half_normal(levels)[:, None], signals, axis=1)
        self._quotients = [start] * len(leads)
        self._weights = [np.ones(_PRIOR)] * len(leads)
        self._priors = [_PRIOR] * len(leads)  # how many of these quotients, the first, are the prior's
        self._sums = np.zeros((signals, len(leads)))  # of the learned quotients, weighted
        self._counts = np.zeros(len(leads))  # sums of their weights
        self._widths = np.zeros((signals, len(leads)))
        self._stale = set(range(len(leads)))

    def copy(self) -> Calibration:
        """An independent copy."""
        twin = Calibration(self.leads, self.kept, self._signals.size, self._stride)
        twin._quotients, twin._weights = list(self._quotients), list(self._weights)
        twin._widths, twin._stale = self._widths.copy(), set(self._stale)
        twin._priors, twin._sums, twin._counts = list(self._priors), self._sums.copy(), self._counts.copy()
        return twin

    def learn(self, quotients: FloatArray, before: int = 0) -> None:
        """Learn from one forecast: quotients of the signals at N samples ahead, shape (signals, N), at leads
        beyond `before`."""
        for place, lead in enumerate(self.leads):
            if before < lead <= quotients.shape[1]:
                self.add(place, quotients[:, lead - 1])

    def add(self, lead: int, quotients: FloatArray) -> None:
        """Learn the signals' quotients of one forecast at one lead, given by its index."""
        self._quotients[lead] = np.concatenate([self._quotients[lead], quotients[None]])
        self._weights[lead] = np.append(self._weights[lead] * self.kept, 1.0)
        if self._weights[lead][0] < _NEGLIGIBLE:
            self._quotients[lead], self._weights[lead] = self._quotients[lead][1:], self._weights[lead][1:]
            self._priors[lead] = max(self._priors[lead] - 1, 0)
        self._sums[:, lead] = self.kept * self._sums[:, lead] + quotients
        self._counts[lead] = self.kept * self._counts[lead] + 1.0
        self._stale.add(lead)

    @property
    def widths(self) -> FloatArray:
        """Half width of a band in standard deviations, at every lead, shape (signals, L)."""
        for lead in self._stale:
            self._widths[:, lead] = self._width(lead)
        self._stale.clear()
        return self._widths.copy()

    def _width(self, lead: int) -> FloatArray:
        quotients, weights = self._quotients[lead], self._weights[lead]
        if self._stride is not None:
            quotients = quotients.copy()
            quotients[: self._priors[lead]] *= self._scale(lead, self._stride)
        order = np.argsort(quotients, axis=0, kind="stable")
        # The next forecast counts as one more, with an unknown quotient.
        share = np.cumsum(weights[order], axis=0) / (weights.sum() + 1.0)
        at = np.minimum((share < CONFIDENCE).sum(axis=0), weights.size - 1)
        return np.asarray(quotients[order[at, self._signals], self._signals])

    def _scale(self, lead: int, stride: int) -> FloatArray:
        """How large errors are, in units of the twin's standard deviations, shape (signals,)."""
        new = min(stride / self.leads[lead], 1.0)  # share of a forecast that the one before did not cover
        found = _TRUSTED * _MEAN + new * self._sums[:, lead]
        return np.asarray(found / (_MEAN * (_TRUSTED + new * self._counts[lead])))


def _half_normal(levels: FloatArray) -> FloatArray:
    """Quantiles of |z|, z standard normal."""
    from scipy.special import ndtri  # noqa: PLC0415 — slow to import

    return np.asarray(ndtri(0.5 + 0.5 * np.asarray(levels)), dtype=np.float64)
