"""Backtests that several tests read; each session goes through the twin once."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.support.places import SHIPPED
from tests.support.processes import run_twinmatch
from twinmatch.cli import backtest
from twinmatch.offline.backtest.scoring import Backtest


class Command(NamedTuple):
    """`twinmatch backtest` of the sample session, with everybody asked who is installed."""

    done: subprocess.CompletedProcess[str]
    json: Path
    figure: Path
    tested: Backtest


@pytest.fixture(scope="session")
def command(tmp_path_factory: pytest.TempPathFactory) -> Command:
    """What it says and writes, and what it was made from."""
    folder = tmp_path_factory.mktemp("card")
    backtests = []
    session = backtest.backtest_outputs

    def keeping_all(*given: Any, **options: Any) -> tuple[Backtest, ...]:
        backtests.extend(session(*given, **options))
        return tuple(backtests[-1:])

    out = folder / "card.json"
    picture = folder / "card.png"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backtest, "backtest_outputs", keeping_all)
        process = run_twinmatch("backtest", SHIPPED, "--json", out, "--figure", picture)
    assert process.returncode == 0, process.stderr
    return Command(process, out, picture, backtests[0])


@pytest.fixture(scope="session")
def shipped(command: Command) -> Backtest:
    """The forecasts of the sample session."""
    return command.tested
