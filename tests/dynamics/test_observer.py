"""The observer, against filters written out here, scipy's Riccati equation, and known truth."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.plants import Lag, Motor, Tank
from twinmatch.dynamics import (
    Model,
    Observer,
    ObserverBank,
    Parameters,
    PlantError,
    RandomWalk,
    Sensor,
    advance,
    begin,
    read,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.plants import Peltier

MASSIVE = Peltier.model("sink with mass")
MOTOR = Motor.model("with friction")
Array = Any


def differences(function: Any, point: Array) -> Array:
    """Jacobian of a function of an array by central differences."""
    columns = []
    for j in range(point.size):
        step = np.zeros(point.size)
        step[j] = (
            1e-5 * max(1.0, abs(point[j]))
            if abs(point[j]) > 0.5
            else 1e-6 * max(abs(point[j]), 1e-3)
        )
        columns.append(
            (function(point + step) - function(point - step)) / (2 * step[j])
        )
    return np.array(columns).T


class Textbook:
    """An extended Kalman filter on dense matrices, by differences of the public tick; Simon (2006), 13.2.

    The vector is the states and, after them, parameters that wander.
    """

    def __init__(
        self, base: Parameters, names: list[str], z: Array, covariance: Array, q: Array
    ) -> None:
        self.base = base
        self.names = names
        self.z = z
        self.covariance = covariance
        self.q = q
        self.n = len(base.model.states)

    def plant(self, z: Array) -> Parameters:
        return self.base.replace(
            **dict(zip(self.names, z[self.n :].tolist(), strict=True))
        )

    def correct(self, reading: float, row: Array | None) -> tuple[float, float]:
        def measured(z: Array) -> Array:
            return np.array([read(self.plant(z), z[: self.n], row)])

        h = differences(measured, self.z)
        r = np.array([[self.base.model.plant.output.noise**2]])
        s = h @ self.covariance @ h.T + r
        gain = self.covariance @ h.T @ np.linalg.inv(s)
        surprise = reading - measured(self.z)
        self.z = self.z + gain @ surprise
        self.covariance = (np.eye(self.z.size) - gain @ h) @ self.covariance
        return float(surprise[0]), float(s[0, 0])

    def predict(self, u: float, period: float, row: Array | None) -> None:
        def tick(z: Array) -> Array:
            return np.concatenate(
                [advance(self.plant(z), z[: self.n], u, period, row), z[self.n :]]
            )

        f = differences(tick, self.z)
        self.z = tick(self.z)
        self.covariance = f @ self.covariance @ f.T + self.q


@pytest.mark.parametrize(
    ("base", "names", "first", "period"),
    [
        (MASSIVE.parameters(), [], 22.85, 1.0),
        (MASSIVE.parameters(), ["conductance", "seebeck"], 22.85, 1.0),
        (
            Peltier.model("sink with mass, sensor lag").parameters(),
            ["heat_capacity"],
            30.0,
            1.0,
        ),
        (MOTOR.parameters(), ["dry", "k"], 20.0, 0.05),
        (Tank.model().parameters(), ["hole"], 1.5, 1.0),
    ],
    ids=[
        "Peltier",
        "Peltier, parameters wander",
        "Peltier with sensor lag",
        "motor",
        "tank",
    ],
)
def test_it_is_the_textbooks_filter(
    base: Parameters, names: list[str], first: float, period: float
) -> None:
    model = base.model
    drive = model.plant.drive
    rng = np.random.default_rng(3)
    states = begin(base, first)
    start = np.array(
        [0.013 * np.ptp(model.plant.states[name].span) for name in model.states]
    )
    drift = 0.01 * start
    walks = {name: RandomWalk(1e-3 * base[name], 0.03 * base[name]) for name in names}
    observer = Observer(
        base, first, period=period, drift=drift, start=start, random_walks=walks
    )
    slow = [w.drift for w in walks.values()]
    textbook = Textbook(
        base,
        names,
        np.concatenate([states, [base[name] for name in names]]),
        np.diag(np.square([*start, *(w.start for w in walks.values())])),
        np.diag(np.square([*drift, *slow])) * period,
    )
    loads = (
        np.zeros((80, model.disturbances.size)) + 0.01 * (np.arange(80) > 30)[:, None]
    )
    second_share = -0.5 if drive.limits[0] < 0 else 0.5
    for k in range(80):
        row = loads[k] if model.disturbances.size else None
        reading = (
            read(base, states, row) + model.plant.output.noise * rng.standard_normal()
        )
        expected = textbook.correct(reading, row)
        correction = np.ravel(observer.correct(reading, row))
        np.testing.assert_allclose(correction, expected, rtol=1e-4, atol=1e-6)
        u = 0.4 * drive.limits[1] * (1.0 if k % 40 < 20 else second_share)
        states = advance(base, states, u, period, row)
        observer.predict(u)
        textbook.predict(u, period, row)
    estimates = [*observer.states, *(observer.parameters[name] for name in names)]
    deviations = np.sqrt(np.diag(textbook.covariance))
    # Differences are good to some 1e-6 of a slope; the filters are compared in their own standard deviations.
    np.testing.assert_array_less(np.abs(estimates - textbook.z), 1e-3 * deviations)
    scale = np.outer(deviations, deviations)
    np.testing.assert_allclose(
        observer.joint / scale, textbook.covariance / scale, atol=1e-3
    )


def test_a_linear_plant_settles_at_the_riccati_equation() -> None:
    """The covariance before a reading, against scipy's discrete algebraic Riccati equation."""
    p = Lag.model().parameters(lag=8.0)
    period = 0.5
    drift = 0.03
    observer = Observer(p, 0.0, period=period, drift=[drift], start=[1.0])
    for _ in range(400):
        observer.correct(0.0)
        observer.predict(0.0)
    a = math.exp(-period / 8.0)
    q = drift**2 * period
    r = Lag.output.noise**2
    exact = scipy.linalg.solve_discrete_are(
        np.array([[a]]), np.eye(1), np.array([[q]]), np.array([[r]])
    )
    np.testing.assert_allclose(observer.covariance, exact, rtol=1e-6)


def test_a_parameter_that_changes_is_followed() -> None:
    """The sink's convection falls to two thirds: the estimate follows, the one that stands still cannot."""
    rig = MASSIVE.parameters()
    faulty = rig.replace(sink_convection=2.0)
    u = 160.0 * np.sign(np.sin(np.arange(2400) / 80.0))
    before = simulate_driven(rig, u[:1200], states=begin(rig, 22.85))
    after = simulate_driven(faulty, u[1200:], states=before.states[-1])
    rng = np.random.default_rng(8)
    output = np.concatenate([before.output, after.output]) + 0.1 * rng.standard_normal(
        u.size
    )
    drift = [1e-3, 1e-3]
    start = [0.2, 2.0]
    walks = {"sink_convection": RandomWalk(0.02, 0.1)}
    observer = Observer(
        rig, output[0], period=1.0, drift=drift, start=start, random_walks=walks
    )
    for k in range(u.size):
        observer.correct(output[k])
        if k == 1199:
            healthy = observer.parameters["sink_convection"]
        observer.predict(u[k])
    deviation = math.sqrt(observer.joint[2, 2])
    assert abs(observer.parameters["sink_convection"] - 2.0) < 3 * deviation < 0.9
    assert abs(healthy - 3.0) < 0.9
    assert observer.parameters.replace(sink_convection=3.0) == rig


def test_a_wandering_parameter_stays_possible() -> None:
    rig = MOTOR.parameters(dry=0.0)
    observer = Observer(
        rig,
        100.0,
        period=0.05,
        drift=[0.1],
        start=[1.0],
        random_walks={"dry": RandomWalk(1.0, 1.0)},
    )
    for k in range(300):
        observer.correct(100.0 + 30.0 * (-1.0) ** k)
        observer.predict(6.0)
        assert 0.0 <= observer.parameters["dry"] <= 0.1


@pytest.mark.parametrize("limit", [math.inf, 3.0])
def test_single_wrong_readings_hardly_move_it_with_a_limit(limit: float) -> None:
    """A camera that corrects its flat field: every 40th reading is 5 K off, fifty standard deviations."""
    rig = MASSIVE.parameters()
    run = simulate_closed_loop(
        rig,
        np.full(800, 45.0),
        states=begin(rig, 40.0),
        sensor=Sensor(noise=0.1).realise(800, 1.0, 2),
    )
    observer = Observer(
        rig, 40.0, period=1.0, drift=[0.02, 0.02], start=[0.2, 3.0], limit=limit
    )
    errors = []
    for k in range(800):
        kicked = k % 40 == 20
        observer.correct(run.output[k] + 5.0 * kicked)
        if kicked:
            errors.append(abs(observer.states[0] - run.states[k, 0]))
        observer.predict(run.input[k])
    # The kick moves the plate by the gain, near 0.2, of 5 K; of 0.3 K with the limit.
    assert (max(errors[1:]) < 0.15) if math.isfinite(limit) else (max(errors[1:]) > 0.3)


def test_a_surprise_within_the_limit_changes_nothing() -> None:
    observers = [
        Observer(
            MASSIVE.parameters(),
            30.0,
            period=1.0,
            drift=[0.1, 0.1],
            start=[1.0, 1.0],
            limit=limit,
        )
        for limit in (math.inf, 3.0)
    ]
    for observer in observers:
        observer.correct(32.9)  # 2.9 standard deviations
        observer.predict(20.0)
    np.testing.assert_array_equal(observers[0].states, observers[1].states)
    np.testing.assert_array_equal(observers[0].joint, observers[1].joint)
    most = Observer(
        MASSIVE.parameters(),
        30.0,
        period=1.0,
        drift=[0.1, 0.1],
        start=[1.0, 1.0],
        limit=3.0,
    )
    surprise, variance = most.correct(50.0)
    assert surprise == pytest.approx(20.0)
    assert most.states[0] - 303.15 == pytest.approx(
        3.0 / math.sqrt(variance[0]), rel=1e-9
    )


def plate_error(twin: Parameters, *, adaptive: bool) -> float:
    """Mean |error| of the plate's temperature as an observer of `twin` estimates it, K; noise 0.05 K."""
    rig = MASSIVE.parameters()
    steps = np.repeat([40.0, 55.0, 30.0, 50.0], 200)
    run = simulate_closed_loop(
        rig,
        steps,
        states=begin(rig, 40.0),
        sensor=Sensor(noise=0.05).realise(800, 1.0, 4),
    )
    n = len(twin.model.states)
    observer = Observer(
        twin, 40.0, period=1.0, drift=[0.03] * n, start=[4.5] * n, adaptive=adaptive
    )
    errors = []
    for y, u, x in zip(run.output, run.input, run.states, strict=False):
        observer.correct(y)
        errors.append(observer.states[0] - x[0])
        observer.predict(u)
    return float(np.abs(errors[20:]).mean())


def test_adapted_to_its_innovations_even_a_wrong_twin_follows_the_readings() -> None:
    """Its sink is held, its module three times too strong: it pulls away from every reading."""
    wrong = Peltier.model("held sink").parameters(seebeck=0.15)
    assert (
        plate_error(wrong, adaptive=True)
        < 2.0 * 0.05
        < 0.2 * plate_error(wrong, adaptive=False)
    )


def test_a_right_twin_is_followed_no_worse_than_with_the_drift_that_was_given() -> None:
    """The factor wanders around the best one: it costs less than a tenth of the precision."""
    given_drift, adapted = (
        plate_error(MASSIVE.parameters(), adaptive=way) for way in (False, True)
    )
    assert adapted < 1.1 * given_drift


def innovations_of(
    assumed_drift: float, noise: float, *, adaptive: bool
) -> tuple[float, float]:
    """RMS of the innovations of an observer, and that of the best filter, after 500 of 4000 samples, m.

    The plant drifts by 0.03 m per root of a second; its readings have this noise.
    """
    p = Lag.model().parameters(lag=8.0)
    period = 0.5
    a = math.exp(-period / 8.0)
    q = 0.03**2 * period
    variance = scipy.linalg.solve_discrete_are(
        np.array([[a]]), np.eye(1), np.array([[q]]), np.array([[noise**2]])
    )
    random = np.random.default_rng(8)
    observer = Observer(
        p, 0.0, period=period, drift=[assumed_drift], start=[0.1], adaptive=adaptive
    )
    x = 0.0
    innovations = []
    for _ in range(4000):
        innovation, _ = observer.correct(x + noise * random.standard_normal())
        innovations.append(innovation[0])
        observer.predict(0.0)
        x = a * x + math.sqrt(q) * random.standard_normal()
    rms = float(np.sqrt(np.mean(np.square(innovations[500:]))))
    return rms, math.sqrt(variance.item() + noise**2)


@pytest.mark.parametrize("noise", [0.01, 0.03])
@pytest.mark.parametrize("assumed", [0.003, 0.03, 0.3])
def test_an_observer_that_adapts_finds_the_drift_whatever_the_noise(
    assumed: float, noise: float
) -> None:
    """Its innovations are hardly larger than those of the filter that knows both, by scipy's Riccati equation;
    the noise that it assumes is 0.01 m. 3500 innovations scatter by 1.2 % in their RMS, and the factor, which
    remembers 15 samples, may cost as much again."""
    rms, least = innovations_of(assumed, noise, adaptive=True)
    assert rms < 1.03 * least


def test_without_adaptation_a_drift_ten_times_too_small_costs_a_third_of_the_precision() -> (
    None
):
    """So the test above can fail."""
    rms, least = innovations_of(0.003, 0.01, adaptive=False)
    assert rms > 1.3 * least


def test_it_continues_in_the_middle_of_a_session() -> None:
    """A second observer that is given states and covariance continues to the last bit."""
    rig = MASSIVE.parameters()
    walks = {"conductance": RandomWalk(1e-3, 0.05)}
    settings_of = {"period": 1.0, "drift": [1e-2, 1e-2], "random_walks": walks}
    first = Observer(rig, 25.0, start=[0.2, 3.0], **settings_of)
    for k in range(100):
        first.correct(25.0 + 0.05 * k)
        first.predict(100.0)
    second = Observer(
        first.parameters, states=first.states, covariance=first.joint, **settings_of
    )
    for k in range(50):
        assert first.correct(30.0 + 0.01 * k) == second.correct(30.0 + 0.01 * k)
        first.predict(-50.0)
        second.predict(-50.0)
    np.testing.assert_array_equal(first.states, second.states)
    np.testing.assert_array_equal(first.joint, second.joint)
    assert first.parameters == second.parameters


def test_a_bank_moves_all_its_observers_as_each_would_move_alone() -> None:
    """Structures with one and with two states, readings that are lost, and one that no plant can give."""

    def new_observer(model: Model) -> Observer:
        n = len(model.states)
        return Observer(
            model.parameters(),
            25.0,
            period=1.0,
            drift=[1e-2] * n,
            start=[2.0] * n,
            limit=4.0,
        )

    models = (Peltier.model("held sink"), MASSIVE)
    alone = [new_observer(model) for model in models]
    together = [new_observer(model) for model in models]
    bank = ObserverBank(together)
    rng = np.random.default_rng(3)
    for k in range(60):
        u = float(rng.uniform(0.0, 100.0))
        y = float(25.0 + rng.standard_normal())
        for observer in alone:
            observer.predict(u)
            if k % 7:
                observer.correct(y)
        assert bank.push([u], [y], [k % 7 > 0]) == [1, 1]
        for single, banked in zip(alone, together, strict=True):
            np.testing.assert_array_equal(single.states, banked.states)
            np.testing.assert_array_equal(single.joint, banked.joint)
    assert bank.push([50.0, 50.0, 50.0], [25.0, math.inf, 25.0], [True] * 3) == [1, 1]


def test_parameters_may_be_exchanged_at_any_sample() -> None:
    rig = MASSIVE.parameters()
    observer = Observer(rig, 25.0, period=1.0, drift=[1e-2, 1e-2], start=[0.2, 3.0])
    observer.correct(25.1)
    states = observer.states
    covariance = observer.covariance
    better = rig.replace(heat_capacity=30.0)
    observer.parameters = better
    np.testing.assert_array_equal(observer.states, states)
    np.testing.assert_array_equal(observer.covariance, covariance)
    observer.predict(80.0)
    np.testing.assert_allclose(
        observer.states, advance(better, states, 80.0, 1.0), rtol=1e-13
    )
    with pytest.raises(
        PlantError,
        match="parameters of Peltier rig, held sink given; make a new observer",
    ):
        observer.parameters = Peltier.model("held sink").parameters()


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    drift=st.floats(0.0, 10.0),
    start=st.floats(0.0, 1e3),
    limit=st.sampled_from([1.0, 3.0, math.inf]),
    kick=st.floats(0.0, 50.0),
)
def test_the_covariance_stays_one(
    seed: int, drift: float, start: float, limit: float, kick: float
) -> None:
    """Symmetric to the last bit, positive semidefinite, whatever the readings are."""
    rng = np.random.default_rng(seed)
    rig = MASSIVE.parameters()
    observer = Observer(
        rig, 40.0, period=1.0, drift=[drift, drift], start=[start, start], limit=limit,
        random_walks={"conductance": RandomWalk(0.01, 0.1)},
    )  # fmt: skip
    for _ in range(60):
        observer.correct(40.0 + kick * rng.standard_normal())
        observer.predict(200.0 * rng.uniform(-1.0, 1.0))
        joint = observer.joint
        np.testing.assert_array_equal(joint, joint.T)
        scale = np.sqrt(np.diag(joint)) + 1e-300
        assert np.min(np.linalg.eigvalsh(joint / np.outer(scale, scale))) > -1e-9


def test_states_that_are_lost_are_said() -> None:
    """A tank that holds less than nothing has no outflow; the filter would carry that on for ever."""
    observer = Observer(
        Tank.model().parameters(), 0.1, period=1.0, drift=[0.1], start=[5.0]
    )
    observer.correct(-3.0)
    observer.predict(0.0)
    with pytest.raises(
        PlantError, match="Tank, open: its equations have no finite value at the obser"
    ):
        observer.correct(0.1)


def test_what_an_observer_cannot_use_is_refused() -> None:
    rig = MASSIVE.parameters()

    def observer_with(**changes: Any) -> Observer:
        arguments = {
            "output": 25.0,
            "period": 1.0,
            "drift": [0.1, 0.1],
            "start": [1.0, 1.0],
        }
        return Observer(rig, **{**arguments, **changes})

    for changes, message in (
        ({"drift": [0.1]}, "drift [0.1] given; give 2 finite standard deviations"),
        ({"start": [0.1, -1.0]}, "none negative (plate, sink)"),
        (
            {"start": None},
            "give an observer's start (standard deviations) or its covariance",
        ),
        ({"covariance": np.eye(2)}, "or its covariance, not both"),
        (
            {"start": None, "covariance": np.eye(3)},
            "shape (3, 3) given; give finite values, (2, 2)",
        ),
        ({"output": None}, "starts from an output or from states; give one"),
        (
            {"states": [300.0]},
            "states [300.0] given; give finite values of plate, sink",
        ),
        (
            {"random_walks": {"mass": RandomWalk(1.0, 1.0)}},
            "'mass' cannot be estimated; choose from",
        ),
        ({"limit": 0.0}, "the observer's limit is 0.0; it must be positive"),
        ({"period": -1.0}, "the period is -1.0 s"),
    ):
        with pytest.raises(PlantError, match=re.escape(message)):
            observer_with(**changes)
    observer = observer_with()
    before = observer.states
    with pytest.raises(PlantError, match="the reading is nan"):
        observer.correct(math.nan)
    with pytest.raises(PlantError, match="the input is inf"):
        observer.predict(math.inf)
    np.testing.assert_array_equal(observer.states, before)
