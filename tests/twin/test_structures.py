"""Structures side by side: richness is bought when the data justify it, and only then."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Parameters,
    Plant,
    State,
    Structure,
    begin,
    simulate_closed_loop,
    simulate_window,
)
from twinmatch.fitting import FittingError
from twinmatch.plants import Peltier
from twinmatch.signals import Window
from twinmatch.twin import nrmse
from twinmatch.twin.structures import choose_structure

FULL = "sink with mass, free ambient, switched drive"
PLATE = {"seebeck": 0.065, "conductance": 0.65, "heat_capacity": 31.0}
RICH = Peltier.model(FULL).parameters(
    **PLATE, ambient=291.0, sink_heat_capacity=280.0, sink_convection=2.5
)
PLAIN = Peltier.model().parameters(**PLATE)
SOME = tuple(
    map(Peltier.model, ("held sink", "held sink, free ambient", "sink with mass", FULL))
)
ALL = tuple(map(Peltier.model, Peltier.structures))


def recorded(rig: Parameters, seed: int, samples: int = 200) -> Window:
    reference = np.repeat([50.0, 30.0, 75.0, 45.0, 90.0, 25.0], samples)
    sensor = Peltier.sensor.realise(reference.size, 1.0, seed)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 22.0), sensor=sensor)
    return Window(reference, run.output, run.input)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_plain_plant_is_not_sold_richness(seed: int) -> None:
    choice = choose_structure(recorded(PLAIN, seed), SOME, thorough=False)
    assert choice.chosen == "held sink"


@pytest.mark.parametrize("seed", [1, 2])
def test_a_rich_plant_justifies_its_sink(seed: int) -> None:
    choice = choose_structure(recorded(RICH, seed), SOME)
    assert choice.chosen == FULL
    assert choice.parameters["conductance"] == pytest.approx(
        RICH["conductance"], rel=0.1
    )
    assert choice.sentence.startswith(
        f"free runs on samples held back choose: {FULL} (off by "
    )


def test_evidence_adds_over_samples_that_follow() -> None:
    window = recorded(PLAIN, 3)
    first = choose_structure(window.part(0, 599), SOME, thorough=False)
    second = choose_structure(
        window.part(600, 1199), SOME, previous=first, thorough=False
    )
    for score in second.scores:
        both = [*first.of(score.name).held_back, *score.held_back]
        np.testing.assert_array_equal(score.evidence, both)
    overlapping = choose_structure(
        window.part(500, 1199), SOME, previous=first, thorough=False
    )
    assert all(score.evidence is score.held_back for score in overlapping.scores)


def test_a_structure_is_scored_on_what_was_measured_alone() -> None:
    """Whatever stands in for twenty lost outputs, figures and criteria are the same to the last bit."""
    window = recorded(RICH, 1).part(0, 599)
    is_seen = np.ones(len(window), dtype=np.bool_)
    is_seen[[*range(200, 205), *range(450, 465)]] = False
    scores = []
    for wrong_by in (0.0, 40.0):
        output = window.output + np.where(is_seen, 0.0, wrong_by)
        lost = Window(window.reference, output, window.input, seen=is_seen)
        scores.append(choose_structure(lost, SOME, thorough=False).scores)
    for score, shifted_score in zip(*scores, strict=True):
        np.testing.assert_array_equal(score.held_back, shifted_score.held_back)
        assert (score.fitted.fit, score.fitted.cost) == (
            shifted_score.fitted.fit,
            shifted_score.fitted.cost,
        )
    whole = choose_structure(window, SOME, thorough=False).scores
    assert all(
        score.off != whole_score.off
        for score, whole_score in zip(scores[0], whole, strict=True)
    )


def test_a_second_half_is_forecast_from_the_first(
    recorded_hour: Callable[[int], Window],
) -> None:
    """Two hours of the real rig: more than the three-parameter twin reaches there (0.868, 0.852 of u)."""
    for number in (2, 14):
        hour = recorded_hour(number)
        choice = choose_structure(hour.part(0, 1800), SOME)
        assert choice.chosen == FULL
        run = simulate_window(
            choice.parameters, hour, starts=choice.score.fitted.starts[0]
        )
        assert nrmse(hour.output[1801:], run.output[1799:]) > 0.990
        assert nrmse(hour.input[1801:], run.input[1799:]) > 0.89


def test_a_frozen_sensor_is_judged_without_a_warning() -> None:
    """Warnings are errors here: a reading that stands still for half of the record overflows nothing."""
    window = recorded(RICH, 1)
    frozen = window.output.copy()
    frozen[600:] = frozen[600]
    choice = choose_structure(
        Window(window.reference, frozen, window.input), ALL, thorough=False
    )
    assert all(np.isfinite(score.off) for score in choice.scores)


class Walled(Plant, name="walled"):
    """A lag with, perhaps, a wall beside it."""

    parts = ("wall",)
    y = Output(unit="K", noise=0.05, span=(-100.0, 100.0))
    u = Drive(unit="W", limits=(0.0, 10.0), noise=0.1)
    x = State(unit="K", span=(-50.0, 50.0))
    wall = State(unit="K", span=(-50.0, 50.0))
    gain = Parameter(unit="K/W", default=2.0, bounds=(0.1, 10.0), positive=True)
    lag = Parameter(unit="s", default=50.0, bounds=(5.0, 500.0), positive=True)
    share = Parameter(unit="", default=1.0, bounds=(0.0, 100.0), least=0.0)
    wall_lag = Parameter(unit="s", default=100.0, bounds=(10.0, 1000.0), positive=True)
    structures = {  # noqa: RUF012
        "plain": Structure(free=("gain", "lag")),
        "wall": Structure(
            free=("gain", "lag", "share", "wall_lag"), parts=frozenset({"wall"})
        ),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        """One store or two."""
        rates = {self.x: (self.gain * self.u - self.x) / self.lag}
        start = {self.x: self.y}
        if "wall" in parts:
            rates[self.x] += self.share * (self.wall - self.x) / self.lag
            rates[self.wall] = (self.x - self.wall) / self.wall_lag
            start[self.wall] = self.y
        return Equations(rates=rates, output=self.x, start=start)


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_an_effect_that_was_fitted_as_none_is_not_chosen(seed: int) -> None:
    """A plant whose heater has a lag of its own, and no wall: the fits differ by as little as searches end beside
    each other, in every block in the same direction."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.choice([0.0, 10.0], 60), 20)
    heater = 0.0
    warmth = 0.0
    warmths = []
    for u in command:
        warmths.append(warmth)
        heater += (u - heater) / 40.0
        warmth += (2.0 * heater - warmth) / 50.0
    readings = np.array(warmths) + 0.05 * random.normal(size=command.size)
    window = Window(np.zeros(command.size), readings, command)
    choice = choose_structure(
        window, list(map(Walled.model, Walled.structures)), law=None
    )
    assert choice.of("wall").parameters["share"] < 1e-6
    assert choice.chosen == "plain"


def test_nothing_to_choose_from_is_refused() -> None:
    with pytest.raises(FittingError, match="there is none to choose from"):
        choose_structure(recorded(PLAIN, 1, 50), ())
    choice = choose_structure(recorded(PLAIN, 1, 50), SOME[:1], thorough=False)
    assert ";" not in choice.sentence
    with pytest.raises(KeyError, match="sink with mass"):
        choice.of("sink with mass")
