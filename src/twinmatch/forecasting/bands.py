"""How wide a band has to be: the twin's own reckoning, scaled by how its forecasts have come true.

A twin knows what its parameters, states and sensor leave open, and propagates that to every sample ahead. It
does not know what its structure gets wrong. So each error is divided by the standard deviation that the
forecast had, and the band is as many standard deviations wide as held 90 % of those quotients before: split
conformal prediction, one lead at a time, in which the past is forgotten slowly (Vovk et al. 2005; weights:
Barber et al. 2023). The first few forecasts of a session could say anything, so that quotients of a normal
distribution are counted in beforehand.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.forecasting.forecast import CONFIDENCE
from twinmatch.signals import FloatArray

__all__ = ["Calibration", "leads_of"]

LEADS: Final = (1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0)
"""Seconds ahead at which quotients are learned; between them the width goes with the logarithm of time."""
_BEFOREHAND: Final = 12
"""Quotients of a normal distribution that are counted in beforehand."""
_FORGOTTEN: Final = 1e-3
"""Weight below which a quotient is let go."""


def leads_of(period: float, longest: int) -> tuple[int, ...]:
    """Samples ahead at which a band is learned, for a sample time (s) and the longest horizon (samples)."""
    found = {min(max(round(lead / period), 1), longest) for lead in LEADS}
    return (*sorted(found | {longest}),)


class Calibration:
    """Quotients |error| / standard deviation of one twin, by lead, and the widths that follow."""

    def __init__(self, leads: tuple[int, ...], kept: float, signals: int = 2) -> None:
        """Begin with nothing learned.

        Args:
            leads: samples ahead at which quotients are learned, shape (L,).
            kept: share of the past that is left after one more forecast.
            signals: how many are foretold: output and input, or, where inputs are given, the output alone.
        """
        self.leads, self.kept, self._signals = leads, kept, np.arange(signals)
        levels = (np.arange(_BEFOREHAND) + 0.5) / _BEFOREHAND
        start = np.repeat(_half_normal(levels)[:, None], signals, axis=1)
        self._quotients = [start] * len(leads)
        self._weights = [np.ones(_BEFOREHAND)] * len(leads)
        self._widths = np.zeros((signals, len(leads)))
        self._stale = set(range(len(leads)))

    def copy(self) -> Calibration:
        """One that learns on by itself."""
        twin = Calibration(self.leads, self.kept, self._signals.size)
        twin._quotients, twin._weights = list(self._quotients), list(self._weights)
        twin._widths, twin._stale = self._widths.copy(), set(self._stale)
        return twin

    def learn(self, quotients: FloatArray, before: int = 0) -> None:
        """Learn from one forecast: quotients of the signals at N samples ahead, shape (signals, N), those at
        leads beyond `before`."""
        for place, lead in enumerate(self.leads):
            if before < lead <= quotients.shape[1]:
                self.add(place, quotients[:, lead - 1])

    def add(self, lead: int, quotients: FloatArray) -> None:
        """Learn from one forecast at one of the leads, counted from 0: quotients of the signals."""
        self._quotients[lead] = np.concatenate([self._quotients[lead], quotients[None]])
        self._weights[lead] = np.append(self._weights[lead] * self.kept, 1.0)
        if self._weights[lead][0] < _FORGOTTEN:
            self._quotients[lead], self._weights[lead] = self._quotients[lead][1:], self._weights[lead][1:]
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
        order = np.argsort(quotients, axis=0, kind="stable")
        # The next forecast counts too, as one that may come out anyhow.
        share = np.cumsum(weights[order], axis=0) / (weights.sum() + 1.0)
        at = np.minimum((share < CONFIDENCE).sum(axis=0), weights.size - 1)
        return np.asarray(quotients[order[at, self._signals], self._signals])


def _half_normal(levels: FloatArray) -> FloatArray:
    """Quantiles of |z|, z standard normal."""
    from scipy.special import ndtri  # noqa: PLC0415 — slow to import

    return np.asarray(ndtri(0.5 + 0.5 * np.asarray(levels)), dtype=np.float64)
