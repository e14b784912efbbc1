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

    def __init__(self, deviations: FloatArray) -> None:
        """Start at the typical plant; `deviations` say how much plants of one kind differ, shape (n,)."""
        self.mean: FloatArray = np.zeros(deviations.size)
        self.covariance: FloatArray = np.diag(deviations**2)

    def moves(self, slopes: FloatArray) -> tuple[float, float]:
        """By how much the output differs from the typical plant's, and the standard deviation of that."""
        variance = float(slopes @ self.covariance @ slopes)
        return float(slopes @ self.mean), math.sqrt(max(variance, 0.0))

    def learn(self, slopes: FloatArray, deviation: float, doubt: float) -> None:
        """One step of the Kalman filter: a reading had this `deviation` from the typical plant, give or take
        `doubt`.

        Far from what was expected, a reading counts less.
        """
        covariance = self.covariance
        shown = covariance @ slopes
        innovation = deviation - float(slopes @ self.mean)
        doubt *= max(1.0, abs(innovation) / doubt)
        gain = shown / (float(slopes @ shown) + doubt**2 / PERIOD)
        self.mean = self.mean + gain * innovation
        covariance = covariance - np.outer(gain, shown)
        self.covariance = (covariance + covariance.T) / 2
