"""A plant with two inputs and two outputs, whose truth is known: matched, followed, forecast and scored."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.support.exchanging import Heaters
from twinmatch.comparing import Candidate
from twinmatch.dynamics import (
    LinearLaw,
    Output,
    advance,
    begin,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.fitting import match
from twinmatch.forecasting import Outlook
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, SignalError, Window
from twinmatch.twin import Forecaster, ForecastSettings, Mirror, choose_structure
from twinmatch.twin.candidates import name_at

TRUTH = Heaters.model().parameters(exchange=0.03, first_gain=0.012, loss=0.008)
WRONG = TRUTH.replace(exchange=0.01, second_gain=0.014)
PERIOD = 2.0
MATCHED = 400
COUNT = 1500
SETTINGS = ForecastSettings(horizons=(20.0, 120.0, 300.0))
LAW = LinearLaw(
    A=np.eye(2), B=-0.1 * np.eye(2), C=0.2 * np.eye(2), D=[[-4.0, 0.5], [0.3, -5.0]],
    E=[[4.0, -0.5], [-0.3, 5.0]], F=0.1 * np.eye(2), G=np.zeros((2, 2)), offset=[20.0, 15.0],
    shift=np.zeros(2), low=[0.0, 0.0], high=[100.0, 80.0], period=PERIOD,
)  # fmt: skip


@cache
def driven() -> Window:
    """Steps of both inputs; the second sensor is three times as noisy as its plant file says."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(0.0, 60.0, (COUNT // 25, 2)), 25, axis=0)
    run = simulate_driven(TRUTH, u, states=begin(TRUTH, [23.0, 23.0]), period=PERIOD)
    y = run.outputs + [0.1, 0.3] * rng.standard_normal(run.outputs.shape)
    return Window(np.zeros((COUNT, 2)), y, u, period=PERIOD)


@cache
def closed() -> Window:
    """Under a law with two outputs and inputs that acts on noisy readings."""
    rng = np.random.default_rng(6)
    x = np.array([23.0, 23.0])
    z = np.zeros(2)
    rows = []
    steps = rng.uniform(30.0, 60.0, (10, 2))
    for k in range(600):
        r = steps[k // 60]
        y = x + 0.1 * rng.standard_normal(2)
        u = np.clip(LAW.C @ z + LAW.D @ y + LAW.E @ r + LAW.offset, LAW.low, LAW.high)
        z = LAW.A @ z + LAW.B @ y + LAW.F @ r
        rows.append(np.concatenate([r, y, u]))
        x = simulate_driven(TRUTH, np.tile(u, (2, 1)), states=x, period=PERIOD).outputs[
            1
        ]
    whole = np.array(rows)
    return Window(whole[:, :2], whole[:, 2:4], whole[:, 4:], period=PERIOD)


def matched() -> Candidate:
    window = driven().part(0, MATCHED - 1)
    fitted = match(window, start=Heaters.model().parameters(), law=None)
    assert fitted.status.value == "accepted", fitted.reason
    free, covariance = fitted.of_parameters()
    return Candidate("matched", 40.0, fitted.parameters, window, free, covariance)


@cache
def judged() -> tuple[Forecaster, dict[int, Outlook], list[float]]:
    """The forecaster after all samples, an outlook every hundred samples, and the shares inside bands."""
    forecaster = Forecaster(None, SETTINGS, period=PERIOD)
    outlooks = {}
    inside = []
    for sample in samples_of(driven()):
        forecaster.push(sample)
        if sample.index == MATCHED:
            forecaster.enter([Candidate("wrong", 40.0, WRONG, None), matched()])
        if sample.index > 600 and sample.index % 100 == 0:
            outlooks[sample.index] = forecaster.outlook("matched")
            check = forecaster.check_bands(60)
            assert check is not None
            assert np.isnan(check.miss_u)
            inside.append(check.inside_y)
    return forecaster, outlooks, inside


def test_who_has_the_right_physics_leads() -> None:
    forecaster, _, _ = judged()
    assert forecaster.leader == "matched"
    wrong, right = forecaster.scores
    assert right.gain > wrong.gain
    assert all(skill > 0.3 for skill in right.persistence_skill)
    assert all(
        right_skill > wrong_skill
        for right_skill, wrong_skill in zip(
            right.arx_skill[1:], wrong.arx_skill[1:], strict=True
        )
    )
    assert forecaster.confidence > 0.9


def test_each_output_has_a_band_of_its_own_that_holds() -> None:
    """Nine in ten of 150 samples ahead, from nine outlooks: σ of a share is about 0.05, as errors last."""
    _, outlooks, inside = judged()
    window = driven()
    shares = []
    widths = []
    for newest, outlook in outlooks.items():
        if newest + 150 >= COUNT:
            continue
        forecast = outlook.forecast(window.inputs[newest + 1 : newest + 151])
        assert [band.mean.shape for band in forecast.outputs] == [(150,), (150,)]
        assert [band.low.tolist() for band in forecast.inputs] == window.inputs[
            newest + 1 : newest + 151
        ].T.tolist()
        came = window.outputs[newest + 1 : newest + 151].T
        shares.append(
            [
                np.mean((b.low <= y) & (y <= b.high))
                for b, y in zip(forecast.outputs, came, strict=True)
            ]
        )
        widths.append([np.mean(b.high - b.low) for b in forecast.outputs])
    coverage = np.mean(shares, axis=0)
    assert ((coverage > 0.8) & (coverage < 0.99)).all(), coverage
    first, second = np.mean(widths, axis=0)
    assert second > 2.0 * first
    assert 0.75 < np.mean(inside) < 0.99


def test_a_note_names_the_output_that_leaves_what_was_visited() -> None:
    outlook = list(judged()[1].values())[-1]
    notes = outlook.forecast(np.tile([100.0, 0.0], (150, 1))).notes
    assert any(note.startswith("the forecast of first covers") for note in notes)
    assert any(
        "a constant input of 100 % and" in n or "the given inputs" in n for n in notes
    )
    with pytest.raises(
        SignalError,
        match="output: there are 2 of them; this is for a loop with one of each",
    ):
        _ = outlook.forecast(np.tile([50.0, 50.0], (5, 1))).output


def test_a_loop_with_several_signals_is_forecast_with_its_commands() -> None:
    window = closed()
    forecaster = Forecaster(LAW, SETTINGS)
    forecaster.enter(
        [Candidate("wrong", 40.0, WRONG, None), Candidate("right", 40.0, TRUTH, None)]
    )
    inside = []
    for sample in samples_of(window):
        forecaster.push(sample)
        if sample.index > 300 and sample.index % 60 == 0:
            check = forecaster.check_bands(60)
            assert check is not None
            inside.append((check.inside_y, check.inside_u))
    assert forecaster.leader == "right"
    assert (np.mean(inside, axis=0) > 0.75).all(), inside
    outlook = forecaster.outlook()
    ahead = np.tile(window.references[-1], (100, 1))
    forecast = outlook.forecast(ahead)
    begun = advance(TRUTH, outlook.states, outlook.sample.inputs, PERIOD)
    run = simulate_closed_loop(
        TRUTH, ahead, states=begun, law=LAW, controller=outlook.controller
    )
    np.testing.assert_allclose(
        [band.mean for band in forecast.outputs], run.outputs.T, atol=1e-9
    )
    np.testing.assert_allclose(
        [band.mean for band in forecast.inputs], run.inputs.T, atol=1e-9
    )
    for band, low, high in zip(forecast.inputs, LAW.low, LAW.high, strict=True):
        assert (band.low >= low).all()
        assert (band.high <= high).all()


def test_the_structure_that_the_samples_support_is_chosen() -> None:
    models = [Heaters.model("apart"), Heaters.model("all")]
    choice = choose_structure(driven().part(0, 599), models, law=None)
    assert choice.chosen == "all"
    apart, whole = choice.scores
    for free, error in zip(
        models[1].structure.free, whole.fitted.covariance.diagonal() ** 0.5, strict=True
    ):
        assert abs(choice.parameters[free] - TRUTH[free]) < 4.0 * error, free
    assert np.isnan(whole.fit[1])
    assert whole.fit[0] > 0.95 > apart.fit[0]
    assert whole.off < 0.5 * apart.off
    looped = choose_structure(closed(), models, law=LAW)
    assert looped.chosen == "all"
    assert len(looped.score.fitted.measured[0]) == 4
    assert min(looped.score.fit) > 0.8


def test_both_twins_run_beside_it() -> None:
    """A plant that is the twin leaves nothing, in closed loop nor driven."""
    steps = np.repeat([[45.0, 38.0], [55.0, 40.0]], 60, axis=0)
    run = simulate_closed_loop(TRUTH, steps, states=begin(TRUTH, [40.0, 35.0]), law=LAW)
    mirror = Mirror(TRUTH, LAW)
    wrong_mirror = Mirror(WRONG, None, period=PERIOD)
    for sample in samples_of(Window(steps, run.outputs, run.inputs, period=PERIOD)):
        state = mirror.push(sample)
        alone = wrong_mirror.push(sample)
        np.testing.assert_allclose(state.closed_output, sample.outputs, atol=1e-9)
        np.testing.assert_allclose(state.closed_input, sample.inputs, atol=1e-9)
        np.testing.assert_allclose(state.driven_residual_y, [0.0, 0.0], atol=1e-9)
    assert np.isnan([*alone.closed_output, *alone.closed_rms_u]).all()
    assert min(np.abs(alone.driven_rms_y)) > 0.1


def test_lost_samples_of_several_signals_count_nowhere() -> None:
    whole, lost = (Forecaster(None, SETTINGS, period=PERIOD) for _ in range(2))
    for forecaster in (whole, lost):
        forecaster.enter([Candidate("right", 40.0, TRUTH, None)])
    for sample in samples_of(driven().part(0, 500)):
        whole.push(sample)
        away = sample.index % 97 == 3
        values = tuple(y + 20.0 for y in sample.outputs)
        lost.push(
            Sample(
                sample.index,
                sample.stamp,
                sample.references,
                values,
                sample.inputs,
                seen=False,
            )
            if away
            else sample
        )
    np.testing.assert_allclose(lost.outlook().states, whole.outlook().states, atol=0.05)
    assert lost.scores[0].gain == pytest.approx(whole.scores[0].gain, abs=0.1)


def test_a_match_of_several_loops_is_called_as_precisely_as_its_signals_are_shown() -> (
    None
):
    first, second = Heaters.outputs.values()
    decimals = (first.decimals, second.decimals)
    assert max(decimals) <= 2
    name = name_at((54.73612, -1e-9), Heaters)
    assert name == f"{round(54.73612, decimals[0]):g} {first.unit}, 0 {second.unit}"
    assert "54.73612" not in name


def test_a_level_without_a_unit_ends_with_its_number() -> None:
    """A sentence continues behind it."""

    class Acid(Heaters, name="acid"):
        first = Output(unit="°C", noise=0.1, span=(0.0, 150.0))
        second = Output(unit="", noise=0.1, span=(0.0, 150.0))

    assert name_at((15.0, 7.0), Acid) == "15 °C, 7"
