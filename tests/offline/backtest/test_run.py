"""The twin's own forecasts: what they may know, who is who, and that they are worth having."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.places import SHIPPED
from tests.support.plants import Motor
from tests.support.steps import drive_lost
from twinmatch.dynamics import Sensor, begin, simulate_closed_loop
from twinmatch.offline.backtest import Choices
from twinmatch.offline.backtest.peer import BacktestError
from twinmatch.offline.backtest.run import Listener, backtest, backtest_session, graded
from twinmatch.offline.backtest.scoring import (
    CONSTANT,
    HINDSIGHT,
    LEADER,
    NEWEST,
    NOMINAL,
    TWINS,
    Backtest,
    Card,
    Marked,
)
from twinmatch.offline.judging import judge_samples, terms_from_files
from twinmatch.sessions import open_any, samples_of, write_session
from twinmatch.showing.figures.drawing import save
from twinmatch.showing.figures.forecasts import draw_backtest
from twinmatch.showing.forecasts import card_columns
from twinmatch.signals import Window
from twinmatch.twin import TwinSettings

TWIN_ONLY = Choices(every=120.0, peers=())


def card(tested: Backtest, who: str, horizon: float) -> Card:
    return next(c for c in tested.cards if (c.who, c.horizon) == (who, horizon))


def test_everybody_is_judged_from_the_same_origins(shipped: Backtest) -> None:
    assert [c.who for c in shipped.cards][::3][:5] == [LEADER, NOMINAL, NEWEST, CONSTANT, HINDSIGHT]
    for horizon in shipped.horizons:
        held = [c for c in shipped.cards if c.horizon == horizon]
        assert len({c.count for c in held}) == 1
        assert held[0].count >= 30


def test_the_leader_is_near_the_best_and_beats_everybody_without_a_twin(shipped: Backtest) -> None:
    """The rig is of a structure that competes, seen through noise of 1: the leader errs by little more."""
    for horizon in (60.0, 300.0):
        leader = card(shipped, LEADER, horizon)
        assert 0.8 < leader.median < 1.3
        assert 1.0 <= leader.ratio < 1.2
        others = [c for c in shipped.cards if c.horizon == horizon and c.who not in TWINS]
        assert others
        assert all(c.median > 1.3 * leader.median for c in others)
        assert all(c.score > leader.score for c in others)


def test_the_leaders_band_holds_what_it_promises(shipped: Backtest) -> None:
    """Some fifty forecasts of one session, whose samples go together: within 7 % of 90 %."""
    for horizon in shipped.horizons:
        leader = card(shipped, LEADER, horizon)
        assert leader.coverage_output == pytest.approx(0.9, abs=0.07)
        assert leader.coverage_input == pytest.approx(0.9, abs=0.07)


def test_a_constant_band_has_the_means_of_the_nominal(shipped: Backtest) -> None:
    for horizon in shipped.horizons:
        one, other = (card(shipped, who, horizon) for who in (NOMINAL, CONSTANT))
        assert (one.median, one.nine_in_ten, one.ratio) == (other.median, other.nine_in_ten, other.ratio)
        assert one.width_output != other.width_output


def test_a_session_cut_short_gives_the_same_forecasts() -> None:
    """Nobody looks ahead: what comes after sample 1100 does not change what is said up to 1000."""
    whole = open_any(SHIPPED)
    cut = replace(whole, samples=whole.samples[:1101])
    choices = Choices(every=100.0, horizons=(10.0, 100.0))
    one, other = (backtest(s, terms_from_files(s), choices) for s in (whole, cut))
    known = {(*m.place, m.who): m for m in other.marked if m.sample <= 1000}
    again = {(*m.place, m.who): m for m in one.marked if m.sample <= 1000}
    assert len(known) > 60
    assert known == again


def test_forecasts_through_a_fault_are_left_out(tmp_path: Path) -> None:
    """From sample 640 on the drive does nothing; nobody is blamed for not foreseeing that."""
    session = open_any(write_session(tmp_path / "lost", drive_lost()))
    tested = backtest(session, terms_from_files(session), TWIN_ONLY)
    assert tested.marked
    assert all(m.sample + m.horizon < 640 for m in tested.marked)
    assert any("the plant had a fault" in note for note in tested.notes)


def test_without_a_candidate_there_is_nothing_to_judge(tmp_path: Path) -> None:
    still = np.full(200, 30.0)
    session = open_any(write_session(tmp_path / "still", samples_of(Window(still, still, still))))
    tested = backtest(session, terms_from_files(session), TWIN_ONLY)
    assert (tested.marked, tested.cards, tested.shown) == ((), [], ())
    assert any("there was no candidate yet" in note for note in tested.notes)


def test_a_peer_that_could_not_answer_is_reported() -> None:
    """After a gap the twins continue at once; ARX starts over and needs a minute."""
    whole = open_any(SHIPPED)
    session = replace(whole, samples=[*whole.samples[:700], *whole.samples[740:1000]])
    tested = backtest(session, terms_from_files(session), Choices(every=50.0, peers=("arx",)))
    assert any("some forecasters lacked samples (ARX)" in note for note in tested.notes)


def test_nothing_is_forecast_over_a_gap() -> None:
    """Forty samples are lost: what is said before ends there, and what is said after starts over."""
    whole = open_any(SHIPPED)
    session = replace(whole, samples=[*whole.samples[:1000], *whole.samples[1040:1300]])
    tested = backtest(session, terms_from_files(session), Choices(every=50.0, peers=("persistence",)))
    reach = {(m.sample, m.sample + round(m.horizon)) for m in tested.marked}
    assert any(last < 1000 for _, last in reach)
    assert any(first >= 1040 for first, _ in reach)
    assert not any(first < 1040 and last >= 1000 for first, last in reach)
    assert len(tested.came) == 2


def test_another_plant_is_tested_as_the_rig_is(tmp_path: Path) -> None:
    """A motor, twenty samples a second: the leader errs by its sensor's noise, and units are the motor's."""
    truth = Motor.model("without friction").parameters(k=0.06, j=5e-4, b=2e-4)
    reference = np.repeat([50.0, 150.0, 90.0, -60.0, 120.0, 30.0], 240)
    sensor = Sensor(noise=Motor.output.noise).realise(reference.size, 0.05, 3)
    run = simulate_closed_loop(truth, reference, states=begin(truth, 0.0), gains=Motor.loop, sensor=sensor)
    samples = samples_of(Window(reference, run.output, run.input, period=0.05))
    choices = Choices(every=2.0, horizons=(0.5, 5.0))
    listener = Listener.to(samples, 0.05, choices)
    judgement = judge_samples("motor", samples, TwinSettings.of(Motor, period=0.05), beside=listener)
    tested = graded(judgement, listener, choices)
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
    def named(who: str) -> set[str]:
        return {m.candidate for m in shipped.marked if m.who == who}

    assert all(named(LEADER))
    assert all(named(NOMINAL))
    assert named(NEWEST) <= {f"{level} °C" for level in (30, 50, 70, 90)}
    assert named("persistence") == {""}


def test_the_best_in_hindsight_is_one_of_the_candidates(shipped: Backtest) -> None:
    errors: dict[tuple[str, int, float], dict[str, Marked]] = {}
    for one in shipped.marked:
        errors.setdefault(one.place, {})[one.who] = one
    for found in errors.values():
        for who in (LEADER, NOMINAL, NEWEST):
            assert found[HINDSIGHT].marks.error <= found[who].marks.error


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Choices(horizons=()), "there is no horizon"),
        (lambda: Choices(peers=("prophet",)), "no peer 'prophet'"),
        (lambda: backtest_session(SHIPPED, Choices(horizons=(0.5,))), "shorter than one sample"),
        (lambda: backtest_session(SHIPPED, Choices(every=0.1)), "shorter than one sample"),
    ],
    ids=["none", "peer", "horizon", "every"],
)
def test_choices_that_cannot_be_are_refused(make: object, words: str) -> None:
    with pytest.raises(BacktestError, match=words):
        make()  # type: ignore[operator]
