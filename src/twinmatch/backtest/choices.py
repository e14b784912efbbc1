"""What a backtest is to test, and how often."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from twinmatch.backtest.errors import BacktestError
from twinmatch.backtest.peers import PEERS
from twinmatch.backtest.scoring import samples_within
from twinmatch.forecasting import HORIZONS

__all__ = ["Choices"]

_EVERY: Final = 60.0
"""Seconds between two forecasts, if nothing else is asked for."""


@dataclass(frozen=True)
class Choices:
    """What is tested, and how often.

    Raises:
        BacktestError: there is no horizon, or no such peer.
    """

    every: float | None = None
    """Seconds between two forecasts, beside those at every verdict; None: a minute, but at least a sample."""
    horizons: tuple[float, ...] | None = None
    """How far ahead, s; None: `HORIZONS`, without those that are shorter than a sample."""
    peers: tuple[str, ...] = tuple(PEERS)
    """Names of those who are asked beside the twin."""

    def __post_init__(self) -> None:
        if self.horizons == ():
            raise BacktestError("backtest: there is no horizon; give at least one, in seconds")
        unknown = [name for name in self.peers if name not in PEERS]
        if unknown:
            raise BacktestError(f"no peer {unknown[0]!r}; there are {', '.join(PEERS)}")

    def pace(self, period: float) -> float:
        """Seconds between two forecasts, for samples that come every so many seconds."""
        return max(_EVERY, period) if self.every is None else self.every

    def ahead(self, period: float) -> tuple[float, ...]:
        """The horizons from near to far, for samples that come every so many seconds.

        Raises:
            BacktestError: one that was asked for is shorter than a sample.
        """
        if self.horizons is None:
            return tuple(h for h in HORIZONS if h >= period) or (period,)
        for horizon in self.horizons:
            samples_within(horizon, period)
        return tuple(sorted(set(self.horizons)))
