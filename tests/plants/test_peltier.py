"""The Peltier plate: against closed solutions, a general integrator, hand calculations and the records."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.support.peltier_oracle import (
    closed_tick,
    integrated,
    riccati_arrival,
    riccati_flow,
)
from twinmatch.dynamics import (
    Controller,
    Parameters,
    advance,
    begin,
    quantities,
    read,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.plants import Peltier
from twinmatch.signals import Window

KELVIN = 273.15
PLAIN = Peltier.model("held sink")
MASSIVE = Peltier.model("sink with mass")
RICHEST = Peltier.model(
    "sink with mass, free ambient, switched drive, sensor lag, α(T)"
)
STEPS = np.repeat([40.0, 75.0, 25.0], 120)
STRUCTURES = [
    PLAIN.parameters(),
    PLAIN.parameters(drive_ripple=1.0),
    MASSIVE.parameters(sink_heat_capacity=300.0),
    RICHEST.parameters(sensor_lag=1.5, seebeck_slope=1e-4),
]
FAST = 1e-6
"""Error of the longest step there may be, a twelfth of the fastest time constant, as a share of the way."""

plates = {
    "seebeck": st.floats(0.01, 0.2),
    # below about 2.3 Ω the limiter acts at full PWM
    "resistance": st.floats(0.5, 10.0),
    "conductance": st.floats(0.0, 2.0),
    "heat_capacity": st.floats(5.0, 150.0),
    "ambient": st.floats(263.0, 323.0),
    "drive_ripple": st.one_of(st.just(0.0), st.floats(0.0, 1.0)),
}
sinks = {
    "sink_heat_capacity": st.floats(20.0, 5000.0),
    "sink_convection": st.floats(0.0, 100.0),
}
held = st.builds(PLAIN.parameters, **plates)
massive = st.builds(MASSIVE.parameters, **plates, **sinks)
richest = st.builds(
    RICHEST.parameters,
    **plates,
    **sinks,
    sensor_lag=st.floats(0.2, 100.0),
    seebeck_slope=st.floats(-5e-5, 5e-4),
)
temperatures = st.floats(260.0, 400.0)
pwms = st.one_of(st.sampled_from([-255.0, 0.0, 255.0]), st.floats(-255.0, 255.0))


def allowed(*ways: float) -> float:
    """Error for these ways, K."""
    return 1e-6 + FAST * max(map(abs, ways))


@given(rig=held, plate=temperatures, pwm=pwms, period=st.floats(0.05, 20.0))
@example(rig=PLAIN.parameters(seebeck=0.0), plate=300.0, pwm=255.0, period=1.0)
@example(
    rig=PLAIN.parameters(seebeck=0.0, conductance=0.0), plate=300.0, pwm=0.0, period=1.0
)
@example(rig=PLAIN.parameters(resistance=1.0), plate=296.0, pwm=255.0, period=10.0)
@example(
    rig=PLAIN.parameters(seebeck=0.2, resistance=2.2, heat_capacity=5.0),
    plate=290.0,
    pwm=255.0,
    period=2.0,
)
def test_a_tick_on_a_held_sink_is_the_closed_solution(
    rig: Parameters, plate: float, pwm: float, period: float
) -> None:
    exact = closed_tick(rig, plate, pwm, period)
    ticked = advance(rig, np.array([plate]), pwm, period)[0]
    # The equilibrium the plate is drawn to may lie far off: what counts is how fast it goes there.
    way = abs(advance(rig, np.array([plate]), pwm, 1e-3)[0] - plate) * 1e3 * period
    assert abs(ticked - exact) <= allowed(ticked - plate, way)


@given(rig=held, plate=temperatures, pwm=pwms)
def test_the_closed_solution_agrees_with_a_general_integrator(
    rig: Parameters, plate: float, pwm: float
) -> None:
    general = integrated(rig, np.array([plate, rig["ambient"], plate]), pwm, 2.0)[0]
    # A hundred times the integrator's own tolerance, on some 300 K.
    assert closed_tick(rig, plate, pwm, 2.0) == pytest.approx(general, rel=1e-10)


@pytest.mark.parametrize(
    ("plate", "pwm", "before", "after"),
    [
        # heating: the growing Seebeck voltage releases the limiter
        (292.0, 255.0, -1, 0),
        (298.0, -255.0, 1, 0),  # cooling likewise
        (310.0, 255.0, 0, 0),
    ],
)
def test_the_limiter_switches_inside_a_tick(
    plate: float, pwm: float, before: int, after: int
) -> None:
    rig = PLAIN.parameters(seebeck=0.05, resistance=2.29, heat_capacity=5.0)

    def limited(states: np.ndarray) -> int:
        current = quantities(rig, states, pwm)["current"]
        return int(current >= 5.0) - int(current <= -5.0)

    start = np.array([plate])
    end = advance(rig, start, pwm, 2.0)
    assert (limited(start), limited(end)) == (before, after)
    assert abs(end[0] - closed_tick(rig, plate, pwm, 2.0)) <= allowed(end[0] - plate)


@given(rig=massive, plate=temperatures, sink=temperatures, pwm=pwms)
@example(
    rig=MASSIVE.parameters(
        seebeck=0.2,
        resistance=0.5,
        heat_capacity=5.0,
        sink_heat_capacity=20.0,
        sink_convection=1,
    ),
    plate=300.0,
    sink=340.0,
    pwm=255.0,
)
def test_a_sink_with_mass_is_integrated_closely(
    rig: Parameters, plate: float, sink: float, pwm: float
) -> None:
    start = np.array([plate, sink])
    advanced = advance(rig, start, pwm, 3.0)
    exact = integrated(rig, np.array([plate, sink, plate]), pwm, 3.0)[:2]
    assert np.max(np.abs(advanced - exact)) <= allowed(*(exact - start), plate - sink)


@given(
    rig=richest, plate=temperatures, sink=temperatures, sensor=temperatures, pwm=pwms
)
def test_lag_slope_and_ripple_agree_with_a_general_integrator(
    rig: Parameters, plate: float, sink: float, sensor: float, pwm: float
) -> None:
    start = np.array([plate, sink, sensor])
    advanced = advance(rig, start, pwm, 2.0)
    exact = integrated(rig, start, pwm, 2.0)
    assert np.max(np.abs(advanced - exact)) <= allowed(
        *(exact - start), plate - sink, plate - sensor
    )


@pytest.mark.parametrize("number", [1, 2, 5, 9, 14, 20, 27])
@pytest.mark.parametrize("rig", STRUCTURES[:3:2], ids=["held", "with mass"])
def test_the_loop_over_recorded_set_points_is_exact_to_a_micro_kelvin(
    recorded_hour: Callable[[int], Window], number: int, rig: Parameters
) -> None:
    """On the held sink against the closed solution; with a sink of mass against the general integrator,
    for the first minutes after each start and step, which is where the plate moves."""
    reference = recorded_hour(number).reference
    reference = reference if rig is STRUCTURES[0] else reference[:240]
    run = simulate_closed_loop(rig, reference, states=begin(rig, 22.85))
    states = np.array([296.0, rig["ambient"], 296.0])
    pid = Controller(Peltier.loop)
    output = np.empty(reference.size)
    commands = np.empty(reference.size)
    for k, r in enumerate(reference):
        output[k] = states[0] - KELVIN
        commands[k] = pid.step(r, output[k])[0]
        if rig is STRUCTURES[0]:
            states[0] = closed_tick(rig, states[0], commands[k], 1.0)
        else:
            states = integrated(rig, states, commands[k], 1.0)
    np.testing.assert_allclose(run.output, output, atol=1e-6, rtol=0)
    np.testing.assert_allclose(run.input, commands, atol=1e-4, rtol=0)


@given(rig=richest, plate=temperatures, sink=temperatures, pwm=pwms)
def test_all_heat_flows_sum_to_zero(
    rig: Parameters, plate: float, sink: float, pwm: float
) -> None:
    flows = quantities(rig, np.array([plate, sink, plate]), pwm)
    power = flows["voltage"] * flows["current"] + flows["ripple"]
    largest = max(abs(flows["from_plate"]), abs(flows["from_sink"]), abs(power))
    # `from_plate` and `from_sink` differ by the Thomson heat, which neither gains nor loses energy.
    assert abs(flows["from_plate"] + flows["from_sink"] + power) <= 1e-12 * (
        largest + 1000.0
    )
    assert abs(flows["current"]) <= rig["current_limit"]


def test_heat_flows_are_those_of_a_hand_calculation() -> None:
    rig = PLAIN.parameters(seebeck=0.05, resistance=1.9, conductance=0.5, ambient=300.0)
    flows = quantities(rig, np.array([320.0]), 255.0 / 12.0)  # 1 V across 2 Ω
    assert flows["current"] == pytest.approx((-1.0 + 0.05 * 20.0) / 2.0)
    assert flows["from_plate"] == pytest.approx(10.0)
    flows = quantities(rig, np.array([300.0]), -255.0 / 12.0)
    assert (flows["current"], flows["voltage"]) == pytest.approx((0.5, 0.95))
    assert flows["from_plate"] == pytest.approx(0.05 * 300.0 * 0.5 - 0.5 * 0.25 * 1.9)
    assert flows["from_sink"] == pytest.approx(-0.05 * 300.0 * 0.5 - 0.5 * 0.25 * 1.9)


def test_a_switched_drive_heats_as_its_pulses_do() -> None:
    # 2 Ω in the loop, 12 V for a quarter of the time, shorted otherwise: 6 A and 0 A.
    rig = PLAIN.parameters(
        seebeck=0.0,
        resistance=1.9,
        conductance=0.0,
        drive_ripple=1.0,
        ambient=300.0,
        current_limit=100.0,
    )
    flows = quantities(rig, np.array([300.0]), 255.0 / 4)
    assert flows["from_plate"] + flows["from_sink"] == pytest.approx(
        -0.25 * 6.0**2 * 1.9
    )
    assert flows["current"] == pytest.approx(-1.5)
    assert quantities(rig, np.array([300.0]), 255.0)["ripple"] == 0.0


def test_the_camera_sees_the_lag() -> None:
    model = Peltier.model("sink with mass, sensor lag")
    sharp = MASSIVE.parameters()
    late = model.parameters(sensor_lag=4.0)
    runs = [
        simulate_driven(rig, np.full(200, 100.0), states=begin(rig, 22.85))
        for rig in (sharp, late)
    ]
    # A slow ramp arrives τ late.
    shifted = np.interp(np.arange(30.0, 60.0) - 4.0, np.arange(200.0), runs[0].output)
    np.testing.assert_allclose(runs[1].output[30:60], shifted, atol=0.3)


def test_a_sink_of_huge_mass_is_a_held_sink() -> None:
    heavy = MASSIVE.parameters(**{**PLAIN.parameters(), "sink_heat_capacity": 1e12})
    runs = [
        simulate_closed_loop(rig, STEPS, states=begin(rig, 22.85))
        for rig in (PLAIN.parameters(), heavy)
    ]
    np.testing.assert_allclose(runs[1].output, runs[0].output, atol=1e-6)
    np.testing.assert_allclose(runs[1].input, runs[0].input, atol=1e-4)


@pytest.mark.parametrize(
    "rig", [PLAIN.parameters(conductance=0.1), MASSIVE.parameters(conductance=0.35)]
)
def test_without_current_the_plate_tends_to_the_room(rig: Parameters) -> None:
    response = simulate_driven(rig, np.zeros(8000), states=begin(rig, 76.85))
    assert np.all(np.diff(response.output) <= 0.0)
    assert response.output[-1] == pytest.approx(rig["ambient"] - KELVIN, abs=1e-6)


@given(rig=held, plate=st.floats(270.0, 380.0), pwm=st.tuples(pwms, pwms))
def test_more_pwm_is_warmer(
    rig: Parameters, plate: float, pwm: tuple[float, float]
) -> None:
    # Only while heat per ampere is positive on the cooling side: α·T_A above the Joule heat R·I. The swing of
    # a switched current is largest at half PWM, so that its heat may fall while the PWM rises.
    rig = rig.replace(drive_ripple=0.0)
    low, high = sorted(pwm)
    states = np.array([plate])
    if (
        quantities(rig, states, low)["current"] * rig["resistance"]
        > 0.9 * rig["seebeck"] * plate
    ):
        return
    cold, warm = (advance(rig, states, value, 0.1)[0] for value in (low, high))
    assert warm >= cold - 1e-11


@pytest.mark.parametrize("rig", STRUCTURES)
@pytest.mark.parametrize("seed", [None, 7])
def test_ticks_in_python_repeat_the_simulation_to_the_last_bit(
    rig: Parameters, seed: int | None
) -> None:
    sensor = None if seed is None else Peltier.sensor.realise(STEPS.size, 1.0, seed)
    states = begin(rig, 22.85)
    response = simulate_closed_loop(rig, STEPS, states=states, sensor=sensor)
    pid = Controller(Peltier.loop)
    last = None
    for k, reference in enumerate(STEPS):
        assert states.tobytes() == response.states[k].tobytes()
        last = (
            read(rig, states)
            if sensor is None
            else sensor.reading(k, read(rig, states), last)
        )
        assert last == response.output[k]
        pwm = pid.step(reference, last)[0]
        assert pwm == response.input[k]
        states = advance(rig, states, pwm, 1.0)


def test_noise_feeds_back_through_the_controller() -> None:
    rig = PLAIN.parameters()
    reference = np.full(2000, 40.0)
    sensor = Peltier.sensor.realise(2000, 1.0, 3)
    quiet = simulate_closed_loop(rig, reference, states=begin(rig, 40.0))
    noisy = simulate_closed_loop(rig, reference, states=begin(rig, 40.0), sensor=sensor)
    # White noise of 0.1 °C through P + D = 45.2 and D = 6.7 alone gives 4.6 PWM; the loop adds to it.
    assert 4.5 < np.std((noisy.input - quiet.input)[200:]) < 9.0


def test_other_periods_describe_the_same_rig() -> None:
    pwm = np.repeat([100.0, -50.0, 255.0], 60)
    rig = PLAIN.parameters()
    coarse = simulate_driven(rig, pwm, states=begin(rig, 22.85))
    fine = simulate_driven(
        rig, np.repeat(pwm, 4), states=begin(rig, 22.85), period=0.25
    )
    np.testing.assert_allclose(fine.output[::4], coarse.output, atol=1e-6)


@pytest.mark.parametrize(
    ("quadratic", "slope", "speed"),
    [
        (-1.0, 0.3, 0.5),
        (-1.0, 0.2, -0.5),
        (0.0, 0.0, 2.0),
        (0.0, -1.0, 2.0),
        (0.3, 0.1, 0.2),
    ],
)
@pytest.mark.parametrize("time", [1e-6, 0.5, 1.3])
def test_the_closed_solution_holds_what_it_says(
    quadratic: float, slope: float, speed: float, time: float
) -> None:
    distance = riccati_flow(quadratic, slope, speed, time)
    run = solve_ivp(
        lambda _t, y: quadratic * y**2 + slope * y + speed,
        (0, time),
        [0.0],
        "DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    assert distance == pytest.approx(run.y[0, -1], rel=1e-9)
    assert riccati_arrival(quadratic, slope, speed, distance) == pytest.approx(
        time, rel=1e-12
    )
    assert riccati_arrival(-1.0, 0.0, 1.0, 1.0 + 1e-9) == math.inf
