"""Laws of the loop: two recorded ones reproduced, exact derivatives, states found again."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from tests.support.exchanging import Heaters
from tests.support.places import OTHERS
from tests.support.plants import Tank
from twinmatch.compiled import compiled
from twinmatch.dynamics import (
    Controller,
    Experiment,
    Law,
    LinearLaw,
    PidGains,
    PlantError,
    TwoLevel,
    begin,
    commands_of,
    simulate_closed_loop,
)
from twinmatch.dynamics.laws import gain_slopes, law_slopes, law_step
from twinmatch.signals import Window

Array = NDArray[np.float64]
PID = PidGains(8.0, 0.3, 2.0, 0.4, low=-50.0, high=60.0, period=0.5)
TWO = TwoLevel(
    0.0, 1.0, below=1.0, above=0.5, least_on=3.0, least_off=2.0, most_on=9.0, period=0.5
)
LINEAR = LinearLaw(
    A=[[0.9, 0.1], [0.0, 0.8]], B=[[0.1, 0.2], [0.0, -0.1]], C=[[1.0, 0.5], [-0.4, 2.0]],
    D=[[-2.0, 0.1], [0.2, -3.0]], E=[[2.0], [1.0]], F=[[0.3], [-0.2]], G=[[0.02, 0.0], [0.01, -0.03]],
    offset=[1.0, -1.0], shift=[0.1, 0.0], low=[-20.0, -5.0], high=[20.0, 5.0],
)  # fmt: skip


@compiled
def step_and_slopes(law, z, r, y, tuned):  # type: ignore[no-untyped-def]
    """Commands, next state, and both kinds of derivatives."""
    m = int(law[2])
    q = z.size
    u = np.zeros(m)
    after = np.zeros(q)
    slopes = np.zeros((m + q, q + y.size))
    of_gains = np.zeros((m + q, tuned.size))
    references = r.reshape((1, r.size))
    law_step(law, z, references, 0, y, u, after)
    law_slopes(law, z, references, 0, y, u, slopes)
    gain_slopes(law, z, references, 0, y, u, tuned, of_gains)
    return u, after, slopes, of_gains


def lqg(folder_name: str = "tclab_2x2") -> LinearLaw:
    """The observer with state feedback and steady-state targets that ran a recorded kit."""
    read = json.loads(
        (OTHERS / folder_name / "closed_loop_lqg_controller.json").read_text()
    )
    a, b, c, bd, cd, k, u0, y0, qs, rs = (
        np.array(read[name])
        for name in ("A", "B", "C", "Bd", "Cd", "K", "u0", "y0", "Qs", "Rs")
    )
    n = len(a)
    nd = bd.shape[1]
    whole = c.T @ qs @ c
    cost = solve_discrete_are(a, b, whole, rs)
    feedback = np.linalg.solve(b.T @ cost @ b + rs, b.T @ cost @ a)
    target = np.linalg.inv(
        np.block([[np.eye(n) - a, -b], [c, np.zeros((len(c), b.shape[1]))]])
    )
    target = target @ np.block([[bd, np.zeros((n, len(c)))], [-cd, np.eye(len(c))]])
    of_d = target[:, :nd]
    of_r = target[:, nd:]
    joint = np.block([[a, bd], [np.zeros((nd, n)), np.eye(nd)]])
    observed = np.hstack([c, cd])
    steering = np.vstack([b, np.zeros((nd, b.shape[1]))])
    by_r = feedback @ of_r[:n] + of_r[n:]
    return LinearLaw(
        A=joint - k @ observed, B=k, C=np.hstack([-feedback, feedback @ of_d[:n] + of_d[n:]]),
        D=np.zeros((2, 2)), E=by_r, F=np.zeros((n + nd, 2)), G=steering,
        offset=(u0 - by_r @ y0).ravel(), shift=-(steering @ u0 + k @ y0).ravel(),
        low=np.zeros(2), high=np.full(2, 100.0),
    )  # fmt: skip


def test_a_recorded_observer_with_state_feedback_is_reproduced() -> None:
    """Readings were recorded with four decimals; rounded by 5e-5 they move a command by up to 6e-4."""
    path = OTHERS / "tclab_2x2" / "closed_loop_lqg.csv"
    if not path.is_file():
        pytest.skip(
            f"no {path}; set TWINMATCH_PLANT_RECORDINGS to the folder of other plants' recordings"
        )
    _, r1, r2, q1, q2, t1, t2 = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    r, u, y = (
        np.ascontiguousarray(np.stack(pair, axis=1))
        for pair in ((r1, r2), (q1, q2), (t1, t2))
    )
    law = lqg()
    commands, _ = commands_of(law.code, np.zeros(4), r, y)
    assert np.max(np.abs(commands - u)) < 7e-4
    controller = Controller(law)
    stepwise = np.empty_like(u)
    for k in range(len(u)):
        stepwise[k] = law.C @ controller.state + law.E @ r[k] + law.offset
        controller.follow(r[k], y[k], u[k])
    assert np.max(np.abs(np.clip(stepwise, 0.0, 100.0) - u)) < 5.2e-4
    assert ((u <= 0.0) | (u >= 100.0)).any()
    # Picked up anywhere, its state follows from what it did.
    for first in (0, 777, 3000):
        window = Window(r, y, u).part(first, first + 60)
        later = slice(first + 2, first + 61)
        resumed, _ = commands_of(law.code, law.state(window), r[later], y[later])
        np.testing.assert_allclose(resumed, window.inputs[2:], atol=0.05)


@settings(max_examples=60)
@given(st.data())
@pytest.mark.parametrize("law", [PID, LINEAR], ids=["PID", "linear"])
def test_the_derivatives_are_those_of_differences(
    law: Law, data: st.DataObject
) -> None:
    numbers = st.floats(-3.0, 3.0)
    z, y, r = (
        np.array(data.draw(st.lists(numbers, min_size=n, max_size=n)))
        for n in (law.n_states, law.n_outputs, law.n_references)
    )
    compiled_law = law.code
    m = law.n_inputs
    tuned = np.array(sorted(law.GAINS.values()))
    low = compiled_law[3 : 3 + m]
    high = compiled_law[3 + m : 3 + 2 * m]
    u, after, slopes, of_gains = step_and_slopes(compiled_law, z, r, y, tuned)
    if (
        np.min(np.abs(np.concatenate([u - low, u - high]))) < 1e-4
        and not ((u == low) | (u == high)).all()
    ):
        return  # at the edge of a limit the derivative is one-sided

    def result(of_z: Array, of_y: Array, of_gains: Array) -> Array:
        return np.concatenate(step_and_slopes(of_gains, of_z, r, of_y, tuned)[:2])

    point = np.concatenate([z, y, compiled_law[tuned]])
    whole = compiled_law.copy()
    q = z.size
    p = y.size
    for j in range(point.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = point.copy()
            numbers_there = whole.copy()
            moved[j] += sign * 1e-6
            numbers_there[tuned] = moved[q + p :]
            ends.append(result(moved[:q], moved[q : q + p], numbers_there))
        differences = (ends[0] - ends[1]) / 2e-6
        exact = slopes[:, j] if j < q + p else of_gains[:, j - q - p]
        if ((u <= low) | (u >= high)).any() and not np.allclose(
            exact, differences, atol=1e-5
        ):
            continue  # a command that is exactly on its limit, or enters it on the way
        np.testing.assert_allclose(exact, differences, atol=1e-5)
    assert slopes.shape == (m + q, q + p)
    assert len(after) == q


def test_two_levels_keep_their_limits_and_dwell_times() -> None:
    law = TWO
    y = []
    controller = Controller(law)
    x = 20.0
    log = []
    for _ in range(400):
        u = float(controller.step(25.0, x)[0])
        log.append(u)
        y.append(x)
        x += 0.5 * (2.0 * u - 0.05 * (x - 20.0))
    on = np.array(log)
    edges = np.flatnonzero(np.diff(on)) + 1
    lengths = np.diff(edges) * law.period
    ups = on[edges[:-1]] == 1.0
    assert lengths[ups].min() >= 3.0
    assert lengths[ups].max() <= 9.0
    assert lengths[~ups].min() >= 2.0
    for k in edges:
        before = on[k - 1]
        after = on[k]
        assert before != after
        if after == 1.0:
            assert y[k] < 24.0
        else:
            assert y[k] > 25.5 or (on[max(k - 18, 0) : k] == 1.0).all()


def test_two_levels_move_their_switches_with_the_plant() -> None:
    """The derivative of a run's mean output by a parameter, averaged over where in a sample it switches.

    A command of a sampled law changes at a sample, so one run is a staircase of its parameters; the mean over
    many set-points has the slope of the tangents.
    """
    tank = Tank.model().parameters()
    law = TwoLevel(0.0, Tank.drive.limits[1], below=0.05, above=0.05)
    size = 300
    means = {-1: [], 1: []}
    slopes = []
    name = Tank.model().structure.free[0]
    width = 0.02 * tank[name]
    for shift in np.linspace(0.0, 0.03, 40):
        reference = np.full(size, 1.0 + shift)
        runs = {
            sign: simulate_closed_loop(
                tank.replace(**{name: tank[name] + sign * width}), reference,
                states=begin(tank, 0.9 + shift), law=law, controller=[0.0, 100.0, 0.9],
            )
            for sign in (-1, 0, 1)
        }  # fmt: skip
        window = Window(reference, runs[0].outputs, runs[0].inputs)
        experiment = Experiment(tank, (name,), window, law=law)
        slopes.append(experiment.tangents(np.array([tank[name]])).by[0, :, 0].mean())
        for sign, signed_means in means.items():
            signed_means.append(runs[sign].output[2:].mean())
    expected = (np.mean(means[1]) - np.mean(means[-1])) / (2.0 * width)
    assert np.mean(slopes) == pytest.approx(expected, rel=0.25)


def test_unknown_gains_of_a_controller_are_found() -> None:
    """From its commands and the plant's answers, with the plant's parameters at once."""
    rig = Heaters.model().parameters()
    law = LinearLaw(
        A=np.eye(2), B=-0.1 * np.eye(2), C=0.2 * np.eye(2), D=-4.0 * np.eye(2), E=4.0 * np.eye(2),
        F=0.1 * np.eye(2), G=np.zeros((2, 2)), offset=[20.0, 15.0], shift=np.zeros(2), low=[0.0, 0.0],
        high=[100.0, 80.0], period=2.0,
    )  # fmt: skip
    reference = np.repeat([[45.0, 38.0], [55.0, 40.0], [50.0, 48.0]], 60, axis=0)
    run = simulate_closed_loop(rig, reference, states=begin(rig, [40.0, 35.0]), law=law)
    window = Window(reference, run.outputs, run.inputs, period=2.0)
    experiment = Experiment(
        rig, ("loss",), window, free_gains=("D[0,0]", "E[0,0]"), law=law
    )
    truth = experiment.values_of(rig)
    assert truth.tolist() == [rig["loss"], -4.0, 4.0]
    minimum = experiment.descend(
        truth * [1.3, 0.8, 1.1], np.array([1e-3, -20.0, 0.0]), np.array([0.1, 0.0, 20.0]),
        np.array([0.01, 1.0, 1.0]), 60,
    )  # fmt: skip
    np.testing.assert_allclose(minimum.values, truth, rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TwoLevel(1.0, 0.0, 1.0, 1.0), "give off below on"),
        (lambda: TwoLevel(0.0, 1.0, -2.0, 1.0), "limits that do not cross"),
        (lambda: TwoLevel(0.0, math.nan, 1.0, 1.0), "on is nan"),
        (lambda: TwoLevel(0.0, 1.0, 1.0, 1.0, least_on=-1.0), "least_on is -1.0"),
        (
            lambda: TwoLevel(0.0, 1.0, 1.0, 1.0, least_on=5.0, most_on=4.0),
            "most_on is 4.0 s",
        ),
        (
            lambda: lqg_with(B=np.zeros((3, 2))),
            r"B has shape \(3, 2\); give numbers of shape \(4, 2\)",
        ),
        (lambda: lqg_with(high=np.zeros(2)), "give limits in increasing order"),
        (lambda: lqg_with(C=np.zeros(4)), "C, D and E must be matrices"),
        (lambda: Controller(PID, [math.nan, 0.0, 0.0]).step(1.0, 1.0), "state"),
    ],
)
def test_what_is_not_a_law_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(PlantError, match=message):
        make()


def test_two_levels_may_switch_both_above_the_set_point() -> None:
    """As a thermostat with an offset does."""
    law = TwoLevel(0.0, 1.0, below=-0.5, above=1.5)
    off = Controller(law, [0.0, 100.0, 21.0])
    assert [off.step(20.0, output)[0] for output in (20.4, 20.6, 21.4, 21.6)] == [
        1.0,
        1.0,
        1.0,
        0.0,
    ]


def lqg_with(**changes: Array) -> LinearLaw:
    arguments = {
        "A": np.eye(4), "B": np.zeros((4, 2)), "C": np.zeros((2, 4)), "D": np.zeros((2, 2)),
        "E": np.zeros((2, 2)), "F": np.zeros((4, 2)), "G": np.zeros((4, 2)), "offset": np.zeros(2),
        "shift": np.zeros(4), "low": np.zeros(2), "high": np.ones(2),
    }  # fmt: skip
    return LinearLaw(**{**arguments, **changes})


def test_the_places_of_a_linear_laws_entries_are_those_in_its_code() -> None:
    """Two commands, three states, four readings and one set-point: no two matrices have the same shape by chance."""
    random = np.random.default_rng(7)
    m, q, p, r = 2, 3, 4, 1
    matrices = {
        "A": random.normal(size=(q, q)),
        "B": random.normal(size=(q, p)),
        "C": random.normal(size=(m, q)),
        "D": random.normal(size=(m, p)),
        "E": random.normal(size=(m, r)),
        "F": random.normal(size=(q, r)),
    }
    law = LinearLaw(
        **matrices,
        G=random.normal(size=(q, m)),
        offset=random.normal(size=m),
        shift=random.normal(size=q),
        low=np.full(m, -1.0),
        high=np.full(m, 1.0),
    )
    entries = {
        f"{name}[{i},{j}]": matrix[i, j]
        for name, matrix in matrices.items()
        for i, j in np.ndindex(matrix.shape)
    }
    assert {name: law.code[place] for name, place in law.GAINS.items()} == entries


@pytest.mark.parametrize("law", [PID, TWO, LINEAR], ids=["PID", "levels", "linear"])
def test_a_law_writes_its_code_once_and_another_law_has_its_own(law: Law) -> None:
    """Searches run thousands of courses with one law."""
    assert law.code is law.code
    slower = law.at_period(2.0) if law is not LINEAR else replace(LINEAR, period=2.0)
    assert slower.code[1] == 2.0
    assert law.code[1] == law.period
    assert (law.code[2:] == slower.code[2:]).all()
