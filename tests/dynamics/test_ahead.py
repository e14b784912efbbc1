"""What is forecast of a loop, against simulations of it with everything unsure drawn at random."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.foresight import forecast_loop
from tests.support.plants import Lag, Motor, Tank
from twinmatch.compiled import compiled
from twinmatch.dynamics import (
    LoopForecast,
    Parameters,
    PidGains,
    PidState,
    PlantError,
    advance,
    begin,
    law_of,
    rest_at,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.dynamics.kernels import OUTPUTS, call, tick, work_for
from twinmatch.dynamics.laws import NO_LAW, law_step
from twinmatch.plants import Peltier

Array = Any
HELD = Peltier.model("held sink, free ambient")
MASSIVE = Peltier.model("sink with mass, free ambient, switched drive")
MOTOR = Motor.model("with friction")
RUNS = 1500


@compiled
def noisy_run(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    code,
    vector,
    states,
    first,
    usual,
    law,
    memory,
    references,
    noise,
    strays,
    period,
    steps,
):
    """Readings and commands of a loop whose states stray at every sample."""
    work = work_for(code, vector)
    u = np.empty(1)
    z = memory.copy()
    after = memory.copy()
    y = np.empty(1)
    both = np.empty((2, len(references)))
    tick(code, states, first, usual, work, period, steps)
    for k in range(len(references)):
        states += strays[k]
        call(code[OUTPUTS], states, states, usual, work.p, work.b, y)
        y += noise[k]
        law_step(law, z, references, k, y, u, after)
        z[:] = after
        both[0, k] = y[0]
        both[1, k] = u[0]
        tick(code, states, u, usual, work, period, steps)
    return both


def drawn_at_random(case: Case, inputs: Array | None) -> Array:
    """Readings and commands of many runs of the nonlinear loop, shape (2, runs, N)."""
    base, unsure, joint, drift, first, gains, reference = case
    rng = np.random.default_rng(11)
    n = len(base.model.states)
    size = reference.size
    law, memory = (
        (gains.code, np.array(first["controller"]))
        if inputs is None
        else (NO_LAW, np.zeros(0))
    )
    references = (reference if inputs is None else inputs)[:, None]
    spread = np.asarray(drift) * math.sqrt(gains.period)
    drawn = np.empty((2, RUNS, size))
    for run, moved in enumerate(
        rng.multivariate_normal(np.zeros(joint.shape[0]), joint, RUNS)
    ):
        plant = base.replace(
            **{name: base[name] + moved[n + j] for j, name in enumerate(unsure)}
        )
        strays = spread * rng.standard_normal((size, n))
        noise = base.model.plant.output.noise * rng.standard_normal(size)
        drawn[:, run] = base.model.kernels.call(
            noisy_run, plant.vector, first["states"] + moved[:n], np.array([first["input"]]),
            base.model.disturbances, law, memory, references, noise, strays, gains.period,
            plant.steps(gains.period),
        )  # fmt: skip
    return drawn


def scattered(
    unsure: Sequence[str], base: Parameters, states: Array, share: float
) -> Array:
    """A joint covariance in which everything has to do with everything; parameters are known to a share."""
    rng = np.random.default_rng(5)
    sizes = np.array(
        [*states, *(share * base.model.declared[name].scale for name in unsure)]
    )
    mixed = rng.standard_normal((sizes.size, 2 * sizes.size))
    correlated = mixed @ mixed.T
    root = np.sqrt(np.diag(correlated))
    return correlated / np.outer(root, root) * np.outer(sizes, sizes)


Case = tuple[Parameters, list[str], Array, Array, dict[str, Any], PidGains, Array]


def peltier_case(model: Any) -> Case:
    base = model.parameters()
    unsure = ["seebeck", "conductance", "heat_capacity", "ambient"]
    n = len(model.states)
    joint = scattered(unsure, base, [0.05, 0.3][:n], 0.02)
    at_rest = rest_at(base, 45.0)
    first = {
        "states": at_rest.states,
        "input": at_rest.input,
        "controller": PidState(at_rest.input, 0.0),
    }
    reference = np.concatenate([np.full(40, 45.0), np.full(110, 47.0)])
    return (
        base,
        unsure,
        joint,
        np.array([0.02, 0.03][:n]),
        first,
        law_of(Peltier, 1.0),
        reference,
    )


def motor_case(share: float = 0.02, high: float = 24.0) -> Case:
    base = MOTOR.parameters()
    unsure = ["k", "j", "dry"]
    joint = scattered(unsure, base, [0.3], share)
    at_rest = rest_at(base, 100.0)
    first = {
        "states": at_rest.states,
        "input": at_rest.input,
        "controller": PidState(at_rest.input, 0.0),
    }
    gains = dataclasses.replace(law_of(Motor, 0.05), high=high)
    return (
        base,
        unsure,
        joint,
        np.array([0.5]),
        first,
        gains,
        np.repeat([100.0, 130.0], 60),
    )


def tank_case() -> Case:
    base = Tank.model().parameters()
    unsure = ["hole", "area"]
    at_rest = rest_at(base, 1.2)
    first = {
        "states": at_rest.states,
        "input": at_rest.input,
        "controller": PidState(at_rest.input, 0.0),
    }
    gains = law_of(Tank, 1.0)
    joint = scattered(unsure, base, [0.03], 0.01)
    return (
        base,
        unsure,
        joint,
        np.array([0.03]),
        first,
        gains,
        np.repeat([1.2, 1.5], [20, 60]),
    )


def foretold(case: Case, inputs: Array | None) -> LoopForecast:
    """The same by small movements."""
    base, unsure, joint, drift, first, gains, reference = case
    loop = (
        {"reference": reference, "law": gains} if inputs is None else {"inputs": inputs}
    )
    return forecast_loop(
        base, covariance=joint, drift=drift, unsure=unsure, period=gains.period, **first, **loop,
    )  # fmt: skip


def agree(drawn: Array, mean: Array, variance: Array, most: float = 0.15) -> None:
    """A variance of 1500 runs is good to 3.7 % (one standard deviation); a run's samples stray together."""
    ratio = drawn.var(axis=0) / variance
    assert np.all(np.abs(ratio - 1.0) < 0.18)
    assert ratio.mean() == pytest.approx(1.0, abs=0.11)
    mean_errors = np.abs(drawn.mean(axis=0) - mean) / np.sqrt(variance)
    assert np.max(mean_errors) < most  # 4/√1500, and what curvature adds


@pytest.mark.parametrize(
    "case",
    [lambda: peltier_case(HELD), lambda: peltier_case(MASSIVE), motor_case, tank_case],
    ids=["held sink", "sink with mass", "motor", "tank"],
)
def test_the_variances_are_those_of_many_runs(case: Any) -> None:
    forecast = foretold(case(), None)
    readings, commands = drawn_at_random(case(), None)
    agree(readings, forecast.outputs[:, 0], forecast.output_variances[:, 0])
    agree(commands, forecast.inputs[:, 0], forecast.input_variances[:, 0])


def test_they_are_for_inputs_that_are_known() -> None:
    case = peltier_case(MASSIVE)
    inputs = np.repeat([60.0, -20.0, 90.0], 50)
    forecast = foretold(case, inputs)
    agree(
        drawn_at_random(case, inputs)[0],
        forecast.outputs[:, 0],
        forecast.output_variances[:, 0],
    )
    np.testing.assert_array_equal(forecast.input_variances[:, 0], 0.0)


def test_they_are_where_the_controller_is_on_its_limit() -> None:
    """A step that drives u to its limit; at the sample after that some runs are on it and others are not,
    which costs their mean a third of a standard deviation."""
    case = motor_case(share=0.003, high=7.5)
    forecast = foretold(case, None)
    readings, commands = drawn_at_random(case, None)
    agree(readings, forecast.outputs[:, 0], forecast.output_variances[:, 0], most=0.4)
    limited = forecast.inputs[:, 0] == case[5].high
    assert limited.sum() >= 3
    np.testing.assert_array_equal(forecast.input_variances[:, 0][limited], 0.0)
    clear = case[5].high - forecast.inputs[:, 0] > 4.0 * np.sqrt(
        forecast.input_variances[:, 0]
    )
    agree(
        commands[:, clear],
        forecast.inputs[:, 0][clear],
        forecast.input_variances[:, 0][clear],
        most=0.4,
    )


@pytest.mark.parametrize("structure", list(Peltier.structures))
def test_the_mean_is_the_simulation_to_the_last_bit(structure: str) -> None:
    rig = Peltier.model(structure).parameters()
    states = begin(rig, 30.0)
    memory = PidState(20.0, 1.0)
    reference = np.repeat([35.0, 60.0, 40.0], 30)
    n = states.size
    forecast = forecast_loop(
        rig, states=states, covariance=np.eye(n), input=50.0, drift=np.ones(n), reference=reference,
        controller=memory,
    )  # fmt: skip
    run = simulate_closed_loop(
        rig, reference, states=advance(rig, states, 50.0, 1.0), controller=memory
    )
    np.testing.assert_array_equal(forecast.outputs[:, 0], run.output)
    np.testing.assert_array_equal(forecast.inputs[:, 0], run.input)
    driven = forecast_loop(
        rig, states=states, covariance=np.eye(n), input=50.0, drift=np.ones(n), inputs=run.input
    )  # fmt: skip
    np.testing.assert_array_equal(driven.outputs[:, 0], run.output)
    np.testing.assert_array_equal(driven.inputs[:, 0], run.input)


def test_disturbances_ahead_act_from_the_newest_sample_on() -> None:
    motor = MOTOR.parameters()
    states = np.array([100.0])
    loads = np.linspace(0.0, 0.05, 61)[:, None]
    given_ = {
        "states": states,
        "covariance": np.eye(1),
        "input": 6.0,
        "drift": [0.1],
        "law": Motor.loop,
    }
    forecast = forecast_loop(
        motor, reference=np.full(60, 100.0), disturbances=loads, **given_
    )
    next_states = advance(motor, states, 6.0, 0.05, loads[0])
    run = simulate_closed_loop(
        motor,
        np.full(60, 100.0),
        states=next_states,
        law=Motor.loop,
        disturbances=loads[1:],
    )
    np.testing.assert_array_equal(forecast.outputs[:, 0], run.output)
    with_value = forecast_loop(
        motor, reference=np.full(60, 100.0), disturbances=[0.02], **given_
    )
    with_rows = forecast_loop(
        motor,
        reference=np.full(60, 100.0),
        disturbances=np.full((61, 1), 0.02),
        **given_,
    )
    for by_value, by_rows in zip(with_value, with_rows, strict=True):
        np.testing.assert_array_equal(by_value, by_rows)


@pytest.mark.parametrize("swift", [0.0, 0.3])
def test_a_linear_loop_is_its_matrices(swift: float) -> None:
    """A lag under PI control: the covariance of the whole loop by the textbook, sample by sample; what it
    moves in a sample is wrong by `swift` of it."""
    lag = Lag.model().parameters(gain=1.0, lag=4.0)
    law = PidGains(0.5, 0.2, 0.0, 1.0, -10.0, 10.0)
    noise = 0.05
    drift = 0.03
    first = 0.4
    forecast = forecast_loop(
        lag, states=np.zeros(1), covariance=[[first**2]], input=0.0, drift=[drift], reference=np.ones(400),
        law=law, noise=noise, swift=swift,
    )  # fmt: skip
    strays = swift * np.diff(forecast.outputs[:, 0], append=1.0)
    a = math.exp(-1.0 / 4.0)
    b = 1.0 - a
    loop = np.array([[a - b * 0.5, b], [-0.2, 1.0]])  # of x and the integral
    enters = np.array([-b * 0.5, -0.2])
    q = noise**2 * np.outer(enters, enters) + np.diag([drift**2, 0.0])
    z = np.diag([(a * first) ** 2 + drift**2, 0.0])
    of_u = np.array([-0.5, 1.0])
    for k in range(400):
        assert forecast.output_variances[:, 0][k] == pytest.approx(
            z[0, 0] + noise**2, rel=1e-5
        )
        assert forecast.input_variances[:, 0][k] == pytest.approx(
            of_u @ z @ of_u + 0.25 * noise**2, rel=1e-5
        )
        z = loop @ z @ loop.T + q + np.diag([strays[k] ** 2, 0.0])
    settled = scipy.linalg.solve_discrete_lyapunov(loop, q)
    assert forecast.output_variances[:, 0][-1] == pytest.approx(
        settled[0, 0] + noise**2, rel=1e-5
    )


@settings(max_examples=20)
@given(
    level=st.floats(25.0, 90.0),
    size=st.integers(1, 80),
    scale=st.floats(0.0, 3.0),
    closed=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_what_is_sure_has_no_variance_and_more_doubt_has_more(
    level: float, size: int, scale: float, closed: bool, seed: int
) -> None:
    rig = MASSIVE.parameters()
    unsure = ["conductance", "sink_convection"]
    signal = (
        {"reference": np.full(size, level)}
        if closed
        else {"inputs": np.full(size, level)}
    )
    root = scale * np.random.default_rng(seed).standard_normal((4, 4))

    def forecast_of(covariance: Array, drift: float, noise: float) -> LoopForecast:
        return forecast_loop(
            rig, states=begin(rig, 30.0), covariance=covariance, input=10.0, drift=[drift, drift],
            unsure=unsure, noise=noise, **signal,
        )  # fmt: skip

    sure = forecast_of(np.zeros((4, 4)), 0.0, 0.0)
    np.testing.assert_array_equal(sure.output_variances[:, 0], 0.0)
    np.testing.assert_array_equal(sure.input_variances[:, 0], 0.0)
    less_doubt = forecast_of(root @ root.T, 0.0, 0.0)
    more_doubt = forecast_of(root @ root.T + 0.1 * np.eye(4), 0.01, 0.1)
    for lower, higher in (
        (less_doubt.output_variances[:, 0], more_doubt.output_variances[:, 0]),
        (less_doubt.input_variances[:, 0], more_doubt.input_variances[:, 0]),
    ):
        assert np.all(lower >= 0.0)
        assert np.all(higher >= lower * (1 - 1e-9))
    np.testing.assert_array_equal(less_doubt.outputs[:, 0], more_doubt.outputs[:, 0])
    if not closed:
        np.testing.assert_array_equal(more_doubt.input_variances[:, 0], 0.0)
    # the reading's own noise counts
    assert np.all(more_doubt.output_variances[:, 0] >= 0.01)


def test_what_cannot_be_forecast_is_refused() -> None:
    rig = MASSIVE.parameters()

    def forecast_with(**changes: Any) -> LoopForecast:
        arguments = {
            "states": begin(rig, 30.0), "covariance": np.eye(2), "input": 0.0, "drift": [0.1, 0.1],
            "reference": np.full(5, 40.0),
        }  # fmt: skip
        return forecast_loop(rig, **{**arguments, **changes})

    for changes, message in (
        ({"unsure": ["mass"]}, "no parameter 'mass'; there are"),
        (
            {"unsure": ["ambient"]},
            "covariance of shape (2, 2) given; give finite values of shape (3, 3)",
        ),
        (
            {"reference": [40.0, math.nan]},
            "set-points is nan at sample 1; only finite values can be used",
        ),
        (
            {"states": np.zeros(1)},
            "states of shape (1,) given; give finite values of shape (2,)",
        ),
        ({"drift": [0.1]}, "drift of shape (1,) given"),
        ({"input": math.inf}, "newest input with a value that is not finite given"),
    ):
        with pytest.raises(PlantError, match=re.escape(message)):
            forecast_with(**changes)
    with pytest.raises(PlantError, match="plant lag: its controller is not known"):
        forecast_loop(
            Lag.model().parameters(), states=np.zeros(1), covariance=np.eye(1), input=0.0, drift=[0.1],
            reference=np.ones(3),
        )  # fmt: skip


def test_nothing_that_is_given_is_changed() -> None:
    rig = MASSIVE.parameters()
    states = begin(rig, 30.0)
    covariance = np.eye(2)
    reference = np.full(9, 40.0)
    forecast_loop(
        rig,
        states=states,
        covariance=covariance,
        input=9.0,
        drift=[0.1, 0.1],
        reference=reference,
    )
    np.testing.assert_array_equal(states, begin(rig, 30.0))
    np.testing.assert_array_equal(covariance, np.eye(2))
    assert simulate_driven(rig, [9.0], states=states).states[0, 0] == states[0]
