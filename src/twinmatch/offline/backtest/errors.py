"""The error of this package."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["BacktestError"]


class BacktestError(TwinmatchError):
    """A backtest that cannot be made: samples that do not fit a forecast, or an unknown peer."""
