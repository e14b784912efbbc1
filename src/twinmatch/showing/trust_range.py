"""The range of the output in which the twin's forecasts have held."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Output

__all__ = ["TrustRange", "trust_range"]


class TrustRange(NamedTuple):
    """Lowest and highest output."""

    low: float
    high: float
    unit: str
    decimals: int = 0
    """Decimal places to which the ends are rounded."""

    def __str__(self) -> str:
        """Both ends, rounded inwards."""
        steps = 10.0**self.decimals
        low, high = math.ceil(self.low * steps) / steps, math.floor(self.high * steps) / steps
        if low > high:  # the range is narrower than the rounding
            low, high = self.low, self.high
        return f"{low:.{self.decimals}f} and {high:.{self.decimals}f} {self.unit}".rstrip()


def trust_range(verdict: Verdict, output: Output) -> TrustRange | None:
    """The range in which forecasts have held, one decimal place coarser than the output; None if none has."""
    if math.isnan(verdict.held_low):
        return None
    return TrustRange(verdict.held_low, verdict.held_high, output.unit, max(0, output.decimals - 1))
