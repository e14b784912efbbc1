"""The choices of a backtest: horizons, interval and peers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from twinmatch.forecasting import horizons_for
from twinmatch.offline.backtest.errors import BacktestError
from twinmatch.offline.backtest.peers import PEERS
from twinmatch.offline.backtest.scoring import samples_within

__all__ = ["Choices"]

_EVERY: Final = 60.0
"""Default time between two forecasts, s."""


@dataclass(frozen=True)
class Choices:
    """Horizons, interval and peers of a backtest.

    Raises:
        BacktestError: there is no horizon, or no such peer.
    """

    every: float | None = None
    """Time between two forecasts, s, besides those at every verdict; None: a minute, at least a sample."""
    horizons: tuple[float, ...] | None = None
    """Horizons, s; None: those at which the twin's forecasts are scored."""
    peers: tuple[str, ...] = tuple(PEERS)
    """Names of the peers."""

    def __post_init__(self) -> None:
        if self.horizons == ():
            raise BacktestError("backtest: there is no horizon; give at least one, in seconds")
        unknown = [name for name in self.peers if name not in PEERS]
        if unknown:
            raise BacktestError(f"backtest: no peer {unknown[0]!r}; choose from {', '.join(PEERS)}")

    def pace(self, period: float) -> float:
        """Time between two forecasts, s, for this sample time, s."""
        return max(_EVERY, period) if self.every is None else self.every

    def ahead(self, period: float) -> tuple[float, ...]:
        """The horizons from near to far, for this sample time, s.

        Raises:
            BacktestError: a requested horizon is shorter than a sample.
        """
        if self.horizons is None:
            return horizons_for(period)
        for horizon in self.horizons:
            samples_within(horizon, period)
        return tuple(sorted(set(self.horizons)))
