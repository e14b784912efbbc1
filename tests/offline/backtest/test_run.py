"""The twin's own forecasts: what they may know, who is who, and that they are worth having."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.offline.backtest.forecasts import linear_loop, set_points
from tests.support.places import SHIPPED
from tests.support.plants import Motor
from tests.support.processes import run_twinmatch
from tests.support.steps import drive_lost
from tests.support.verdicts import verdict
from twinmatch.cli.shared import PEERS as OFFERED
from twinmatch.comparing import TrustLevel
from twinmatch.dynamics import Sensor, begin, simulate_closed_loop
from twinmatch.forecasting import Arx
from twinmatch.importing import open_any
from twinmatch.offline.backtest import (
    Choices,
    Listener,
    backtest,
    backtest_session,
    graded,
)
from twinmatch.offline.backtest.origins import NamedForecast, ask, origins, scores
from twinmatch.offline.backtest.scoring import (
    CONSTANT,
    HINDSIGHT,
    LEADER,
    NEWEST,
    NOMINAL,
    PEERS,
    TWINS,
    Backtest,
    BacktestError,
    Card,
    Marked,
    Marks,
    SignalMarks,
    document,
    over_all,
)
from twinmatch.offline.judging import judge_samples, terms_from_files
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of, write_session
from twinmatch.showing.console import Console
from twinmatch.showing.figures.drawing import save
from twinmatch.showing.figures.forecasts import draw_backtest
from twinmatch.showing.forecasts import backtest_tables, backtest_words, card_columns
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings

TWIN_ONLY = Choices(every=120.0, peers=())


def card(tested: Backtest, forecaster: str, horizon: float) -> Card:
    return next(c for c in tested.cards if (c.who, c.horizon) == (forecaster, horizon))


def test_everybody_is_judged_from_the_same_origins(shipped: Backtest) -> None:
    assert [c.who for c in shipped.cards][::3][:5] == [
        LEADER,
        NOMINAL,
        NEWEST,
        CONSTANT,
        HINDSIGHT,
    ]
    for horizon in shipped.horizons:
        cards_there = [c for c in shipped.cards if c.horizon == horizon]
        assert len({c.count for c in cards_there}) == 1
        assert cards_there[0].count >= 30


def test_the_leader_is_near_the_best_and_beats_everybody_without_a_twin(
    shipped: Backtest,
) -> None:
    """The rig is of a structure that competes, seen through noise of 1: the leader errs by little more."""
    for horizon in (60.0, 300.0):
        leader = card(shipped, LEADER, horizon)
        assert 0.8 < leader.median < 1.3
        assert 1.0 <= leader.ratio < 1.2
        without_twin = [
            c for c in shipped.cards if c.horizon == horizon and c.who not in TWINS
        ]
        assert without_twin
        assert all(c.median > 1.05 * leader.median for c in without_twin)
        assert card(shipped, "persistence", horizon).median > 10.0 * leader.median


def test_the_leaders_band_holds_what_it_promises(shipped: Backtest) -> None:
    """Some fifty forecasts of one session, whose samples go together: within 7 % of 90 %."""
    for horizon in shipped.horizons:
        leader = card(shipped, LEADER, horizon)
        assert leader.coverage_output == pytest.approx(0.9, abs=0.07)
        assert leader.coverage_input == pytest.approx(0.9, abs=0.07)


def test_a_constant_band_has_the_means_of_the_nominal(shipped: Backtest) -> None:
    for horizon in shipped.horizons:
        nominal, constant = (
            card(shipped, forecaster, horizon) for forecaster in (NOMINAL, CONSTANT)
        )
        assert (nominal.median, nominal.nine_in_ten, nominal.ratio) == (
            constant.median,
            constant.nine_in_ten,
            constant.ratio,
        )
        assert nominal.width_output != constant.width_output


EARLY = Choices(every=50.0, horizons=(10.0, 60.0, 100.0))


def backtest_where(wanted: Callable[[Sample], bool]) -> Backtest:
    """Of those samples of the sample session."""
    session = open_any(SHIPPED)
    part = replace(session, samples=[s for s in session.samples if wanted(s)])
    return backtest(part, terms_from_files(part), EARLY)[0]


@pytest.fixture(scope="module")
def early() -> Backtest:
    """The first 900 samples."""
    return backtest_where(lambda sample: sample.index < 900)


def test_a_session_cut_short_gives_the_same_forecasts(early: Backtest) -> None:
    """Nobody looks ahead: what comes after sample 650 does not change what is said up to 550."""
    cut = backtest_where(lambda sample: sample.index < 651)
    # As texts, in which figures that there are not, NaN, are equal.
    of_cut = {(*m.place, m.who): repr(m) for m in cut.marked if m.sample <= 550}
    uncut = {(*m.place, m.who): repr(m) for m in early.marked if m.sample <= 550}
    assert len(of_cut) > 60
    assert of_cut == uncut


def test_forecasts_through_a_fault_are_left_out(tmp_path: Path) -> None:
    """From sample 640 on the drive does nothing; nobody is blamed for not foreseeing that."""
    session = open_any(write_session(tmp_path / "lost", drive_lost()))
    (tested,) = backtest(session, terms_from_files(session), TWIN_ONLY)
    assert tested.marked
    assert all(m.sample + m.horizon < 640 for m in tested.marked)
    assert any("the plant had a fault" in note for note in tested.notes)


def test_without_a_candidate_there_is_nothing_to_judge(tmp_path: Path) -> None:
    still = np.full(200, 30.0)
    session = open_any(
        write_session(tmp_path / "still", samples_of(Window(still, still, still)))
    )
    (tested,) = backtest(session, terms_from_files(session), TWIN_ONLY)
    assert (tested.marked, tested.cards, tested.shown) == ((), [], ())
    assert any("there was no candidate yet" in note for note in tested.notes)


def rms_of_leader(tested: Backtest) -> dict[tuple[int, float], float]:
    """Errors of the output as the leader forecast it, by origin and horizon."""
    return {
        (m.sample, m.horizon): m.marks.output.rms
        for m in tested.marked
        if m.who == LEADER
    }


def test_a_lost_sample_costs_no_forecast(early: Backtest) -> None:
    """Every fifteenth is lost: all are made that do not begin or end there, with nearly the same errors."""
    thinned = backtest_where(
        lambda sample: sample.index < 900 and sample.index % 15 != 7
    )
    ends = {(m.sample + round(h)) % 15 for m in thinned.marked for h in (m.horizon,)}
    assert 7 not in ends
    before = rms_of_leader(early)
    with_gaps = rms_of_leader(thinned)
    places = [
        place
        for place in before
        if place[0] % 15 != 7 and (place[0] + round(place[1])) % 15 != 7
    ]
    assert len(with_gaps.keys() & set(places)) > 0.9 * len(places)
    assert np.median([*with_gaps.values()]) == pytest.approx(
        np.median([*before.values()]), rel=0.2
    )


def test_nothing_is_forecast_over_a_gap() -> None:
    """Forty samples are lost: what is said before ends there, and what is said after starts over."""
    whole = open_any(SHIPPED)
    session = replace(whole, samples=[*whole.samples[:600], *whole.samples[640:900]])
    (tested,) = backtest(
        session, terms_from_files(session), Choices(every=50.0, peers=("persistence",))
    )
    reach = {(m.sample, m.sample + round(m.horizon)) for m in tested.marked}
    assert any(last < 600 for _, last in reach)
    assert any(first >= 640 for first, _ in reach)
    assert not any(first < 640 and last >= 600 for first, last in reach)
    assert len(tested.came) == 2


def test_another_plant_is_tested_as_the_rig_is(tmp_path: Path) -> None:
    """A motor, twenty samples a second: the leader errs by its sensor's noise, and units are the motor's."""
    truth = Motor.model("without friction").parameters(k=0.06, j=5e-4, b=2e-4)
    reference = np.repeat([50.0, 150.0, 90.0, -60.0], 180)
    sensor = Sensor(noise=Motor.output.noise).realise(reference.size, 0.05, 3)
    run = simulate_closed_loop(
        truth, reference, states=begin(truth, 0.0), law=Motor.loop, sensor=sensor
    )
    samples = samples_of(Window(reference, run.output, run.input, period=0.05))
    choices = Choices(every=2.0, horizons=(0.5, 5.0))
    settings = TwinSettings.of(Motor, period=0.05)
    listener = Listener("motor", settings, choices)
    judgement = judge_samples("motor", samples, settings, beside=listener)
    tested = graded(judgement, listener)
    leader = card(tested, LEADER, 5.0)
    assert leader.count > 10
    assert 0.5 < leader.median < 2.0
    assert leader.ratio < 1.2
    assert leader.median < card(tested, "persistence", 5.0).median
    assert "end / rad/s" in dict(card_columns(tested.plant))
    save(draw_backtest(tested), tmp_path / "motor.png")


def test_pictured_forecasts_follow_one_another(shipped: Backtest) -> None:
    assert len(shipped.shown) >= 4
    for before, after in zip(shipped.shown, shipped.shown[1:], strict=False):
        assert before.sample + before.time.size <= after.sample


def test_the_leader_is_reported(shipped: Backtest) -> None:
    def named(forecaster: str) -> set[str]:
        return {m.candidate for m in shipped.marked if m.who == forecaster}

    assert all(named(LEADER))
    assert all(named(NOMINAL))
    assert named(NEWEST) <= {f"{level} °C" for level in (30, 50, 70, 90)}
    assert named("persistence") == {""}


def test_the_best_in_hindsight_is_one_of_the_candidates(shipped: Backtest) -> None:
    errors: dict[tuple[str, int, float], dict[str, Marked]] = {}
    for marked_forecast in shipped.marked:
        errors.setdefault(marked_forecast.place, {})[marked_forecast.who] = (
            marked_forecast
        )
    for by_forecaster in errors.values():
        for forecaster in (LEADER, NOMINAL, NEWEST):
            assert (
                by_forecaster[HINDSIGHT].marks.error
                <= by_forecaster[forecaster].marks.error
            )


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Choices(horizons=()), "there is no horizon"),
        (lambda: Choices(peers=("prophet",)), "no peer 'prophet'"),
        (
            lambda: backtest_session(SHIPPED, Choices(horizons=(0.5,))),
            "shorter than one sample",
        ),
        (
            lambda: backtest_session(SHIPPED, Choices(every=0.1)),
            "shorter than one sample",
        ),
    ],
    ids=["none", "peer", "horizon", "every"],
)
def test_choices_that_cannot_be_are_refused(make: object, words: str) -> None:
    with pytest.raises(BacktestError, match=words):
        make()  # type: ignore[operator]


# Report cards as tables, sentences, JSON and a picture say the same figures, as does the command.

HORIZONS = (10.0, 60.0)


@pytest.fixture(scope="module")
def tested() -> Backtest:
    """Ten minutes of a loop, forecast by those who need no twin."""
    loop = linear_loop(set_points(600, 21), np.random.default_rng(22))
    marked = []
    shown = []
    arx = Arx(Peltier.loop, 1.0)
    origin_at = {
        origin.sample: origin
        for origin in origins([loop], range(59, len(loop), 60), HORIZONS)
    }
    for sample in samples_of(loop):
        arx.push(sample)
        if sample.index in origin_at:
            for name, forecast in ask(
                arx.departure(np.zeros(2)), origin_at[sample.index]
            ).items():
                origin = origin_at[sample.index]
                forecaster = PEERS[name]
                named = NamedForecast(forecaster, "", forecast)
                (of_forecast,) = scores("loop", HORIZONS, origin, Peltier, 0, [named])
                marked += of_forecast
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
        notes=("a note",),
    )


def marked_by(forecaster: str, error: float, horizon: float = 60.0) -> Marked:
    signal = SignalMarks(rms=error, end=error, coverage=0.93, width=4.0, score=5.0)
    return Marked("a", 1, horizon, forecaster, Marks(signal, signal))


def test_the_table_has_everybody_at_every_horizon(tested: Backtest) -> None:
    tables = backtest_tables(tested)
    assert [table.title for table in tables] == [
        "loop: 10 s ahead, 9 forecasts",
        "loop: 60 s ahead, 9 forecasts",
    ]
    console = Console(width=180, record=True, file=io.StringIO())
    for table in tables:
        console.print(table)
    text = console.export_text()
    assert text.count("persistence") == text.count("ARX") == 2
    for card in tested.cards:
        assert all(
            name in text and cell(card) in text for name, cell in card_columns(Peltier)
        )


def backtest_of(*marked: Marked, horizons: tuple[float, ...] = (60.0,)) -> Backtest:
    return Backtest("a", Peltier, 1.0, horizons, 0.9, marked)


def test_cells_are_in_the_units_of_the_plant() -> None:
    (card,) = backtest_of(marked_by("ARX", 2.0)).cards
    cell_of = {name: text(card) for name, text in card_columns(Peltier)}
    assert cell_of["error"] == "2.00"
    assert (cell_of["end / °C"], cell_of["end / PWM"]) == ("0.20", "14.0")
    assert (cell_of["width / °C"], cell_of["width / PWM"]) == ("0.40", "28.0")
    assert (cell_of["held °C"], cell_of["held PWM"]) == ("93 %", "93 %")
    assert cell_of["× best"] == "–"


def test_the_sentence_says_how_the_leader_did() -> None:
    marked = (
        marked_by(LEADER, 2.0),
        marked_by("ARX", 5.0),
        marked_by("persistence", 9.0),
    )
    tested = backtest_of(*marked, horizons=HORIZONS)
    sentence = (
        "60 s ahead, the leader's temperature was off by less than 0.20 °C half of the time, and its band "
        "held 93 % of the readings (90 % expected)."
    )
    assert backtest_words(tested) == [sentence]
    last = verdict(TrustLevel.TRUSTED, leader="50 °C", trusted=(60.0,))
    at_end = backtest_words(replace(tested, last=last))
    assert at_end == [sentence, "At the end they pass the test of trust 60 s ahead."]
    nowhere = backtest_words(replace(tested, last=replace(last, trusted=())))
    assert nowhere == [
        sentence,
        "At the end they pass the test of trust at no horizon.",
    ]


def test_json_holds_cards_and_every_forecast(tested: Backtest) -> None:
    text = json.dumps(document(tested), allow_nan=False)
    read = json.loads(text)
    assert (read["name"], read["plant"], read["origins"]) == ("loop", "peltier", 9)
    assert read["noise"] == {"output": 0.1, "input": 7.0}
    assert len(read["forecasts"]) == len(tested.marked) == 36
    errors = [
        f["error"]
        for f in read["forecasts"]
        if (f["who"], f["horizon"]) == ("ARX", 60.0)
    ]
    card = next(c for c in read["cards"] if (c["who"], c["horizon"]) == ("ARX", 60.0))
    assert card["median"] == pytest.approx(np.median(errors))
    assert card["ratio"] is None
    assert set(read["forecasts"][0]["output"]) == {
        "rms",
        "end",
        "coverage",
        "width",
        "score",
    }
    assert "forecasts" not in document(tested, forecasts=False)


def test_several_sessions_are_one(tested: Backtest) -> None:
    total = over_all([tested, tested])
    assert total.name == "all 2 sessions"
    assert [c.count for c in total.cards] == [2 * c.count for c in tested.cards]
    assert [c.median for c in total.cards] == [c.median for c in tested.cards]
    assert total.notes == ("loop: a note", "loop: a note")


def test_sessions_of_one_name_are_not_mixed_up() -> None:
    """The best in hindsight of each stays its own: ratios of 2 and 4, and not of 2 and 2."""
    first, second = (
        backtest_of(marked_by(LEADER, 4.0), marked_by(HINDSIGHT, best))
        for best in (2.0, 1.0)
    )
    (card, _) = over_all([first, second]).cards
    assert (card.who, card.ratio) == (LEADER, 3.0)


def finite_pieces(values: npt.ArrayLike) -> int:
    """How many stretches of finite values there are between others."""
    is_finite = np.isfinite(np.asarray(values, dtype=np.float64))
    return int(is_finite[0]) + int(np.count_nonzero(np.diff(is_finite.astype(int)) > 0))


def test_the_picture_shows_errors_coverage_and_forecasts(
    tested: Backtest, tmp_path: Path
) -> None:
    figure = draw_backtest(tested)
    save(figure, tmp_path / "card.png")
    assert (tmp_path / "card.png").stat().st_size > 30_000
    errors, coverage, output, residual, entry = figure.axes
    medians = {line.get_label(): line.get_ydata() for line in errors.get_lines()}
    for forecaster in ("persistence", "ARX"):
        expected_medians = [c.median for c in tested.cards if c.who == forecaster]
        np.testing.assert_array_equal(np.asarray(medians[forecaster]), expected_medians)
    assert [t.get_text() for t in coverage.get_xticklabels()] == [
        "10 s ahead",
        "60 s ahead",
    ]
    for panel in (output, residual, entry):
        pieces = max(finite_pieces(line.get_xdata()) for line in panel.get_lines())
        assert pieces == len(tested.shown)


def test_without_a_forecast_the_picture_says_so() -> None:
    figure = draw_backtest(backtest_of(horizons=HORIZONS))
    assert "no forecast could be judged" in [t.get_text() for t in figure.axes[0].texts]


@pytest.fixture
def still(tmp_path: Path) -> Path:
    """Three minutes in which nothing happens."""
    level = np.full(180, 30.0)
    return write_session(tmp_path / "still", samples_of(Window(level, level, level)))


def test_the_shipped_session_has_its_report_card(command: Any) -> None:
    assert command.done.stderr == ""
    assert "four_setpoints: 300 s ahead" in command.done.stdout
    assert "best in hindsight" in command.done.stdout
    assert (
        "300 s ahead, the leader's temperature was off by less than"
        in command.done.stdout
    )
    assert command.figure.stat().st_size > 50_000
    written = json.loads(command.json.read_text())
    assert written["sessions"] == [json.loads(json.dumps(document(command.tested)))]
    assert written["total"]["cards"] == written["sessions"][0]["cards"]


def test_horizons_pace_and_peers_can_be_chosen(still: Path, tmp_path: Path) -> None:
    out = tmp_path / "card.json"
    process = run_twinmatch(
        "backtest",
        still,
        "--every",
        "20",
        "--horizon",
        "30",
        "5",
        "--peers",
        "--json",
        out,
    )
    assert process.returncode == 0, process.stderr
    written = json.loads(out.read_text())["total"]
    assert written["horizons"] == [5.0, 30.0]
    assert written["cards"] == []
    assert "there was no candidate yet" in process.stdout


def test_a_session_that_cannot_be_used_is_skipped(still: Path, tmp_path: Path) -> None:
    process = run_twinmatch(
        "backtest", still, tmp_path / "absent.mat", "--peers", "persistence"
    )
    assert process.returncode == 3
    assert len(process.stderr.strip().splitlines()) == 1
    assert "skipped" in process.stderr
    assert "absent.mat" in process.stderr


def test_the_command_offers_every_peer() -> None:
    """It names them itself, since importing them is slow."""
    assert tuple(PEERS) == OFFERED
