"""The rig's plant and controller as the margin sees them, against physics by hand and against simulation."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from twinmatch.discrimination import (
    DiscriminationError,
    Scales,
    nu_gap,
    nu_gap_of,
    rig_controller,
    rig_margin,
    rig_plant,
    stability_margin,
)
from twinmatch.discrimination.polynomials import multiply
from twinmatch.plant import Driver, Pid, PidGains, RigParameters, simulate_closed_loop, simulate_driven
from twinmatch.signals import KELVIN

RIG = RigParameters(seebeck=0.06, conductance=0.5, heat_capacity=27.0)
UNITS = Scales(1.0, 1.0)


def balance(rig: RigParameters, celsius: float) -> tuple[float, float]:
    """Current and PWM that hold the plate on a held sink: α T I − ½ R I² + K (T − T_B) = 0."""
    driver, plate = Driver(), celsius + KELVIN
    peltier = rig.seebeck * plate
    root = math.sqrt(peltier**2 + 2 * rig.resistance * rig.conductance * (plate - rig.ambient))
    current = (peltier - root) / rig.resistance
    volts = -current * (rig.resistance + driver.bridge_resistance) - rig.seebeck * (rig.ambient - plate)
    return current, volts / driver.volts_per_count


@pytest.mark.parametrize("celsius", [15.0, 30.0, 60.0, 90.0])
def test_the_plant_is_the_energy_balance_linearised_by_hand(celsius: float) -> None:
    driver, plate = Driver(), celsius + KELVIN
    current, _ = balance(RIG, celsius)
    loop = RIG.resistance + driver.bridge_resistance
    by_current = RIG.seebeck * plate - RIG.resistance * current
    rate = (by_current * RIG.seebeck / loop + RIG.seebeck * current + RIG.conductance) / RIG.heat_capacity
    drive = by_current * driver.volts_per_count / loop / RIG.heat_capacity
    pole = math.exp(-rate)
    by_hand = control.tf([drive / rate * (1 - pole)], [1, -pole], 1.0)
    # with counts and °C as they are the plant's gain is far below 1; the ν-gap is then nearly linear in it
    assert nu_gap(rig_plant(RIG, celsius, scales=UNITS), by_hand) < 1e-8 * drive / rate
    scaled = rig_plant(RIG, celsius, scales=Scales(6.6, 255.0))
    assert nu_gap(scaled, by_hand * 255.0 / 6.6) < 1e-8


def in_delays(polynomial: list[int]) -> np.ndarray:
    """A polynomial in w = (z − 1)/(z + 1) as one in z⁻¹, without the denominator (1 + z⁻¹)^n."""
    total = [0] * len(polynomial)
    for k, c in enumerate(polynomial):
        term = [1]
        for factor in [[1, -1]] * k + [[1, 1]] * (len(polynomial) - 1 - k):
            term = multiply(term, factor)
        total = [a + c * b for a, b in zip(total, term, strict=True)]
    return np.array([t / 2**200 for t in total])


@pytest.mark.parametrize(
    "rig",
    [
        RIG,
        RIG.replace(sink_heat_capacity=300.0, sink_convection=4.0),
        RIG.replace(sensor_lag=1.5),
        RIG.replace(sink_heat_capacity=300.0, sink_convection=4.0, sensor_lag=1.5),
    ],
    ids=["held sink", "sink with mass", "lagging sensor", "both"],
)
def test_the_plant_answers_a_small_pulse_as_the_simulation_does(rig: RigParameters) -> None:
    """Two simulations a pulse apart."""
    d, n = (in_delays(p) for p in rig_plant(rig, 60.0, scales=UNITS).column)
    expected = lfilter(n, d, np.eye(1, 41)[0])
    settle = np.full(4000, 60.0)
    at_rest = simulate_closed_loop(rig, settle, plate=60.0 + KELVIN)
    assert at_rest.output[-1] == pytest.approx(60.0, abs=1e-6)
    ran = []
    for pulse in (0.5, -0.5):
        pwm = np.full(4000 + 41, at_rest.input[-1])
        pwm[4000] += pulse
        ran.append(simulate_driven(rig, pwm, plate=60.0 + KELVIN).output[4000:])
    np.testing.assert_allclose(ran[0] - ran[1], expected, atol=1e-5 * np.abs(expected).max())


def test_the_controller_is_the_pid_that_runs() -> None:
    gains = PidGains()
    symbol = rig_controller(gains, scales=UNITS)
    z = control.tf([1, 0], [1], 1.0)
    by_hand = gains.proportional + gains.integral / (z - 1) + gains.derivative * (z - 1) / z
    assert nu_gap_of(symbol, symbol) == 0.0
    assert nu_gap(symbol, by_hand) < 1e-12
    errors = np.random.default_rng(1).normal(0, 0.3, 60)
    pid = Pid(gains)
    ran = [pid.step(reference=float(e), output=0.0) for e in errors]
    assert np.abs(ran).max() < gains.limit
    np.testing.assert_allclose(control.forced_response(by_hand, U=errors).outputs, ran, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("gains", "parts"),
    [(PidGains(integral=0.0), 1), (PidGains(derivative=0.0), 1), (PidGains(integral=0.0, derivative=0.0), 0)],
)
def test_a_controller_without_a_part_has_no_dynamics_of_it(gains: PidGains, parts: int) -> None:
    assert len(rig_controller(gains).column[0]) == parts + 1
    assert 0 < rig_margin(RIG, 50.0, gains) < 1


def test_the_margin_ends_where_the_simulated_loop_does() -> None:
    """All gains times k: the margin falls to 0 at the k above which a small movement grows."""
    low, high = 1.0, 200.0
    rig = RIG.replace(sensor_lag=2.0)

    def gains(k: float) -> PidGains:
        return PidGains(38.57 * k, 1.46877 * k, 6.66875 * k)

    scales = Scales.of(PidGains())
    assert rig_margin(rig, 50.0, gains(low), scales=scales) > 0
    assert rig_margin(rig, 50.0, gains(high), scales=scales) == 0.0
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        if rig_margin(rig, 50.0, gains(middle), scales=scales) > 0:
            low = middle
        else:
            high = middle

    def swing(k: float) -> float:
        """How much larger the last movements are than earlier ones, after a nudge of 1 mK."""
        reference = np.full(3000, 50.0)
        reference[2200:] += 1e-3
        run = simulate_closed_loop(rig, reference, plate=50.0 + KELVIN, gains=gains(k)).input
        return float(np.ptp(run[2500:2600]) / np.ptp(run[2300:2400]))

    assert swing(0.97 * low) < 1.0 < swing(1.03 * high)


def test_the_scales_are_those_of_the_controller_and_only_their_ratio_counts() -> None:
    gains = PidGains()
    assert Scales.of(gains) == (255.0 / 38.57, 255.0)
    margin = rig_margin(RIG, 50.0, gains)
    assert rig_margin(RIG, 50.0, gains, scales=Scales(2 * 255.0 / 38.57, 510.0)) == pytest.approx(margin)
    # not far below the best of all units, and far above bad ones
    others = [rig_margin(RIG, 50.0, gains, scales=Scales(t, 255.0)) for t in np.geomspace(0.5, 80.0, 40)]
    assert margin > 0.75 * max(others)
    assert min(others) < 0.25 * margin


def test_the_healthy_rig_is_held_with_room() -> None:
    """Plants a match may find; b ≥ 0.3 is what is usually asked of a loop (Zhou and Doyle)."""
    plant = rig_plant(RIG, 50.0)
    assert stability_margin(plant, rig_controller()) == rig_margin(RIG, 50.0)
    assert rig_margin(RIG, 50.0) > 0.3
    hot = rig_plant(RIG, 90.0)
    assert nu_gap_of(plant, hot) < rig_margin(RIG, 50.0)


def test_operating_points_out_of_reach_are_refused() -> None:
    with pytest.raises(DiscriminationError, match="no PWM within ±255 holds this rig at 400 °C"):
        rig_plant(RIG, 300.0 + 100.0)
    with pytest.raises(DiscriminationError, match="at -60 °C"):
        rig_margin(RIG, -60.0)
    with pytest.raises(DiscriminationError, match="no proportional gain to scale by"):
        rig_margin(RIG, 50.0, PidGains(proportional=0.0))
