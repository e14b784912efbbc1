"""Between which levels the twin's forecasts have come true."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.discrimination import Verdict

__all__ = ["TrustRange", "trust_range"]


class TrustRange(NamedTuple):
    """Lowest and highest output."""

    low: float
    high: float
    unit: str = "°C"

    def __str__(self) -> str:
        """Whole numbers, rounded to the inside."""
        return f"{math.ceil(self.low)} and {math.floor(self.high)} {self.unit}".rstrip()


def trust_range(verdict: Verdict, unit: str) -> TrustRange | None:
    """Where forecasts held up to a verdict; None if they never did."""
    if math.isnan(verdict.held_low):
        return None
    return TrustRange(verdict.held_low, verdict.held_high, unit)
