"""Backtests: a twin's forecasts compared with the samples, beside those of simpler methods.

`backtest_session` runs a session through the twin and makes forecasts with all forecasters at every verdict
and every minute; a `Backtest` holds the results. `marks` scores one forecast, `cards` summarise many. The
peers are the referees of the verdict: persistence and ARX, from the same samples as there.
`backtest_outputs` takes plants with several loops, too: one `Backtest` for each output.
"""

from twinmatch.offline.backtest.run import Choices, Listener, backtest, graded, portable
from twinmatch.offline.backtest.scoring import (
    PEERS,
    Backtest,
    BacktestError,
    Card,
    Marked,
    Marks,
    SignalMarks,
    best_in_hindsight,
    cards,
    common,
    document,
    interval_score,
    marks,
    over_all,
)
from twinmatch.offline.backtest.several import backtest_outputs, backtest_session

__all__ = [
    "PEERS",
    "Backtest",
    "BacktestError",
    "Card",
    "Choices",
    "Listener",
    "Marked",
    "Marks",
    "SignalMarks",
    "backtest",
    "backtest_outputs",
    "backtest_session",
    "best_in_hindsight",
    "cards",
    "common",
    "document",
    "graded",
    "interval_score",
    "marks",
    "over_all",
    "portable",
]
