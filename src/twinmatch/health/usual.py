"""The usual error of a simulated stretch: a part that is always there, and one that grows with movement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

__all__ = ["Usual"]

_MEMORY: Final = (300.0, 600.0)
"""Number of stretches over which the variance at rest and that of the share are averaged."""
_FIRST: Final = (10.0, 100.0)
"""Number of stretches for which the assumed ones count: a hundred that overlap are a few movements."""
_CLIP: Final = 3.0
"""Errors are clipped to so many times the usual one, so that a fault does not pass as usual."""
_FIRST_ERROR: Final = 3.0
"""Assumed error at rest before anything is learned, in standard deviations of a reading's noise …"""
_FIRST_SHARE: Final = 0.3
"""… and share of the movement by which equations with typical parameters are usually wrong."""
_LEAST_SHARE: Final = 0.15
"""That share is never trusted to be smaller: other movements may show other errors."""

_MOVING_SHARE: Final = 0.2
"""Nor larger, while the drive moves the plant: one that is lost is then missing by as much as it moves."""


@dataclass(frozen=True)
class Usual:
    """Variances of the two parts, learned by expectation maximisation, one stretch at a time.

    Equations with a wrong gain or lag err in proportion to how far the plant moves; at rest only the noise
    and the steps of a reading and the estimated states are wrong. One variance for both would be that of the
    last step of the set-point, and hide for minutes what the readings show.
    """

    rest: float
    """Variance at rest, in the output's unit squared."""
    share: float = _FIRST_SHARE**2
    """Variance of the error as a share of the movement."""
    seen: tuple[float, float] = _FIRST
    """Stretches each of them is known from."""

    @classmethod
    def of(cls, noise: float) -> Usual:
        """Before anything is learned, for readings with this noise (1 σ)."""
        return cls((_FIRST_ERROR * noise) ** 2)

    def error(self, moved: float, turned_down: float) -> float:
        """Usual error (1 σ) of a stretch over which the plant moves so far, and so far because the drive was
        turned down."""
        share = max(math.sqrt(self.share), _LEAST_SHARE)
        return math.hypot(math.sqrt(self.rest), min(share, _MOVING_SHARE) * moved, share * turned_down)

    def learned(self, error: float, moved: float) -> Usual:
        """After one more stretch: its error, and how far the equations moved the plant in it."""
        at_rest, moving = self.rest, self.share * moved**2
        total = at_rest + moving
        square = min(error**2, _CLIP**2 * total)
        # The expected squares of both parts, given their sum.
        rest = at_rest * moving / total + (at_rest / total) ** 2 * square
        share = self.share * at_rest / total + (self.share * moved / total) ** 2 * square
        seen = (min(self.seen[0] + 1.0, _MEMORY[0]), min(self.seen[1] + moving / total, _MEMORY[1]))
        return Usual(
            self.rest + (rest - self.rest) / seen[0], self.share + (share - self.share) / seen[1], seen
        )
