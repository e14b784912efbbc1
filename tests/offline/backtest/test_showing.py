"""Report cards as tables, sentences, JSON and a picture say the same figures, as does the command."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from tests.offline.backtest.forecasts import linear_loop, set_points
from tests.support.places import SHIPPED
from tests.support.processes import run_twinmatch
from twinmatch.cli.backtest import PEERS as OFFERED
from twinmatch.offline.backtest.peers import PEERS, Absent, peers
from twinmatch.offline.backtest.run import ask, mark, origins, regular
from twinmatch.offline.backtest.scoring import (
    HINDSIGHT,
    LEADER,
    Backtest,
    Marked,
    Marks,
    SignalMarks,
    document,
    over_all,
)
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of, write_session
from twinmatch.showing.figures.drawing import save
from twinmatch.showing.figures.forecasts import draw_backtest
from twinmatch.showing.forecasts import backtest_tables, backtest_words, card_columns
from twinmatch.signals import Window

HORIZONS = (10.0, 60.0)


@pytest.fixture(scope="module")
def tested() -> Backtest:
    """Ten minutes of a loop, forecast by those who need no twin."""
    loop = linear_loop(set_points(600, 21), np.random.default_rng(22))
    marked, shown = [], []
    for origin in origins([loop], regular([loop], 60.0), HORIZONS):
        for peer in peers(Peltier, ["persistence", "arx"])[0]:
            forecast = ask(peer, origin)
            if forecast is not None:
                marked += mark("loop", peer.name, forecast, origin, horizons=HORIZONS, plant=Peltier)
                shown.append(forecast)
    return Backtest(
        name="loop",
        plant=Peltier,
        period=1.0,
        horizons=HORIZONS,
        confidence=0.9,
        marked=tuple(marked),
        came=(loop,),
        shown=tuple(shown[1::2]),
        absent=(Absent("somebody", "is not here"),),
        notes=("a note",),
    )


def one(who: str, error: float, horizon: float = 60.0) -> Marked:
    signal = SignalMarks(rms=error, end=error, coverage=0.93, width=4.0, score=5.0)
    return Marked("a", 1, horizon, who, Marks(signal, signal))


def test_the_table_has_everybody_at_every_horizon(tested: Backtest) -> None:
    found = backtest_tables(tested)
    assert [table.title for table in found] == [
        "loop: 10 s ahead, 9 forecasts",
        "loop: 60 s ahead, 9 forecasts",
    ]
    console = Console(width=180, record=True, file=io.StringIO())
    for table in found:
        console.print(table)
    text = console.export_text()
    assert text.count("persistence") == text.count("ARX") == 2
    for card in tested.cards:
        assert all(name in text and cell(card) in text for name, cell in card_columns(Peltier))


def test_cells_are_in_the_units_of_the_plant() -> None:
    (card,) = Backtest("a", Peltier, 1.0, (60.0,), 0.9, (one("ARX", 2.0),)).cards
    said = {name: text(card) for name, text in card_columns(Peltier)}
    assert said["error"] == "2.00"
    assert (said["end / °C"], said["end / PWM"]) == ("0.20", "14.0")
    assert (said["width / °C"], said["width / PWM"]) == ("0.40", "28.0")
    assert (said["held °C"], said["held PWM"]) == ("93 %", "93 %")
    assert said["× best"] == "–"


def test_the_sentence_says_how_the_leader_did() -> None:
    marked = (one(LEADER, 2.0), one("ARX", 5.0), one("persistence", 9.0))
    assert backtest_words(Backtest("a", Peltier, 1.0, (10.0, 60.0), 0.9, marked)) == [
        "60 s ahead, the leader's temperature was off by less than 0.20 °C half of the time, and its band "
        "held 93 % of the readings (90 % expected); ARX, the best of the peers, had 2.5 times the error."
    ]
    worse = Backtest("a", Peltier, 1.0, (60.0,), 0.9, (one(LEADER, 2.0), one("ARX", 1.0)))
    assert "had a smaller error, 0.50 times as large." in backtest_words(worse)[0]


def test_json_holds_cards_and_every_forecast(tested: Backtest) -> None:
    text = json.dumps(document(tested), allow_nan=False)
    read = json.loads(text)
    assert (read["name"], read["plant"], read["origins"]) == ("loop", "peltier", 9)
    assert read["noise"] == {"output": 0.1, "input": 7.0}
    assert len(read["forecasts"]) == len(tested.marked) == 36
    assert read["absent"] == [{"name": "somebody", "reason": "is not here"}]
    errors = [f["error"] for f in read["forecasts"] if (f["who"], f["horizon"]) == ("ARX", 60.0)]
    card = next(c for c in read["cards"] if (c["who"], c["horizon"]) == ("ARX", 60.0))
    assert card["median"] == pytest.approx(np.median(errors))
    assert card["ratio"] is None
    assert set(read["forecasts"][0]["output"]) == {"rms", "end", "coverage", "width", "score"}
    assert "forecasts" not in document(tested, forecasts=False)


def test_several_sessions_are_one(tested: Backtest) -> None:
    total = over_all([tested, tested])
    assert total.name == "all 2 sessions"
    assert [c.count for c in total.cards] == [2 * c.count for c in tested.cards]
    assert [c.median for c in total.cards] == [c.median for c in tested.cards]
    assert total.absent == tested.absent
    assert total.notes == ("loop: a note", "loop: a note")


def test_sessions_of_one_name_are_not_mixed_up() -> None:
    """The best in hindsight of each stays its own: ratios of 2 and 4, and not of 2 and 2."""
    first, second = (
        Backtest("a", Peltier, 1.0, (60.0,), 0.9, (one(LEADER, 4.0), one(HINDSIGHT, best)))
        for best in (2.0, 1.0)
    )
    (card, _) = over_all([first, second]).cards
    assert (card.who, card.ratio) == (LEADER, 3.0)


def test_the_picture_shows_errors_coverage_and_forecasts(tested: Backtest, tmp_path: Path) -> None:
    figure = draw_backtest(tested)
    save(figure, tmp_path / "card.png")
    assert (tmp_path / "card.png").stat().st_size > 30_000
    errors, held, output, left, entry = figure.axes
    medians = {line.get_label(): line.get_ydata() for line in errors.get_lines()}
    for who in ("persistence", "ARX"):
        own = [c.median for c in tested.cards if c.who == who]
        np.testing.assert_array_equal(np.asarray(medians[who]), own)
    assert [t.get_text() for t in held.get_xticklabels()] == ["10 s ahead", "60 s ahead"]
    assert len(output.collections) == len(left.collections) == len(entry.collections) == len(tested.shown)


def test_without_a_forecast_the_picture_says_so() -> None:
    figure = draw_backtest(Backtest("a", Peltier, 1.0, HORIZONS, 0.9, ()))
    assert "no forecast could be judged" in [t.get_text() for t in figure.axes[0].texts]


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
