"""Backtests: a twin's forecasts compared with the samples, beside those of simpler methods.

`backtest_session` runs a session through the twin and makes forecasts with all forecasters at every verdict
and every minute; a `Backtest` holds the results. `marks` scores one forecast, `cards` summarise many. A
`Peer` forecasts from the same samples and set-points as the twin and nothing else.
"""

from twinmatch.offline.backtest.peer import BacktestError, Peer
from twinmatch.offline.backtest.peers import PEERS, Absent, peers
from twinmatch.offline.backtest.run import Choices, Listener, backtest, backtest_session, graded, portable
from twinmatch.offline.backtest.scoring import (
    Backtest,
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

__all__ = [
    "PEERS",
    "Absent",
    "Backtest",
    "BacktestError",
    "Card",
    "Choices",
    "Listener",
    "Marked",
    "Marks",
    "Peer",
    "SignalMarks",
    "backtest",
    "backtest_session",
    "best_in_hindsight",
    "cards",
    "common",
    "document",
    "graded",
    "interval_score",
    "marks",
    "over_all",
    "peers",
    "portable",
]
