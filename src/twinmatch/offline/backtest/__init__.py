"""Backtests: a twin's forecasts compared with the samples, beside those of simpler methods.

`backtest_session` runs a session through the twin and makes forecasts with all forecasters at every verdict
and every minute; a `Backtest` holds the results. `marks` scores one forecast, `cards` summarise many. A
`Peer` forecasts from the same samples and set-points as the twin and nothing else. `fidelity` aligns a twin's
trace with the plant's, as in the literature.
"""

from twinmatch.offline.backtest.choices import Choices
from twinmatch.offline.backtest.document import document
from twinmatch.offline.backtest.errors import BacktestError
from twinmatch.offline.backtest.fidelity import Fidelity, fidelity
from twinmatch.offline.backtest.figure import draw_backtest
from twinmatch.offline.backtest.peer import Peer
from twinmatch.offline.backtest.peers import PEERS, Absent, peers
from twinmatch.offline.backtest.result import Backtest, over_all
from twinmatch.offline.backtest.run import Listener, backtest, backtest_session, graded
from twinmatch.offline.backtest.scoring import Marks, SignalMarks, interval_score, marks
from twinmatch.offline.backtest.summary import Card, Marked, best_in_hindsight, cards, common
from twinmatch.offline.backtest.table import sentences, tables

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
