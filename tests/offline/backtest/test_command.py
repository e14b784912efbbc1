"""`twinmatch backtest` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.places import SHIPPED
from tests.support.processes import run_twinmatch
from twinmatch.cli.backtest import PEERS as OFFERED
from twinmatch.offline.backtest.peers import PEERS
from twinmatch.offline.backtest.result import Backtest, document
from twinmatch.sessions import samples_of, write_session
from twinmatch.signals import Window


@pytest.fixture
def still(tmp_path: Path) -> Path:
    """Three minutes in which nothing happens."""
    level = np.full(180, 30.0)
    return write_session(tmp_path / "still", samples_of(Window(level, level, level)))


def test_the_shipped_session_has_its_report_card(tmp_path: Path, shipped: Backtest) -> None:
    out, picture = tmp_path / "card.json", tmp_path / "card.png"
    done = run_twinmatch("backtest", SHIPPED, "--json", out, "--figure", picture)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "four_setpoints: 300 s ahead" in done.stdout
    assert "best in hindsight" in done.stdout
    assert "300 s ahead, the leader's temperature was off by less than" in done.stdout
    assert picture.stat().st_size > 50_000
    written = json.loads(out.read_text())
    assert written["sessions"] == [json.loads(json.dumps(document(shipped)))]
    assert written["total"]["cards"] == written["sessions"][0]["cards"]


def test_horizons_pace_and_peers_can_be_chosen(still: Path, tmp_path: Path) -> None:
    out = tmp_path / "card.json"
    done = run_twinmatch("backtest", still, "--every", "20", "--horizon", "30", "5", "--peers", "--json", out)
    assert done.returncode == 0, done.stderr
    written = json.loads(out.read_text())["total"]
    assert written["horizons"] == [5.0, 30.0]
    assert written["cards"] == []
    assert "there was no candidate yet" in done.stdout


def test_a_session_that_cannot_be_used_is_skipped(still: Path, tmp_path: Path) -> None:
    done = run_twinmatch("backtest", still, tmp_path / "absent.mat", "--peers", "persistence")
    assert done.returncode == 3
    assert len(done.stderr.strip().splitlines()) == 1
    assert "skipped" in done.stderr
    assert "absent.mat" in done.stderr


def test_the_command_offers_every_peer() -> None:
    """It names them itself, since importing them is slow."""
    assert tuple(PEERS) == OFFERED
