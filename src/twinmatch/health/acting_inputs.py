"""The inputs of a plant as they may act now: at once, later or through a lag; and where another drive acts."""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_DELAYS: Final = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0)
"""Delays with which inputs may act, s of a plant as fast as the rig."""
_LAGS: Final = (2.0, 5.0, 10.0)
"""Time constants of the lags through which they may act, s of the same."""


class _Crossing(Rule):
    """How what one drive does arrives where another one acts, in another way than the equations say."""

    lag: float = 30.0
    """Time constant with which it arrives, s: it passes another body first, as the heat of a heater does."""
    usual: float = 120.0
    """Time over which an input is averaged to know what it has been lately, s: longer than a step of a loop
    lasts."""


CROSSING: Final = _Crossing()


class ActingInputs:
    """Follows the inputs of one plant in each way in which they may act."""

    def __init__(self, count: int, swift: float, second: float) -> None:
        """Begin without inputs.

        Args:
            count: number of inputs m.
            swift: samples in a second of a plant as fast as the rig; see `plant_scale`.
            second: the same where times of faster plants are not shorter; see `slow_scale`.
        """
        delays = dict.fromkeys(round(delay * swift) for delay in _DELAYS)
        self._delays = np.array(list(delays))
        """Samples; those of a slow plant that are the same count once."""
        self.latest = int(self._delays.max())
        """Longest delay with which inputs may act, samples."""
        lags = np.array(_LAGS)[:, np.newaxis] * swift
        self._approach = 1.0 - np.exp(-1.0 / lags)
        """Share of its distance from the input that a lag covers in a sample."""
        self.ways = len(self._delays) + len(_LAGS)
        """Number of ways in which inputs may act; the first is at once."""
        self._count = count
        self._second = second
        self.restart()

    def restart(self) -> None:
        """Start over after a gap."""
        self._newest: FloatArray | None = None
        """Inputs of the newest samples, the newest first, shape (latest + 1, m); None before the first."""
        self._lagging = np.zeros((len(_LAGS), self._count))
        self.usual = np.zeros(self._count)
        """What of each input has arrived lately, shape (m,)."""
        self.crossing = np.zeros(self._count)
        """What of each input arrives at the places of the other drives, shape (m,)."""

    def take(self, u: FloatArray, arriving: FloatArray) -> FloatArray:
        """Take the inputs of a sample, and what of them is believed to arrive, each of shape (m,); return those that
        act now in each way, shape (ways, m)."""
        if self._newest is None:
            self._newest = np.tile(u, (self.latest + 1, 1))
            self._lagging[:] = u
            self.usual[:] = arriving
            self.crossing[:] = arriving
        self._newest[1:] = self._newest[:-1].copy()
        self._newest[0] = u
        self._lagging += (u - self._lagging) * self._approach
        passing = max(1.0, CROSSING.lag * self._second)
        self.crossing += (arriving - self.crossing) / passing
        averaged = max(1.0, CROSSING.usual * self._second)
        self.usual += (arriving - self.usual) / averaged
        return np.vstack([self._newest[self._delays], self._lagging])
