"""Which of the plants beside the typical one this plant is like, and how certain that is."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

PERIOD: Final = 1.0
"""Interval between two comparisons, s."""


class Likeness:
    """The weights of the plants beside the typical one, N(mean, covariance)."""

    def __init__(self, mean: FloatArray) -> None:
        """Start as uncertain as plants of one kind differ."""
        self.mean, self.covariance = mean, np.eye(mean.size)

    def moves(self, slopes: FloatArray) -> tuple[float, float]:
        """By how much the output differs from the typical plant's, and the standard deviation of that."""
        variance = float(slopes @ self.covariance @ slopes)
        return float(slopes @ self.mean), math.sqrt(max(variance, 0.0))

    def learn(self, slopes: FloatArray, off: float, doubt: float) -> None:
        """One step of the Kalman filter: a reading was `off` from the typical plant, give or take `doubt`.

        Far from what was expected, a reading counts less.
        """
        covariance = self.covariance
        shown, off = covariance @ slopes, off - float(slopes @ self.mean)
        doubt *= max(1.0, abs(off) / doubt)
        gain = shown / (float(slopes @ shown) + doubt**2 / PERIOD)
        self.mean = self.mean + gain * off
        covariance = covariance - np.outer(gain, shown)
        self.covariance = (covariance + covariance.T) / 2

    def follow(self, slopes: FloatArray, off: float, share: float) -> None:
        """Take over a share of what the output is off, and become no more certain."""
        shown, off = self.covariance @ slopes, off - float(slopes @ self.mean)
        variance = float(slopes @ shown)
        if variance > 0.0:
            self.mean = self.mean + share * off / variance * shown
