"""Backtests that several tests read; each session goes through the twin once."""

from __future__ import annotations

import pytest

from tests.support.places import SHIPPED
from twinmatch.offline.backtest.run import backtest_session
from twinmatch.offline.backtest.scoring import Backtest


@pytest.fixture(scope="session")
def shipped() -> Backtest:
    """The sample session, with everybody asked who is installed."""
    return backtest_session(SHIPPED)
