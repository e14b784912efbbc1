"""Backtests: a twin's forecasts compared with the samples, beside those of simpler methods.

`backtest_session` runs a session through the twin and makes forecasts with all forecasters at every verdict
and every minute; a `Backtest` holds the results. `marks` scores one forecast, `cards` summarise many. A
`Peer` forecasts from the same samples and set-points as the twin and nothing else. `fidelity` aligns a twin's
trace with the plant's, as in the literature.
"""

from twinmatch.backtest.choices import Choices
from twinmatch.backtest.document import document
from twinmatch.backtest.errors import BacktestError
from twinmatch.backtest.fidelity import Fidelity, fidelity
from twinmatch.backtest.figure import draw_backtest
from twinmatch.backtest.peer import Peer
from twinmatch.backtest.peers import PEERS, Absent, peers
from twinmatch.backtest.result import Backtest, over_all
from twinmatch.backtest.run import Listener, backtest, backtest_session, graded
from twinmatch.backtest.scoring import Marks, SignalMarks, interval_score, marks
from twinmatch.backtest.summary import Card, Marked, best_in_hindsight, cards, common
from twinmatch.backtest.table import sentences, tables

__all__ = [
    "PEERS",
    "Absent",
    "Backtest",
    "BacktestError",
    "Card",
    "Choices",
    "Fidelity",
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
    "draw_backtest",
    "fidelity",
    "graded",
    "interval_score",
    "marks",
    "over_all",
    "peers",
    "sentences",
    "tables",
]
