"""What is made of equations: against code written by hand, differences, and closed solutions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.plants import Lag, Motor, Tank
from twinmatch.dynamics import (
    FROM_PLANT_FILE,
    Experiment,
    Parameters,
    PlantError,
    Sensor,
    advance,
    begin,
    noise_scores,
    read,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.plants import Peltier
from twinmatch.signals import Window

MOTOR = Motor.model("with friction")
RICHEST = Peltier.model(
    "sink with mass, free ambient, switched drive, sensor lag, α(T)"
)


@given(
    gain=st.floats(0.1, 10.0),
    lag=st.floats(0.5, 50.0),
    x=st.floats(-40.0, 40.0),
    u=st.floats(-10.0, 10.0),
)
def test_a_lag_is_an_exponential(gain: float, lag: float, x: float, u: float) -> None:
    p = Lag.model().parameters(gain=gain, lag=lag)
    exact = gain * u + (x - gain * u) * math.exp(-1.0 / lag)
    assert advance(p, np.array([x]), u, 1.0)[0] == pytest.approx(
        exact, abs=1e-6 * (1 + abs(x - gain * u))
    )


def motor_run(p: Parameters, samples: int = 240, seed: int | None = 5) -> Window:
    """A motor that speeds up, stands, turns back, under a load that comes and goes."""
    reference = np.repeat([50.0, 150.0, -80.0], samples // 3)
    load = np.where(np.arange(samples) % 80 < 40, 0.0, 0.03)[:, None]
    sensor = None if seed is None else Sensor(noise=0.2).realise(samples, 0.05, seed)
    run = simulate_closed_loop(
        p,
        reference,
        states=begin(p, 0.0),
        law=Motor.loop,
        disturbances=load,
        sensor=sensor,
    )
    return Window(reference, run.output, run.input, period=0.05, disturbances=load)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("model", [MOTOR, RICHEST], ids=["motor", "Peltier"])
def test_tangents_are_those_of_differences(model: object, closed: bool) -> None:
    """By parameters and by starts, in the loop and driven, through limiters and friction."""
    if model is MOTOR:
        base = MOTOR.parameters()
        starts = ("omega",)
        window = motor_run(base)
    else:
        base = RICHEST.parameters(current_limit=3.0)
        starts = ("sink",)
        reference = np.repeat([30.0, 75.0, 40.0], 80)
        run = simulate_closed_loop(base, reference, states=begin(base, 25.0))
        window = Window(reference, run.output, run.input)
    free = [*base.model.structure.free, base.model.names[-1]]
    experiment = Experiment(
        base, free, window, free_starts=starts, law=FROM_PLANT_FILE if closed else None
    )
    values = experiment.values_of(base)
    exact = experiment.tangents(values)
    # The derivatives share subexpressions with the rates, which rounds them another way.
    np.testing.assert_allclose(
        exact.outputs[:, 0], experiment.simulate(values).output, rtol=1e-12
    )
    for j, name in enumerate([*free, *starts]):
        scale = base.model.declared[name].scale if j < len(free) else 1.0
        step = np.zeros(values.size)
        step[j] = 1e-6 * scale
        up = experiment.simulate(values + step)
        down = experiment.simulate(values - step)
        for row, (a, b) in enumerate(
            ((up.output, down.output), (up.input, down.input))
        ):
            differences = (a - b) / (2 * step[j])
            size = np.max(np.abs(exact.by[row, :, j])) + 1e-6
            # Differences may straddle a sample at which u leaves its limit; the derivative does not.
            differs = np.abs(differences - exact.by[row, :, j]) > 2e-4 * size
            assert np.mean(differs) < 0.02, name


@settings(max_examples=20)
@given(k=st.floats(0.02, 0.2), j=st.floats(1e-4, 2e-3), robust=st.booleans())
def test_the_normal_equations_are_those_of_the_arrays(
    k: float, j: float, robust: bool
) -> None:
    window = motor_run(MOTOR.parameters())
    weights = np.array([5.0, 3.0])
    experiment = Experiment(
        MOTOR.parameters(),
        ("k", "j", "b"),
        window,
        weights=(5.0, 3.0),
        robust=robust,
        settle=10,
    )
    values = np.array([k, j, 1e-4])
    tangents = experiment.tangents(values)
    residuals = (
        np.stack([tangents.outputs[:, 0], tangents.inputs[:, 0]]) - experiment.measured
    )[:, 10:] * weights[:, None]
    jacobian = (tangents.by[:, 10:] * weights[:, None, None]).reshape(-1, 3)
    root = np.sqrt(1.0 + residuals**2) if robust else np.ones_like(residuals)
    expected = np.sum(2.0 * (root - 1.0)) if robust else np.sum(residuals**2)
    cost, gradient, hessian = experiment.normal(values)
    assert cost == pytest.approx(expected, rel=1e-9)
    weighed = jacobian / root.reshape(-1, 1)
    np.testing.assert_allclose(
        gradient,
        weighed.T @ residuals.ravel(),
        rtol=1e-7,
        atol=1e-7 * np.max(np.abs(gradient)),
    )
    np.testing.assert_allclose(hessian, weighed.T @ jacobian, rtol=1e-8)


def test_a_run_ends_where_its_cost_is_above_the_most() -> None:
    window = motor_run(MOTOR.parameters())
    experiment = Experiment(MOTOR.parameters(), ("k", "j", "b"), window)
    values = np.array([0.1, 1e-3, 1e-4])
    cost, _, hessian = experiment.normal(values)
    most = 0.1 * cost
    cost_until_there, _, hessian_until_there = experiment.normal(values, most)
    assert most < cost_until_there < 0.5 * cost
    assert np.all(np.diag(hessian_until_there) < np.diag(hessian))
    assert experiment.normal(values, cost)[0] == cost


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("plant", ["motor", "sink", "tank"])
def test_noise_goes_round_the_loop(closed: bool, plant: str) -> None:
    """Sums over all samples at once, against the response to the noise of each sample by differences."""
    if plant == "motor":
        base = MOTOR.parameters(most=3.0)
        law = Motor.loop
        window = motor_run(base, 90, None)
    elif plant == "tank":
        base = Tank.model().parameters()
        law = Tank.loop
        reference = np.repeat([1.2, 0.6], 45)
        run = simulate_closed_loop(base, reference, states=begin(base, 1.0))
        window = Window(reference, run.output, run.input)
    else:
        base = Peltier.model("sink with mass").parameters()
        law = Peltier.loop
        reference = np.repeat([30.0, 36.0], 45)
        run = simulate_closed_loop(base, reference, states=begin(base, 25.0))
        window = Window(reference, run.output, run.input)
    weights = (1.0, 0.02)
    experiment = Experiment(
        base,
        base.model.structure.free,
        window,
        law=law if closed else None,
        weights=weights,
    )
    tangents = experiment.tangents(experiment.values_of(base))
    weighed = tangents.by * np.array(weights)[:, None, None]
    sums, mean_square = noise_scores(experiment, tangents, weighed, np.array([weights]))

    size = len(tangents.outputs)
    bump = 1e-4
    load = window.disturbances[2:]

    def response(noise: np.ndarray, first: float) -> np.ndarray:
        """Output and input of a loop with this noise of the readings and this first reading."""
        states = begin(base, window.output[2] + first, disturbances=load[0])
        if not closed:
            run = simulate_driven(
                base,
                window.input[2:],
                states=states,
                period=window.period,
                disturbances=load,
            )
            return np.stack([run.output + noise, np.zeros(size)])
        sensor = Sensor().realise(size, window.period, 0)
        object.__setattr__(sensor, "noise", noise)
        run = simulate_closed_loop(
            base, window.reference[2:], states=states, controller=experiment.controller, law=law,
            disturbances=load, sensor=sensor,
        )  # fmt: skip
        return np.stack([run.output, run.input])

    expected = np.zeros_like(sums)
    squares = 0.0
    for k in range(size):
        noise = np.zeros(size)
        noise[k] = bump
        change = (response(noise, 0.0) - response(-noise, 0.0)) / (2 * bump)
        if k == 0:
            # The twin starts at the same reading: what is left is the plant's own way from there.
            change -= (
                response(np.zeros(size), bump) - response(np.zeros(size), -bump)
            ) / (2 * bump)
        scaled = change * np.array(weights)[:, None]
        expected[k] = np.einsum("cj,cjp->p", scaled, weighed)
        squares += np.sum(scaled**2)
    np.testing.assert_allclose(sums, expected, atol=1e-4 * np.max(np.abs(expected)))
    assert mean_square == pytest.approx(
        squares / ((2 if closed else 1) * size), rel=1e-4
    )


def test_disturbances_act_and_are_checked() -> None:
    p = MOTOR.parameters()
    free, loaded = (
        advance(p, np.array([100.0]), 6.0, 0.05, np.array([load]))
        for load in (0.0, 0.1)
    )
    assert loaded[0] < free[0]
    assert advance(p, np.array([100.0]), 6.0, 0.05)[0] == free[0]
    with pytest.raises(
        PlantError,
        match=r"disturbances \[1\.0, 2\.0\] given; give 1 finite values \(load\)",
    ):
        read(p, np.array([100.0]), np.array([1.0, 2.0]))
    with pytest.raises(
        PlantError,
        match=r"shape \(3, 2\) given; give 1 finite values \(load\) at each of 5",
    ):
        simulate_driven(
            p,
            np.zeros(5),
            states=begin(p, 0.0),
            period=0.05,
            disturbances=np.zeros((3, 2)),
        )


def test_what_cannot_be_run_is_refused() -> None:
    p = MOTOR.parameters()
    still = np.zeros(1)
    short = Sensor().realise(2, 0.05, 1)
    for message, run in (
        ("reference is nan at sample 1", lambda: simulate_closed_loop(p, [40.0, math.nan], states=still)),
        ("input has shape .1, 2.; give one value", lambda: simulate_driven(p, [[40.0, 1.0]], states=still)),
        ("the period is 0 s", lambda: simulate_driven(p, [4.0], states=still, period=0)),
        ("the input is inf", lambda: advance(p, still, math.inf, 0.05)),
        ("the reading is nan", lambda: begin(p, math.nan)),
        ("no state 'sink'; it has omega", lambda: begin(p, 0.0, starts={"sink": 1.0})),
        ("realised for 2 samples; realise it for 3",
         lambda: simulate_closed_loop(p, [1.0, 2.0, 3.0], states=still, sensor=short)),
        ("time constant is too short for a period of 10000 s", lambda: advance(p, still, 0.0, 1e4)),
        ("plant lag: its controller is not known",
         lambda: simulate_closed_loop(Lag.model().parameters(), [1.0], states=still)),
    ):  # fmt: skip
        with pytest.raises(PlantError, match=message):
            run()
