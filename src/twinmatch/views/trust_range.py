"""Between which levels the twin's forecasts have come true."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.discrimination import Verdict
from twinmatch.dynamics import Output

__all__ = ["TrustRange", "trust_range"]


class TrustRange(NamedTuple):
    """Lowest and highest output."""

    low: float
    high: float
    unit: str
    decimals: int = 0
    """Places to which the ends are rounded."""

    def __str__(self) -> str:
        """Both ends, rounded to the inside."""
        steps = 10.0**self.decimals
        low, high = math.ceil(self.low * steps) / steps, math.floor(self.high * steps) / steps
        if low > high:  # there is nothing between them but what rounding would take away
            low, high = self.low, self.high
        return f"{low:.{self.decimals}f} and {high:.{self.decimals}f} {self.unit}".rstrip()


def trust_range(verdict: Verdict, output: Output) -> TrustRange | None:
    """Where forecasts held up to a verdict, a place coarser than readings; None if they never did."""
    if math.isnan(verdict.held_low):
        return None
    return TrustRange(verdict.held_low, verdict.held_high, output.unit, max(0, output.decimals - 1))
