"""Backtests: a twin's forecasts compared with the samples, beside those of simpler methods.

`backtest_session` runs a session through the twin and makes forecasts with all forecasters at every verdict
and every minute; a `Backtest` holds the results. `marks` scores one forecast, `cards` summarise many. The
peers are the referees of the verdict: persistence and ARX, from the same samples as there.
`backtest_outputs` does so for a plant with any number of outputs: one `Backtest` for each.
"""

from twinmatch.offline.backtest.run import (
    Choices,
    Listener,
    backtest,
    backtest_outputs,
    backtest_session,
    graded,
    graded_outputs,
    portable,
)
from twinmatch.offline.backtest.scoring import (
    PEERS,
    Backtest,
    Card,
    Marked,
    cards,
    marks,
)

__all__ = [
    "PEERS",
    "Backtest",
    "Card",
    "Choices",
    "Listener",
    "Marked",
    "backtest",
    "backtest_outputs",
    "backtest_session",
    "cards",
    "graded",
    "graded_outputs",
    "marks",
    "portable",
]
