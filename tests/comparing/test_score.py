"""Models of a window and what the criteria say of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twinmatch.comparing import (
    Criteria,
    OrderScore,
    choose_order,
    code_length,
    common_order,
    identify,
    mdl,
    nu_gap_of,
    score,
    twin_response,
)
from twinmatch.comparing.models import ahead, deviations, operating_level
from twinmatch.dynamics import Parameters, begin, simulate_closed_loop
from twinmatch.fitting import FittingError
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, Window

MODEL = Peltier.model()
RIG = MODEL.parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
REFERENCE = np.repeat([30.0, 50.0, 70.0], [60, 120, 150])


def measured(rig: Parameters = RIG, seed: int = 1) -> Window:
    sensor = Peltier.sensor.realise(len(REFERENCE), 1.0, seed)
    run = simulate_closed_loop(rig, REFERENCE, states=begin(rig, 30.0), sensor=sensor)
    return Window(REFERENCE, run.output, run.input)


def criteria(gain: int, naic: float, bic: float, mdl: float) -> Criteria:
    return Criteria(1000, 1000 - gain, gain, gain / 1000, naic, bic, mdl)


def entry(order: str, *values: float) -> OrderScore:
    c = criteria(int(values[0]), *values[1:])
    return OrderScore(order, c, c, c)


def test_totals_are_sums_as_in_the_papers_table() -> None:
    """50 °C, order 22221 of the paper: 1069 + 129 = 1198, 0.78 + 0.80 = 1.58, 1283.65 + 1290.03 = 2573.68."""
    y = Criteria(2048, 979, 1069, 1069 / 2048, 0.78, 1283.65, 2.52)
    u = Criteria(1622, 1493, 129, 129 / 1622, 0.80, 1290.03, 2.52)
    total = y + u
    assert (total.trivial_length, total.model_length, total.gain) == (3670, 2472, 1198)
    assert total.naic == pytest.approx(1.58)
    assert total.bic == pytest.approx(2573.68)
    assert total.explanation == pytest.approx(1198 / 3670)


def test_the_order_most_criteria_prefer_is_chosen() -> None:
    scores = [entry("22221", 500, 1.0, 900.0, 5.0), entry("33331", 700, 1.5, 950.0, 6.0)]
    assert choose_order(scores) == "22221"
    assert choose_order([entry("22221", 500, 2.0, 900.0, 5.0), scores[1]]) == "22221"  # two each
    assert common_order(["33331", "22221", "33331"]) == "33331"
    assert common_order(["44441", "22221"]) == "22221"


def test_deviations_begin_at_rest() -> None:
    window = measured()
    level = operating_level(window)
    r, y, u = deviations(window, level)
    assert r[0] == 0.0
    assert abs(np.mean(y[40:60])) < 0.2  # the loop is at rest before the step
    assert abs(np.mean(u[40:60])) < 1e-9
    np.testing.assert_array_equal(ahead(np.array([1.0, 2.0, 3.0])), [2.0, 3.0, 3.0])


@pytest.mark.parametrize("lead", [5, 20, 40])
def test_the_level_is_that_of_as_many_samples_as_the_schedule_leads_by(lead: int) -> None:
    window = measured()
    assert operating_level(window, lead=lead).input == np.mean(window.input[60 - lead : 60])
    driven = operating_level(
        Window(window.reference, window.output, window.reference), driven=True, lead=lead
    )
    assert driven.output == np.mean(window.output[60 - lead : 60])
    model = identify(window, ["22221"], lead=lead)[0]
    assert model.lead == lead
    _, _, u = deviations(window, operating_level(window, lead=lead))
    errors = model.u.prediction_errors(ahead(window.reference - 30.0), u)
    loss = float(np.mean(errors**2))
    assert score(model, window, absolute=KELVIN).u.mdl == mdl(loss, model.u.n_parameters, len(window))


def test_models_of_the_loop_have_its_gain_and_its_poles_inside() -> None:
    for model in identify(measured()):
        for part in (model.y, model.u):
            assert np.all(np.abs(np.roots(part.F)) < 1.0)
        # Integral action: at rest the temperature is the set-point.
        assert np.sum(model.y.B) / np.sum(model.y.F) == pytest.approx(1.0, abs=0.02)


def test_more_noise_free_information_is_explained_by_the_right_model_than_by_a_wrong_one() -> None:
    window = measured()
    own = identify(window)[0]
    slow = identify(measured(MODEL.parameters(seebeck=0.03, conductance=0.6, heat_capacity=60.0)))[0]
    right, wrong = score(own, window, absolute=KELVIN), score(slow, window, absolute=KELVIN)
    assert right.y.gain > wrong.y.gain
    assert right.y.naic < wrong.y.naic
    assert 0.0 < right.y.explanation < 1.0


def test_lengths_are_those_of_the_tables() -> None:
    window = measured()
    scored = score(identify(window)[0], window, decimals=1, absolute=KELVIN)
    assert scored.y.trivial_length == code_length(window.output + KELVIN, 1) + 15
    assert scored.u.trivial_length == code_length(window.input, 1) + 15
    assert scored.total.gain == scored.y.gain + scored.u.gain


def test_the_gap_of_a_twin_to_its_own_plant_is_small_and_to_another_large() -> None:
    window = measured()
    plant = identify(window)[0]
    gains, sensor = Peltier.loop, Peltier.sensor
    near = identify(twin_response(RIG, window, gains, sensor, seed=7))[0]
    far_rig = MODEL.parameters(seebeck=0.15, conductance=0.2, heat_capacity=20.0)
    far = identify(twin_response(far_rig, window, gains, sensor, seed=7))[0]
    assert nu_gap_of(near.symbol, plant.symbol) < 0.1
    assert nu_gap_of(far.symbol, plant.symbol) > 2 * nu_gap_of(near.symbol, plant.symbol)


def test_the_control_model_has_the_kick_of_the_same_tick() -> None:
    """The symbol's [u/r] starts without delay, the one identified with nk = 1 does not."""
    model = identify(measured())[0]
    assert model.u.B[0] == 0.0
    assert abs(model.u.B[1]) > 1.0  # PWM per °C, the proportional kick clipped by the driver


def test_the_twin_response_repeats_with_its_seed_only() -> None:
    window = measured()

    def run(seed: int) -> Any:
        return twin_response(RIG, window, Peltier.loop, Peltier.sensor, seed).output

    np.testing.assert_array_equal(run(5), run(5))
    assert not np.array_equal(run(5), run(6))


def test_a_window_that_does_not_move_identifies_nothing() -> None:
    still = Window(np.full(200, 50.0), np.full(200, 50.0), np.full(200, 90.0))
    with pytest.raises(FittingError, match="is constant"):
        identify(still)
