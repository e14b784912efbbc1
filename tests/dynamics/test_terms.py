"""Terms of equations: roots that reach zero, and dead times, against what is known of them."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from sympy import sqrt

from tests.support.plants import Exchanger, Tank
from twinmatch.dynamics import (
    DeadTime,
    Drive,
    Equations,
    Experiment,
    Output,
    Parameter,
    Plant,
    PlantError,
    State,
    Structure,
    advance,
    begin,
    dead_zone,
    dry_friction,
    linearised,
    maximum,
    read,
    simulate_closed_loop,
    simulate_driven,
    simulate_window,
)
from twinmatch.dynamics.terms import DelayLine
from twinmatch.fitting import match
from twinmatch.signals import Window


class Cask(Plant, name="cask"):
    """A pump fills a tank, which empties through an orifice (Torricelli)."""

    level = Output(unit="cm", noise=0.1, span=(-1.0, 60.0))
    volts = Drive(unit="V", limits=(0.0, 12.0), noise=0.1)
    h = State(unit="cm", span=(0.0, 60.0))
    k = Parameter(unit="cm/(s V)", default=0.06, bounds=(0.01, 0.2), positive=True)
    a = Parameter(unit="cm^0.5/s", default=0.2, bounds=(0.02, 2.0), positive=True)
    structures = {"prompt": Structure(free=("k", "a"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        rates = {self.h: self.k * self.volts - self.a * sqrt(maximum(self.h, 0))}
        return Equations(rates=rates, output=self.h, start={self.h: self.level})


def emptied(a: float, first: float = 25.0) -> tuple[np.ndarray, Window]:
    """Torricelli's law without inflow, √h = √h₀ − a·t/2 until empty, and the window that it gives."""
    t = np.arange(120.0)
    level = np.maximum(np.sqrt(first) - a * t / 2, 0.0) ** 2
    u = np.zeros(t.size)
    return level, Window(np.zeros(t.size), level, u)


def test_a_tank_runs_empty_by_torricellis_law() -> None:
    level, window = emptied(0.2)
    cask = Cask.model().parameters(a=0.2)
    run = simulate_driven(cask, window.input, states=begin(cask, 25.0))
    # δ is 0.06 cm: the last centimetre drains a little later than by the exact root.
    assert np.abs(run.output - level).max() < 0.02
    assert 0 <= run.output[-1] < 0.01


def test_a_match_finds_the_outflow_of_a_tank_that_ran_empty() -> None:
    """The exact root's derivative at zero is infinite, and infinity times zero is NaN."""
    _, window = emptied(0.2)
    experiment = Experiment(Cask.model().parameters(), ("k", "a"), window, law=None)
    values = np.array([0.06, 0.21])
    exact = experiment.tangents(values)
    assert np.isfinite(exact.by).all()
    for j, step in enumerate(np.diag([1e-7, 1e-7])):
        up = experiment.simulate(values + step)
        down = experiment.simulate(values - step)
        np.testing.assert_allclose(
            exact.by[0, :, j], (up.output - down.output) / 2e-7, atol=0.02
        )
    low = begin(Cask.model().parameters(), -0.3)  # noise shows levels below zero
    assert np.isfinite(
        experiment.model.kernels.slopes_at(
            experiment.base.vector, low, np.zeros(1), np.empty(0)
        )[1]
    ).all()
    filled = np.repeat([0.0, 8.0, 3.0], 100)
    truth = Cask.model().parameters(k=0.08, a=0.15)
    run = simulate_driven(truth, filled, states=begin(truth, 9.0))
    noise = 0.1 * np.random.default_rng(3).standard_normal(filled.size)
    matched = match(
        Window(np.zeros(filled.size), run.output + noise, filled),
        start=Cask.model().parameters(),
    )
    assert matched.accepted, matched.reason
    assert matched.parameters["k"] == pytest.approx(0.08, rel=0.02)
    assert matched.parameters["a"] == pytest.approx(0.15, rel=0.02)


def test_a_root_that_stays_above_zero_is_exact() -> None:
    """A smooth root would bend, by a little, the valley of parameters that no data can tell apart."""
    tank = Tank.model().parameters()
    slope = tank.model.kernels.slopes_at(
        tank.vector, np.array([4.0]), np.ones(1), np.empty(0)
    )[1]
    assert slope[0, 0] == pytest.approx(
        -tank["hole"] / (2 * 2.0) / tank["area"], rel=1e-14
    )


PERIOD = 1.0
FINE = 100
PIPE = Exchanger.model("with pipe")


def delayed_plant(u: np.ndarray, gain: float, lag: float, delay: float) -> np.ndarray:
    """The exchanger with an exact delay, at rest before, its inlet at 20 °C."""
    fine = np.repeat(u, FINE)
    shift = round(delay * FINE / PERIOD)
    came = np.concatenate([np.full(shift, u[0]), fine])[: fine.size]
    decay = np.exp(-PERIOD / FINE / lag)
    y = np.empty(u.size)
    x = gain * u[0]
    for k, value in enumerate(came):
        if k % FINE == 0:
            y[k // FINE] = 20.0 + x
        x = decay * x + (1.0 - decay) * gain * value
    return y


def recorded(gain: float, lag: float, delay: float, seed: int = 3) -> Window:
    """Ten minutes with twelve random levels of the heater."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(5.0, 80.0, 12), 50)
    y = delayed_plant(u, gain, lag, delay) + random.normal(0.0, 0.1, u.size)
    return Window(
        np.zeros(u.size), y, u, period=PERIOD, disturbances=np.full((u.size, 1), 20.0)
    )


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_it_is_the_pade_approximation_of_the_tables(order: int) -> None:
    theta = 3.0
    states = sympy.symbols(f"z:{order}")
    u = sympy.Symbol("u")
    line = DelayLine(tuple(states)).after(u, theta)
    rates = sympy.Matrix([line.rates[x] for x in states])
    a = np.array(rates.jacobian(states)).astype(float)
    b = np.array(rates.jacobian([u])).astype(float)
    c = np.array(sympy.Matrix([line.value]).jacobian(states)).astype(float)
    ours = control.ss(a, b, c, [[0.0]])
    theirs = control.tf(*control.pade(theta, order, numdeg=order - 1))
    frequencies = np.logspace(-2, 1, 30) / theta
    # `control.pade` works with factorials in floating point: nine digits are left at order 8.
    np.testing.assert_allclose(
        ours(1j * frequencies), theirs(1j * frequencies), rtol=1e-8
    )


@pytest.mark.parametrize(
    ("lag", "delay"), [(30.0, 8.0), (12.0, 5.5), (20.0, 20.0), (60.0, 3.0)]
)
def test_a_delay_is_found_in_data_with_an_exact_one(lag: float, delay: float) -> None:
    window = recorded(0.8, lag, delay)
    matched = match(window, start=PIPE.parameters(), law=None)
    assert matched.status.value == "accepted"
    # One per cent: the order of the approximation costs less than that while the delay is below the lag.
    assert matched.parameters["gain"] == pytest.approx(0.8, rel=0.005)
    assert matched.parameters["lag"] == pytest.approx(lag, rel=0.02)
    assert matched.parameters["delay"] == pytest.approx(delay, rel=0.01)
    without = match(window, start=Exchanger.model("without").parameters(), law=None)
    assert (
        without.status.value != "accepted"
        or without.parameters["lag"] > lag + 0.5 * delay
    )


def test_the_loop_with_a_delay_is_matched() -> None:
    truth = PIPE.parameters(gain=0.8, lag=30.0, delay=9.0)
    reference = np.repeat([30.0, 30.0, 50.0, 40.0, 60.0], 200)
    run = simulate_closed_loop(
        truth, reference, states=begin(truth, 30.0, input=12.5), law=Exchanger.loop
    )
    # From where the loop has come to rest, since what was in the pipe before is taken to be constant.
    window = Window(reference[300:], run.output[300:], run.input[300:], period=PERIOD)
    matched = match(window, start=PIPE.parameters(gain=1.0, lag=20.0, delay=5.0))
    for name in ("gain", "lag", "delay"):
        assert matched.parameters[name] == pytest.approx(truth[name], rel=1e-3)


@settings(max_examples=40, deadline=None)
@given(
    u=st.floats(0.0, 100.0),
    delay=st.floats(2.0, 60.0),
    lag=st.floats(2.0, 300.0),
    gain=st.floats(0.1, 1.0),
)
def test_a_constant_signal_is_not_changed(
    u: float, delay: float, lag: float, gain: float
) -> None:
    p = PIPE.parameters(gain=gain, lag=lag, delay=delay)
    start = begin(p, 20.0 + gain * u, input=u)
    run = simulate_driven(p, np.full(50, u), states=start)
    np.testing.assert_allclose(run.output, 20.0 + gain * u, atol=1e-9 * (1.0 + u))


@settings(max_examples=20, deadline=None)
@given(delay=st.floats(4.0, 30.0), lag=st.floats(5.0, 100.0))
def test_tangents_are_exact(delay: float, lag: float) -> None:
    window = recorded(0.8, 30.0, 8.0)
    experiment = Experiment(
        PIPE.parameters(), ("gain", "lag", "delay"), window, law=None
    )
    values = np.array([0.8, lag, delay])
    tangents = experiment.tangents(values).by[0]
    for j, step in enumerate((1e-5, 1e-3, 1e-3)):
        high = values.copy()
        low = values.copy()
        high[j] += step
        low[j] -= step
        slope = (experiment.simulate(high).output - experiment.simulate(low).output) / (
            2 * step
        )
        np.testing.assert_allclose(
            tangents[:, j], slope, atol=2e-4 * (1.0 + np.abs(slope).max())
        )


def test_the_pipe_holds_what_was_commanded_before_the_start() -> None:
    p = PIPE.parameters(delay=20.0)
    before = begin(p, 60.0, input=40.0)
    at_rest = begin(p, 60.0)
    places = [p.model.states.index(f"pipe_{i}") for i in range(4)]
    np.testing.assert_array_equal(before[places], [40.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(at_rest[places], np.zeros(4))
    # With the heater just switched off, the outlet stays warm until the pipe has run empty.
    after = before
    for _ in range(5):
        after = advance(p, after, 0.0, PERIOD)
    assert read(p, after) == pytest.approx(60.0, abs=0.8)
    window = recorded(0.8, 30.0, 20.0)
    run = simulate_window(p.replace(gain=0.8, lag=30.0), window, law=None)
    assert abs(run.output[0] - window.output[2]) < 1e-9
    # noise, not a pipe that was empty
    assert np.abs(run.output[:40] - window.output[2:42]).max() < 0.5


def test_its_linearisation_turns_the_phase() -> None:
    p = PIPE.parameters(gain=0.8, lag=30.0, delay=12.0)
    a, b, c, period = linearised(p, 50.0, PERIOD)[:4]
    ours = control.ss(a, b, c, [[0.0]], period)
    w = np.logspace(-3, -1, 10)
    exact = (
        0.8 / (30.0j * w + 1.0) * np.exp(-12.0j * w) * (1 - np.exp(-1j * w)) / (1j * w)
    )
    np.testing.assert_allclose(ours(np.exp(1j * w)), exact, rtol=1e-4)


@pytest.mark.parametrize(
    ("order", "span", "words"),
    [
        (0, (0.0, 1.0), r"order 0 of a dead time \(flow\); choose 1 to 8"),
        (9, (0.0, 1.0), "order 9 of a dead time"),
        (2.0, (1.0, 0.0), "span of a dead time"),
    ],
)
def test_mistakes_in_a_dead_time_are_named(
    order: int, span: tuple[float, float], words: str
) -> None:
    with pytest.raises(PlantError, match=words):
        DeadTime(span=span, order=order, text="flow")


def test_a_state_cannot_take_the_name_of_one_of_its_own() -> None:
    with pytest.raises((PlantError, RuntimeError)) as caught:

        class Clash(Plant):
            pipe_1 = State(unit="V", span=(0.0, 1.0))
            pipe = DeadTime(unit="V", span=(0.0, 1.0))

    error = (
        caught.value if isinstance(caught.value, PlantError) else caught.value.__cause__
    )
    assert "'pipe_1' is a state of the dead time 'pipe'" in str(error)


def test_a_start_that_uses_a_state_is_refused_in_words() -> None:
    class Early(Plant, name="early"):
        y = Output(unit="V", noise=0.01, span=(0.0, 10.0))
        u = Drive(unit="V", limits=(0.0, 10.0), noise=0.1)
        x = State(unit="V", span=(0.0, 10.0))
        z = State(unit="V", span=(0.0, 10.0))
        lag = Parameter(unit="s", default=5.0, bounds=(1.0, 50.0), positive=True)
        structures = {"one": Structure(free=("lag",))}  # noqa: RUF012

        def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
            return Equations(
                rates={
                    self.x: (self.u - self.x) / self.lag,
                    self.z: (self.x - self.z) / self.lag,
                },
                output=self.z,
                start={self.z: self.y, self.x: self.z},
            )

    with pytest.raises(
        PlantError,
        match="the start of x uses z, which is not known before the first sample",
    ):
        begin(Early.model().parameters(), 1.0)


@given(st.floats(-10.0, 10.0), st.floats(0.0, 3.0), st.floats(0.01, 5.0))
def test_a_dead_zone_passes_the_excess_and_dry_friction_opposes(
    value: float, width: float, softness: float
) -> None:
    beyond_zone = float(dead_zone(sympy.Float(value), sympy.Float(width)))
    assert beyond_zone == pytest.approx(
        math.copysign(max(abs(value) - width, 0.0), value), abs=1e-12
    )
    force = float(
        dry_friction(sympy.Float(value), sympy.Float(2.0), sympy.Float(softness))
    )
    assert abs(force) < 2.0
    assert force * value <= 0.0
    half = float(
        dry_friction(sympy.Float(softness), sympy.Float(2.0), sympy.Float(softness))
    )
    assert half == pytest.approx(-1.0)
