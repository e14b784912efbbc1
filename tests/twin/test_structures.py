"""Structures side by side: richness is bought when the data justify it, and only then."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from twinmatch.dynamics import Parameters, begin, simulate_closed_loop, simulate_window
from twinmatch.fitting import FittingError
from twinmatch.plants import Peltier
from twinmatch.signals import Window
from twinmatch.twin import nrmse
from twinmatch.twin.structures import choose_structure, prediction_errors

FULL = "sink with mass, free ambient, switched drive"
PLATE = {"seebeck": 0.065, "conductance": 0.65, "heat_capacity": 31.0}
RICH = Peltier.model(FULL).parameters(**PLATE, ambient=291.0, sink_heat_capacity=280.0, sink_convection=2.5)
PLAIN = Peltier.model().parameters(**PLATE)
SOME = tuple(map(Peltier.model, ("held sink", "held sink, free ambient", "sink with mass", FULL)))
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
    assert choice.votes["BIC"] == choice.votes["MDL"] == "held sink"


@pytest.mark.parametrize("seed", [1, 2])
def test_a_rich_plant_justifies_its_sink(seed: int) -> None:
    choice = choose_structure(recorded(RICH, seed), SOME)
    assert choice.chosen == FULL
    assert choice.parameters["conductance"] == pytest.approx(RICH["conductance"], rel=0.1)
    assert choice.sentence.startswith(f"4 of 4 criteria choose: {FULL} (7 parameters")


@pytest.mark.parametrize("zeros", [0, 13, 40, 60, 100])
def test_stretches_without_any_error_do_no_harm(zeros: int) -> None:
    """As a saturated output leaves them, or a sensor that stands still: exact zeros, thirteen and more."""
    errors = 50.0 * np.random.default_rng(1).normal(size=100)
    errors[:zeros] = 0.0
    found = prediction_errors([errors])
    assert np.isfinite(found).all()
    assert not found[: max(zeros - 12, 0)].any()


def test_evidence_adds_over_samples_that_follow() -> None:
    window = recorded(PLAIN, 3)
    first = choose_structure(window.part(0, 599), SOME, thorough=False)
    second = choose_structure(window.part(600, 1199), SOME, previous=first, thorough=False)
    for score in second.scores:
        assert score.evidence.bic == pytest.approx(first.of(score.name).evidence.bic + score.total.bic)
    overlapping = choose_structure(window.part(500, 1199), SOME, previous=first, thorough=False)
    assert all(score.evidence == score.total for score in overlapping.scores)


def test_a_structure_is_scored_on_what_was_measured_alone() -> None:
    """Whatever stands in for twenty lost outputs, figures and criteria are the same to the last bit."""
    window = recorded(RICH, 1).part(0, 599)
    seen = np.ones(len(window), dtype=np.bool_)
    seen[[*range(200, 205), *range(400, 415)]] = False
    scores = []
    for off in (0.0, 40.0):
        output = window.output + np.where(seen, 0.0, off)
        lost = Window(window.reference, output, window.input, seen=seen)
        scores.append(choose_structure(lost, SOME, thorough=False).scores)
    for one, other in zip(*scores, strict=True):
        assert one.total == other.total
        assert (one.loss, one.fitted.fit, one.fitted.cost) == (
            other.loss,
            other.fitted.fit,
            other.fitted.cost,
        )
    whole = choose_structure(window, SOME, thorough=False).scores
    assert all(one.total != every.total for one, every in zip(scores[0], whole, strict=True))


def test_prediction_errors_are_those_of_the_noise_behind_the_twin() -> None:
    random = np.random.Generator(np.random.PCG64(5))
    white = random.standard_normal(20_000)
    coloured = np.zeros(white.size)
    for k in range(2, white.size):
        coloured[k] = 1.5 * coloured[k - 1] - 0.6 * coloured[k - 2] + white[k]
    errors = prediction_errors([coloured])
    # Cutting at 3 σ takes 0.6 % of a normal variance; 12 of 20 000 degrees of freedom are used up.
    assert np.mean(errors**2) == pytest.approx(1.0 - 0.006, abs=0.03)
    lagged = errors[1:] @ errors[:-1] / (errors @ errors)
    assert abs(lagged) < 0.02
    spiked = coloured.copy()
    spiked[::200] += 300.0
    # A kick and the twelve samples forecast from it are one sample in fifteen, each cut at 3 σ: 0.6 more.
    # Plain least squares lets the kicks shape the model and leaves 12.
    assert np.mean(prediction_errors([spiked]) ** 2) < 2.5


def test_one_model_serves_all_windows() -> None:
    random = np.random.Generator(np.random.PCG64(6))
    one, other = random.standard_normal(500), random.standard_normal(300)
    assert prediction_errors([one, other, np.ones(5)]).size == 800 - 2 * 12


def test_a_second_half_is_forecast_from_the_first(recorded_hour: Callable[[int], Window]) -> None:
    """Two hours of the real rig: more than the three-parameter twin reaches there (0.868, 0.852 of u)."""
    for number in (2, 14):
        hour = recorded_hour(number)
        choice = choose_structure(hour.part(0, 1800), SOME)
        assert choice.chosen == FULL
        run = simulate_window(choice.parameters, hour, starts=choice.score.fitted.starts[0])
        assert nrmse(hour.output[1801:], run.output[1799:]) > 0.990
        assert nrmse(hour.input[1801:], run.input[1799:]) > 0.89


def test_a_frozen_sensor_is_judged_without_a_warning() -> None:
    """Warnings are errors here: a reading that stands still for half of the record overflows nothing."""
    window = recorded(RICH, 1)
    frozen = window.output.copy()
    frozen[600:] = frozen[600]
    choice = choose_structure(Window(window.reference, frozen, window.input), ALL, thorough=False)
    assert all(np.isfinite(score.total.bic) for score in choice.scores)


def test_nothing_to_choose_from_is_refused() -> None:
    with pytest.raises(FittingError, match="there is none to choose from"):
        choose_structure(recorded(PLAIN, 1, 50), ())
    choice = choose_structure(recorded(PLAIN, 1, 50), SOME[:1], thorough=False)
    assert "its BIC" not in choice.sentence
    with pytest.raises(KeyError, match="sink with mass"):
        choice.of("sink with mass")
