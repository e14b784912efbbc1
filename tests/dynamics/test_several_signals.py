"""A plant with two inputs and two outputs: simulated, differentiated, linearised, matched and observed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tests.support.exchanging import Heaters
from tests.support.foresight import forecast_loop
from twinmatch.dynamics import (
    Experiment,
    LinearLaw,
    Observer,
    PidGains,
    PlantError,
    advance,
    begin,
    linearised,
    noise_scores,
    rest_at,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.fitting import match
from twinmatch.signals import SignalError, Window

Array = NDArray[np.float64]
MODEL = Heaters.model()
PLANT = MODEL.parameters()
LAW = LinearLaw(
    A=np.eye(2), B=-0.1 * np.eye(2), C=0.2 * np.eye(2), D=[[-4.0, 0.5], [0.3, -5.0]],
    E=[[4.0, -0.5], [-0.3, 5.0]], F=0.1 * np.eye(2), G=np.zeros((2, 2)), offset=[20.0, 15.0],
    shift=np.zeros(2), low=[0.0, 0.0], high=[100.0, 80.0], period=2.0,
)  # fmt: skip
"""Proportional and integral action with interaction, at limits after a step."""
SET_POINTS = np.repeat([[45.0, 38.0], [55.0, 40.0], [50.0, 48.0]], 60, axis=0)


def closed_loop() -> Window:
    run = simulate_closed_loop(
        PLANT, SET_POINTS, states=begin(PLANT, [40.0, 35.0]), law=LAW
    )
    return Window(SET_POINTS, run.outputs, run.inputs, period=2.0)


def driven(noise: float = 0.0) -> Window:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(0.0, 60.0, (12, 2)), 25, axis=0)
    run = simulate_driven(PLANT, u, states=begin(PLANT, [23.0, 23.0]), period=2.0)
    y = run.outputs + noise * rng.standard_normal(run.outputs.shape)
    return Window(np.zeros((len(u), 2)), y, u, period=2.0)


def test_it_is_simulated_like_by_scipy() -> None:
    window = driven()
    rates = Heaters.rates_of(dict(PLANT))
    x = begin(PLANT, window.outputs[0], input=[0.0, 0.0])
    for k in range(120):
        np.testing.assert_allclose(window.outputs[k], x, atol=1e-6)
        x = solve_ivp(
            lambda _, at, u=window.inputs[k]: rates(at, u),
            (0.0, 2.0),
            x,
            rtol=1e-10,
            atol=1e-10,
        ).y[:, -1]


@pytest.mark.parametrize("closed", [True, False])
def test_tangents_are_those_of_differences(closed: bool) -> None:
    window = closed_loop() if closed else driven()
    experiment = Experiment(PLANT, MODEL.names, window, law=LAW if closed else None)
    values = experiment.values_of(PLANT)
    exact = experiment.tangents(values)
    assert exact.by.shape == (4, len(window) - 2, len(MODEL.names))
    signals = 4 if closed else 2
    for j, name in enumerate(MODEL.names):
        step = np.zeros(values.size)
        step[j] = 1e-6 * abs(values[j])
        up, down = (experiment.simulate(values + sign * step) for sign in (1.0, -1.0))
        both = [
            np.concatenate([run.outputs, run.inputs], axis=1).T for run in (up, down)
        ]
        differences = ((both[0] - both[1]) / (2.0 * step[j]))[:signals]
        size = np.max(np.abs(differences), axis=1, keepdims=True)
        # A difference may straddle a sample at which a command leaves its limit; the derivative does not.
        differs = np.abs(exact.by[:signals, :, j] - differences) > 1e-5 * size
        assert np.mean(differs) < 0.02, name
    cost, gradient, hessian = experiment.normal(values)
    residuals = (
        np.concatenate([exact.outputs, exact.inputs], axis=1).T[:signals]
        - experiment.measured[:signals]
    )
    jacobian = exact.by[:signals].reshape(-1, values.size)
    assert cost == pytest.approx(np.sum(residuals**2), abs=1e-18)
    np.testing.assert_allclose(hessian, jacobian.T @ jacobian, rtol=1e-9)
    np.testing.assert_allclose(gradient, jacobian.T @ residuals.ravel(), atol=1e-9)


def test_its_linearisation_is_the_matrix_exponential() -> None:
    at_rest = rest_at(PLANT, [45.0, 38.0])
    linear = linearised(PLANT, [45.0, 38.0], 2.0)
    np.testing.assert_allclose(
        advance(PLANT, at_rest.states, at_rest.inputs, 2.0), at_rest.states, atol=1e-9
    )
    rates = Heaters.rates_of(dict(PLANT))
    point = np.append(at_rest.states, at_rest.inputs)
    slopes = np.zeros((4, 4))
    for j in range(4):
        moved = 1e-4 * np.eye(4)[j]
        up, down = (
            rates((point + way)[:2], (point + way)[2:]) for way in (moved, -moved)
        )
        slopes[:2, j] = (np.array(up) - np.array(down)) / 2e-4
    whole = expm(2.0 * slopes)
    np.testing.assert_allclose(linear.A, whole[:2, :2], atol=1e-7)
    np.testing.assert_allclose(linear.B, whole[:2, 2:], atol=1e-7)
    np.testing.assert_array_equal(linear.C, np.eye(2))
    with pytest.raises(
        SignalError, match="input: there are 2 of them; this is for a loop"
    ):
        _ = at_rest.input


def test_driven_it_is_matched() -> None:
    """The estimates are within four standard errors of the truth, and those are the errors of 30 draws."""
    start = PLANT.replace(exchange=0.2, first_gain=0.1)
    matched = match(driven(0.1), start=start, law=None)
    assert matched.accepted, matched.reason
    for j, name in enumerate(matched.free):
        assert (
            abs(matched.parameters[name] - PLANT[name])
            < 4.0 * matched.standard_errors[j]
        ), name
    assert matched.chi2 == pytest.approx(1.0, abs=0.15)  # 598 residuals: σ = 0.06


def test_the_noise_of_each_reading_is_followed_around_the_loop() -> None:
    """The sums are linear in the noise: their variance over random draws is that which is computed."""
    window = closed_loop().part(10, 70)
    experiment = Experiment(PLANT, ("exchange", "second_gain"), window, law=LAW)
    tangents = experiment.tangents(experiment.values_of(PLANT))
    weights = np.array([[1.0, 0.5, 0.02, 0.02], [2.0, 1.0, 0.04, 0.04]])
    references = np.array(window.references[2:])
    sums, square = noise_scores(
        experiment, tangents, tangents.by * weights[0][:, None, None], weights
    )
    assert sums.shape == (2 * len(tangents.outputs), 2)
    assert math.isfinite(square)
    # The second output's noise, at one sample, through a run that is disturbed there.
    k = 20
    bump = 1e-5
    law = LAW.code
    states = begin(PLANT, window.outputs[2], input=window.inputs[1])
    changes = []
    for sign in (1.0, -1.0):
        noise = np.zeros((len(window) - 2, 2))
        noise[k, 1] = sign * bump
        y, u, _ = MODEL.kernels.run(
            PLANT.vector, states, law, experiment.controller, references,
            np.zeros((len(noise), 0)), noise, np.zeros(len(noise), dtype=np.bool_), 0.0, 2.0,
            PLANT.steps(2.0),
        )  # fmt: skip
        changes.append(np.concatenate([y, u], axis=1).T)
    change = (changes[0] - changes[1]) / (2.0 * bump) * weights[1][:, None]
    expected = np.einsum("cj,cjp->p", change, tangents.by * weights[0][:, None, None])
    np.testing.assert_allclose(sums[2 * k + 1], expected, rtol=1e-5, atol=1e-9)


def test_it_is_observed_like_by_the_textbooks_filter() -> None:
    """Both readings at once with matrices, against one after the other in compiled code."""
    window = driven(0.1)
    observer = Observer(
        PLANT, window.outputs[0], period=2.0, drift=[0.05, 0.05], start=[1.0, 2.0]
    )
    states = observer.states
    covariance = observer.covariance
    noise = np.diag(MODEL.noise**2)
    for k in range(60):
        innovation_covariance = covariance + noise
        gain = covariance @ np.linalg.inv(innovation_covariance)
        states = states + gain @ (window.outputs[k] - states)
        covariance = (np.eye(2) - gain) @ covariance
        innovations, variances = observer.correct(window.outputs[k])
        assert np.log(variances).sum() == pytest.approx(
            np.linalg.slogdet(innovation_covariance)[1], rel=1e-9
        )
        assert innovations.shape == (2,)
        np.testing.assert_allclose(observer.states, states, rtol=1e-9)
        np.testing.assert_allclose(observer.covariance, covariance, rtol=1e-7)
        slopes = MODEL.kernels.predict(
            PLANT.vector, states.copy(), np.zeros((2, 2)), np.zeros(2), np.array(window.inputs[k]), np.zeros(0), 2.0,
            PLANT.steps(2.0), np.zeros((2, 0), dtype=np.int64),
        )  # fmt: skip
        states = advance(PLANT, states, window.inputs[k], 2.0)
        covariance = slopes[:, :2] @ covariance @ slopes[
            :, :2
        ].T + 0.05**2 * 2.0 * np.eye(2)
        observer.predict(window.inputs[k])


def test_its_forecast_has_the_spread_of_random_runs() -> None:
    at_rest = rest_at(PLANT, [60.0, 55.0])
    size = 40
    reference = np.tile([60.0, 55.0], (size, 1))
    reference[:, 0] += 1.0
    integral = np.linalg.solve(LAW.C, at_rest.inputs - LAW.offset)
    common = {"states": at_rest.states, "law": LAW, "controller": integral}
    forecast = forecast_loop(
        PLANT,
        covariance=np.diag([0.04, 0.09]),
        input=at_rest.inputs,
        drift=[0.02, 0.03],
        reference=reference,
        **common,
    )
    run = simulate_closed_loop(
        PLANT, reference, states=at_rest.states, law=LAW, controller=integral
    )
    np.testing.assert_allclose(forecast.outputs, run.outputs, atol=1e-9)
    rng = np.random.default_rng(3)
    runs = []
    strays = np.array([0.02, 0.03]) * math.sqrt(2.0)
    for _ in range(400):
        x = at_rest.states + rng.standard_normal(2) * [0.2, 0.3]
        x = advance(PLANT, x, at_rest.inputs, 2.0) + rng.standard_normal(2) * np.array(
            [0.02, 0.03]
        ) * math.sqrt(2)
        z = integral
        rows = []
        for k in range(size):
            y = x + 0.1 * rng.standard_normal(2)
            u = np.clip(
                LAW.C @ z + LAW.D @ y + LAW.E @ reference[k] + LAW.offset,
                LAW.low,
                LAW.high,
            )
            z = LAW.A @ z + LAW.B @ y + LAW.F @ reference[k]
            rows.append(np.append(y, u))
            x = advance(PLANT, x, u, 2.0) + rng.standard_normal(2) * strays
        runs.append(rows)
    spread = np.var(np.array(runs), axis=0).T
    # A variance of 400 draws is known to 7 %: four of these, over the mean of a signal's samples.
    ratio = np.mean(spread / forecast.variances, axis=1)
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_what_is_for_one_loop_says_so() -> None:
    with pytest.raises(
        PlantError,
        match=r"it has 2 outputs \(first, second\); this is for plants with one",
    ):
        _ = Heaters.output
    with pytest.raises(
        SignalError,
        match="output: there are 2 of them; this is for a loop with one of each",
    ):
        _ = driven().output
    with pytest.raises(
        PlantError, match="for 1 outputs and 1 inputs is given; the plant has 2 and 2"
    ):
        simulate_closed_loop(
            PLANT,
            SET_POINTS,
            states=begin(PLANT, [23.0, 23.0]),
            law=PidGains(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
        )
    with pytest.raises(
        PlantError, match=r"input has shape \(3,\); give 2 values per sample"
    ):
        simulate_driven(PLANT, [1.0, 2.0, 3.0], states=begin(PLANT, [23.0, 23.0]))
    with pytest.raises(PlantError, match="1 outputs given; give first, second"):
        begin(PLANT, 23.0)
