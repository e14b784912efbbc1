"""Backtests of plants with several outputs go through the twin as those of one loop do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.exchanging import Heaters, heated, heated_with_a_lie
from tests.support.processes import run_twinmatch
from tests.support.recorded_kits import kit_rows
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.importing.recordings import session_of
from twinmatch.offline.backtest import Backtest, Choices, backtest
from twinmatch.offline.backtest.scoring import LEADER, PEERS
from twinmatch.offline.judging import Terms
from twinmatch.plants import TCLabBoth
from twinmatch.sessions import Session, samples_of, write_session
from twinmatch.sessions.metadata import PLANT
from twinmatch.signals import Window
from twinmatch.twin import TwinSettings

MATCHED = 600
"""From this sample on the heaters' parameters have been matched."""


def session(window: Window, plant: str) -> Session:
    return session_of(
        Path("two.csv"), tuple(samples_of(window)), plant=plant, has_reference=False
    )


def ends(tested: Backtest, forecaster: str, horizon: float) -> dict[int, float]:
    """Errors at the horizon by origin, in units of the noise."""
    return {
        m.sample: m.marks.output.end
        for m in tested.marked
        if (m.who, m.horizon) == (forecaster, horizon)
    }


def test_forecasts_of_readings_that_lie_count_neither_for_nor_against_a_twin() -> None:
    """From sample 700 on the second sensor reads 4 °C too much; both outputs are forecast from its readings."""
    lying = heated_with_a_lie(750, 700, 750)
    terms = Terms(TwinSettings.of(Heaters, law=None, period=2.0))
    choices = Choices(every=20.0, horizons=(20.0, 100.0))
    tests = backtest(session(lying, Heaters.name), terms, choices)
    for tested in tests:
        assert tested.last is not None
        assert (tested.last.fault, tested.last.fault_signal) == (
            "sensor-drift",
            "second",
        )
        newest = max(m.sample + m.horizon / tested.period for m in tested.marked)
        assert 680 < newest < 700
        assert any("a sensor lied" in note for note in tested.notes)


def test_a_known_plant_is_forecast_to_its_noise() -> None:
    """What is left of white readings of a plant that is known: their noise."""
    terms = Terms(TwinSettings.of(Heaters, law=None, period=2.0))
    choices = Choices(every=20.0, horizons=(20.0, 100.0))
    first, second = backtest(session(heated(900), Heaters.name), terms, choices)
    assert [tested.name for tested in (first, second)] == ["two, first", "two, second"]
    assert [list(tested.plant.drives) for tested in (first, second)] == [
        ["first_power"],
        ["second_power"],
    ]
    for tested in (first, second):
        assert tested.last is not None
        assert tested.last.chosen is not None
        for horizon in (20.0, 100.0):
            leader_ends = [
                end for k, end in ends(tested, LEADER, horizon).items() if k >= MATCHED
            ]
            # of 30: 3 standard errors are 0.39
            assert np.std(leader_ends) == pytest.approx(1.0, abs=0.4)
            cards = {card.who: card for card in tested.cards if card.horizon == horizon}
            assert (
                cards[LEADER].median
                < cards[PEERS["arx"]].median
                < cards[PEERS["persistence"]].median
            )
            assert 0.8 < cards[LEADER].coverage_output < 0.99


def test_the_command_shows_every_output(tmp_path: Path) -> None:
    records = {PLANT: {"plant": TCLabBoth.name, "reference": "none"}}
    kit = TCLabBoth.model().typical()
    u = np.repeat([[30.0, 20.0], [50.0, 20.0], [50.0, 45.0], [20.0, 45.0]], 250, axis=0)
    run = simulate_driven(kit, u, states=begin(kit, [30.0, 28.0]))
    y = run.outputs + 0.1 * np.random.default_rng(2).standard_normal(u.shape)
    y[940:, 1] += 5.0
    path = tmp_path / "kit"
    card = tmp_path / "card.json"
    write_session(path, samples_of(Window(np.zeros_like(u), y, u)), records=records)
    process = run_twinmatch(
        "backtest",
        path,
        "--json",
        card,
        "--figure",
        tmp_path / "card.png",
        "--horizon",
        60,
    )
    assert process.returncode == 0, process.stderr
    assert (
        "60 s ahead, the leader's temperature T2 was off by less than" in process.stdout
    )
    document = json.loads(card.read_text("utf-8"))
    names = ["kit, temperature", "kit, second_temperature"]
    assert [entry["name"] for entry in document["sessions"]] == names
    assert [entry["name"] for entry in document["total"]] == names
    assert (tmp_path / "card.png").is_file()
    assert (tmp_path / "card_second_temperature.png").is_file()
    assert "Faults: sensor-drift of temperature T2 since 940 s." in process.stdout


def test_a_real_kit_is_forecast_better_than_by_arx() -> None:
    """Over the first 40 minutes: the twin has been matched once or more often, and ARX adapts all along."""
    rows = kit_rows("tclab_2x2", "prbs_open_loop")[:2400]
    y = np.array([[row["T1"], row["T2"]] for row in rows])
    u = np.array([[row["Q1"], row["Q2"]] for row in rows])
    kit_session = session(Window(np.zeros_like(y), y, u), TCLabBoth.name)
    terms = Terms(TwinSettings.of(TCLabBoth, law=None))
    tests = backtest(
        kit_session, terms, Choices(every=20.0, horizons=(10.0, 60.0, 300.0))
    )

    def rms(forecaster: str, horizon: float) -> float:
        errors = np.array(
            [list(ends(tested, forecaster, horizon).values()) for tested in tests]
        )
        return float(TCLabBoth.temperature.noise * np.sqrt(np.mean(np.square(errors))))

    assert rms(LEADER, 60.0) < 0.95 * rms(PEERS["arx"], 60.0)
    assert rms(LEADER, 300.0) < 0.75 * rms(PEERS["arx"], 300.0)
