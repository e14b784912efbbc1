"""The rig as a whole: heat, sink with mass, closed loop, one tick at a time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mpmath import mp

from twinmatch.plant import (
    Camera,
    CameraRealisation,
    Driver,
    Pid,
    PidGains,
    PlantError,
    PlantState,
    RigParameters,
    advance,
    heat_flows,
    noise_sensitivity,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.plant.kernels import lagged
from twinmatch.signals import KELVIN

Integrator = Callable[[RigParameters, PlantState, float, float], PlantState]

rigs = st.builds(
    RigParameters,
    seebeck=st.floats(0.01, 0.2),
    resistance=st.floats(0.5, 10.0),
    conductance=st.floats(0.0, 2.0),
    heat_capacity=st.floats(5.0, 150.0),
    ambient=st.floats(263.0, 323.0),
    sink_heat_capacity=st.one_of(st.just(math.inf), st.floats(20.0, 5000.0)),
    sink_convection=st.floats(0.0, 100.0),
    sensor_lag=st.one_of(st.just(0.0), st.floats(1e-3, 1e3)),
    seebeck_slope=st.one_of(st.just(0.0), st.floats(-5e-5, 5e-4)),
    drive_ripple=st.one_of(st.just(0.0), st.floats(0.0, 1.0)),
)
temperatures = st.floats(260.0, 400.0)
pwms = st.floats(-255.0, 255.0)

STEPS = np.repeat([40.0, 75.0, 25.0], 120)
WITH_SINK = RigParameters(sink_heat_capacity=300.0, sink_convection=3.0)
RICHEST = WITH_SINK.replace(sensor_lag=1.5, seebeck_slope=1e-4, drive_ripple=1.0)
STRUCTURES = [
    RigParameters(),
    WITH_SINK,
    RigParameters(sensor_lag=1.5),
    RigParameters(seebeck_slope=1e-4),
    RigParameters(drive_ripple=1.0),
    RICHEST,
]


@given(rig=rigs, plate=temperatures, sink=temperatures, pwm=pwms)
def test_energy_balances(rig: RigParameters, plate: float, sink: float, pwm: float) -> None:
    flows = heat_flows(rig, PlantState(plate, sink), pwm)
    largest = max(abs(flows.plate), abs(flows.sink), abs(flows.voltage * flows.current))
    power = flows.voltage * flows.current + flows.ripple
    assert abs(flows.plate + flows.sink + power) <= 1e-13 * (largest + 1000.0)
    assert abs(flows.current) <= Driver().current_limit


def test_heat_flows_of_a_hand_calculation() -> None:
    rig = RigParameters(seebeck=0.05, resistance=1.9, conductance=0.5)
    flows = heat_flows(rig, PlantState(plate=320.0, sink=300.0), 255.0 / 12.0)  # 1 V across 2 Ω
    assert flows.current == pytest.approx((-1.0 + 0.05 * 20.0) / 2.0)
    assert flows.plate == pytest.approx(10.0)
    flows = heat_flows(rig, PlantState(plate=300.0, sink=300.0), -255.0 / 12.0)
    assert (flows.current, flows.voltage) == pytest.approx((0.5, 0.95))
    assert flows.plate == pytest.approx(0.05 * 300.0 * 0.5 - 0.5 * 0.25 * 1.9)
    assert flows.sink == pytest.approx(-0.05 * 300.0 * 0.5 - 0.5 * 0.25 * 1.9)


def test_a_switched_drive_heats_as_its_pulses_do() -> None:
    # 2 Ω in the loop, 12 V for a quarter of the time, shorted otherwise: 6 A and 0 A.
    rig = RigParameters(seebeck=0.0, resistance=1.9, conductance=0.0, drive_ripple=1.0)
    driver = Driver(current_limit=100.0)
    flows = heat_flows(rig, PlantState(300.0, 300.0), 255.0 / 4, driver)
    assert flows.plate + flows.sink == pytest.approx(-0.25 * 6.0**2 * 1.9)
    assert flows.current == pytest.approx(-1.5)
    always = heat_flows(rig, PlantState(300.0, 300.0), 255.0, driver)
    assert always.ripple == 0.0


@given(
    rig=rigs.filter(lambda rig: rig.sink_has_mass),
    plate=temperatures,
    sink=temperatures,
    pwm=st.one_of(st.sampled_from([-255.0, 255.0]), pwms),
)
@example(
    rig=RigParameters(
        seebeck=0.2, resistance=0.5, heat_capacity=5.0, sink_heat_capacity=20.0, sink_convection=1
    ),
    plate=300.0,
    sink=340.0,
    pwm=255.0,
)
def test_a_sink_with_mass_is_integrated_closely(
    integrated: Integrator, rig: RigParameters, plate: float, sink: float, pwm: float
) -> None:
    end = advance(rig, PlantState(plate, sink), pwm, 3.0)
    exact = integrated(rig, PlantState(plate, sink), pwm, 3.0)
    assert abs(end.plate - exact.plate) < 1e-6
    assert abs(end.sink - exact.sink) < 1e-6
    assert abs(end.sensor - exact.sensor) < 1e-6


@given(
    rig=rigs.map(lambda rig: rig.replace(sink_heat_capacity=math.inf)),
    plate=temperatures,
    sensor=temperatures,
    pwm=st.one_of(st.sampled_from([-255.0, 255.0]), pwms),
)
@example(rig=RigParameters(sensor_lag=2.0), plate=296.0, sensor=296.0, pwm=255.0)
@example(rig=RigParameters(resistance=1.0, sensor_lag=0.5), plate=296.0, sensor=290.0, pwm=255.0)
@example(rig=RigParameters(resistance=1.0, drive_ripple=0.7), plate=296.0, sensor=290.0, pwm=120.0)
@example(rig=RigParameters(seebeck_slope=2e-4, sensor_lag=2.0), plate=350.0, sensor=350.0, pwm=-255.0)
def test_lag_slope_and_ripple_on_a_held_sink_agree_with_a_general_integrator(
    integrated: Integrator, rig: RigParameters, plate: float, sensor: float, pwm: float
) -> None:
    start = PlantState(plate, rig.ambient, sensor)
    end, exact = advance(rig, start, pwm, 2.0), integrated(rig, start, pwm, 2.0)
    assert end.sink == start.sink
    assert abs(end.plate - exact.plate) < 1e-6
    # The cubic between two points of the exact solution is off by λ⁴h⁴/384 of the way, λh at most 0.1.
    assert abs(end.sensor - exact.sensor) < 2e-5


@given(time=st.floats(1e-3, 10.0), lag=st.floats(1e-6, 1e6), jerk=st.floats(-1.0, 1.0))
def test_the_lag_of_a_cubic_is_exact(time: float, lag: float, jerk: float) -> None:
    # Where the lag has settled it shows x − τ·Dx + τ²·D²x − τ³·D³x of the cubic x(t) = 300 + t + jerk·t³.
    def settled(t: mp.mpf) -> mp.mpf:
        own = mp.mpf(300) + t + mp.mpf(jerk) * t**3
        slope = 1 + 3 * mp.mpf(jerk) * t**2
        return (
            own - lag * slope + mp.mpf(lag) ** 2 * 6 * mp.mpf(jerk) * t - mp.mpf(lag) ** 3 * 6 * mp.mpf(jerk)
        )

    with mp.workdps(60):
        exact = settled(mp.mpf(time)) + (290 - settled(mp.mpf(0))) * mp.exp(-mp.mpf(time) / mp.mpf(lag))
    way, rate = time + jerk * time**3, 1.0 + 3.0 * jerk * time**2
    found = lagged(lag, 290.0, 300.0, 1.0, 300.0 + way, rate, time)
    assert found == pytest.approx(float(exact), rel=1e-12)


def test_the_camera_sees_the_lag_in_the_loop() -> None:
    lagging = simulate_driven(RigParameters(sensor_lag=4.0), np.full(200, 100.0), plate=296.0)
    sharp = simulate_driven(RigParameters(), np.full(200, 100.0), plate=296.0)
    # A slow ramp arrives τ late; at rest both agree.
    assert np.all(np.diff(sharp.output) > 0)
    late = np.interp(np.arange(30.0, 60.0) - 4.0, np.arange(200.0), sharp.output)
    np.testing.assert_allclose(lagging.output[30:60], late, atol=0.3)
    assert lagging.output[-1] == pytest.approx(sharp.output[-1], abs=1e-3)


def test_a_sink_of_huge_mass_is_a_held_sink() -> None:
    held = simulate_closed_loop(RigParameters(), STEPS, plate=296.0)
    heavy = simulate_closed_loop(RigParameters(sink_heat_capacity=1e12), STEPS, plate=296.0)
    np.testing.assert_allclose(heavy.output, held.output, atol=1e-6)
    np.testing.assert_allclose(heavy.input, held.input, atol=1e-4)


@pytest.mark.parametrize("rig", [RigParameters(conductance=0.1), WITH_SINK])
def test_without_current_the_plate_tends_to_the_sink(rig: RigParameters) -> None:
    response = simulate_driven(rig, np.zeros(8000), plate=350.0)
    assert np.all(np.diff(response.output) <= 0.0)
    assert response.output[-1] == pytest.approx(rig.ambient - KELVIN, abs=1e-6)


@given(rig=rigs, plate=st.floats(270.0, 380.0), pwm=st.tuples(pwms, pwms))
def test_more_pwm_is_warmer(rig: RigParameters, plate: float, pwm: tuple[float, float]) -> None:
    # Only while heat per ampere is positive on the cooling side: α·T_A above the Joule heat R·I. The swing of
    # a switched current is largest at half PWM, so that its heat may fall while the PWM rises.
    rig = rig.replace(drive_ripple=0.0)
    low, high = sorted(pwm)
    state = PlantState(plate, rig.ambient)
    if heat_flows(rig, state, low).current * rig.resistance > 0.9 * rig.seebeck * plate:
        return
    cold, warm = (advance(rig, state, value, 0.1).plate for value in (low, high))
    assert warm >= cold - 1e-11


@pytest.mark.parametrize("rig", STRUCTURES)
@pytest.mark.parametrize("seed", [None, 7])
def test_ticks_in_python_repeat_the_simulation_to_the_last_bit(rig: RigParameters, seed: int | None) -> None:
    camera = None if seed is None else Camera(flat_field_period=40.0).realise(STEPS.size, 1.0, seed)
    response = simulate_closed_loop(rig, STEPS, plate=296.0, sink=300.0, camera=camera)
    pid, state, last = Pid(), PlantState(296.0, 300.0), None
    for k, reference in enumerate(STEPS):
        last = state.sensor - KELVIN if camera is None else camera.reading(k, state.sensor, last)
        assert last == response.output[k]
        pwm = pid.step(reference, last)
        assert pwm == response.input[k]
        state = advance(rig, state, pwm)


@pytest.mark.parametrize("rig", STRUCTURES)
def test_driven_by_its_own_pwm_the_plant_repeats_the_closed_loop(rig: RigParameters) -> None:
    closed = simulate_closed_loop(rig, STEPS, plate=296.0)
    again = simulate_driven(rig, closed.input, plate=296.0)
    np.testing.assert_array_equal(again.output, closed.output)
    np.testing.assert_array_equal(again.input, closed.input)


def test_the_loop_settles_on_its_reference() -> None:
    response = simulate_closed_loop(RigParameters(), np.full(1500, 60.0), plate=296.0)
    assert response.output[-1] == pytest.approx(60.0, abs=1e-6)


def test_noise_feeds_back_through_the_controller() -> None:
    reference = np.full(2000, 40.0)
    camera = Camera(resolution=0.0, flat_field_period=None).realise(2000, 1.0, 3)
    quiet = simulate_closed_loop(RigParameters(), reference, plate=313.15)
    noisy = simulate_closed_loop(RigParameters(), reference, plate=313.15, camera=camera)
    # White noise of 0.1 °C through P + D = 45.2 and D = 6.7 alone gives 4.6 PWM; the loop adds to it.
    assert 4.5 < np.std((noisy.input - quiet.input)[200:]) < 9.0


@pytest.mark.parametrize("rig", STRUCTURES)
def test_the_noise_sensitivity_is_the_derivative_of_the_closed_loop(rig: RigParameters) -> None:
    reference = np.repeat([40.0, 55.0], 20)
    start = {"plate": 310.0, "sink": 300.0, "controller": Pid().state}
    derivative = noise_sensitivity(rig, reference, **start)
    never = np.zeros(40, dtype=bool)
    for k in (0, 7, 20, 39):
        bump = np.zeros(40)
        bump[k] = 1e-4
        up, down = (
            simulate_closed_loop(rig, reference, camera=CameraRealisation(sign * bump, never, 0.0), **start)
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(derivative[k, 0], (up.output - down.output) / 2e-4, atol=1e-3)
        np.testing.assert_allclose(derivative[k, 1], (up.input - down.input) / 2e-4, atol=1e-2)
    assert not np.any(derivative[np.tril_indices(40, -1)[0], :, np.tril_indices(40, -1)[1]])


def test_other_periods_describe_the_same_rig() -> None:
    pwm = np.repeat([100.0, -50.0, 255.0], 60)
    coarse = simulate_driven(RigParameters(), pwm, plate=296.0)
    fine = simulate_driven(RigParameters(), np.repeat(pwm, 4), plate=296.0, period=0.25)
    np.testing.assert_allclose(fine.output[::4], coarse.output, rtol=1e-12)


def test_an_empty_run_is_empty() -> None:
    assert simulate_closed_loop(RigParameters(), [], plate=296.0).output.size == 0


def test_what_cannot_be_run_is_refused() -> None:
    rig = RigParameters()
    with pytest.raises(PlantError, match=r"closed loop: plate is 23\.0 K; give kelvin"):
        simulate_closed_loop(rig, [40.0], plate=23.0)
    with pytest.raises(PlantError, match="driven plant: sink is nan K"):
        simulate_driven(rig, [40.0], plate=296.0, sink=math.nan)
    with pytest.raises(PlantError, match="reference is nan at sample 1"):
        simulate_closed_loop(rig, [40.0, math.nan], plate=296.0)
    with pytest.raises(PlantError, match=r"pwm has shape \(1, 1\)"):
        simulate_driven(rig, [[40.0]], plate=296.0)
    with pytest.raises(PlantError, match="the period is 0 s"):
        simulate_driven(rig, [40.0], plate=296.0, period=0)
    with pytest.raises(PlantError, match="pwm is inf"):
        advance(rig, PlantState(296.0, 296.0), math.inf)
    with pytest.raises(PlantError, match="camera was realised for 2 samples, the reference has 3"):
        simulate_closed_loop(
            rig, [1.0, 2.0, 3.0], plate=296.0, camera=CameraRealisation(np.zeros(2), np.zeros(2, bool), 0.0)
        )
    with pytest.raises(PlantError, match="too short for a period of 1 s"):
        advance(RigParameters(heat_capacity=1e-4, sink_heat_capacity=20.0), PlantState(296.0, 296.0), 0.0)
    with pytest.raises(PlantError, match="the period is -1"):
        advance(rig, PlantState(296.0, 296.0), 0.0, PidGains().period - 2.0)
