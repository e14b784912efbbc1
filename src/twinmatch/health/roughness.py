"""The noise of a sensor, learned from second differences of its readings, in which slow movements vanish."""

from __future__ import annotations

from typing import Final

_OF_WHITE_NOISE: Final = 1.954
"""Mean size of the second difference of white noise, in its standard deviation."""


class Roughness:
    """Follows the mean size of second differences; one of a step counts as three usual ones at most."""

    def __init__(self, noise: float) -> None:
        """Begin with the noise that the plant file declares, a standard deviation in the output's unit."""
        self._declared = noise
        self._mean = noise * _OF_WHITE_NOISE

    def take(self, size: float) -> None:
        """Take the size of a second difference, in the output's unit."""
        self._mean += (min(size, 3.0 * self._mean) - self._mean) / 100.0

    @property
    def noise(self) -> float:
        """Standard deviation of a reading, between 0.3 and 1.5 times the declared one."""
        return min(
            max(self._mean / _OF_WHITE_NOISE, 0.3 * self._declared),
            1.5 * self._declared,
        )
