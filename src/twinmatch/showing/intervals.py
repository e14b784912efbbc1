"""The uncertainty of a match's parameters."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.fitting import Match

__all__ = ["Interval", "interval", "value_of"]

_NORMAL = 1.959964
"""Standard errors to either side that hold 95 % of a normal distribution."""


class Interval(NamedTuple):
    """A 95 % interval, in the parameter's own unit."""

    low: float
    """Minus infinity where unbounded, NaN where not known."""
    high: float
    error: float
    """Standard error."""
    profile: bool
    """Whether the ends come from the profile likelihood; otherwise they are ±1.96 standard errors."""

    @property
    def known(self) -> bool:
        """Whether there is an interval at all."""
        return not (math.isnan(self.low) or math.isnan(self.high))


def interval(match: Match, name: str) -> Interval:
    """The interval of a free parameter; NaN for one that was not fitted."""
    if name not in match.free:
        return Interval(math.nan, math.nan, math.nan, profile=False)
    place = match.free.index(name)
    error = float(match.standard_errors[place])
    if len(match.intervals) > place:
        low, high = (float(v) for v in match.intervals[place])
        if not (math.isnan(low) or math.isnan(high)):
            return Interval(low, high, error, profile=True)
    value = value_of(match, name)
    return Interval(value - _NORMAL * error, value + _NORMAL * error, error, profile=False)


def value_of(match: Match, name: str) -> float:
    """The value of a fitted parameter, or of a fitted initial state, in its own unit."""
    return float(match.starts[name] if name in match.starts else match.parameters[name])
