"""Plant and controller as the margin sees them, against physics by hand and against simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from twinmatch.comparing import (
    DiscriminationError,
    Scales,
    loop_controller,
    loop_plant,
    nu_gap,
    nu_gap_of,
    stability_margin,
)
from twinmatch.comparing.polynomials import multiply
from twinmatch.dynamics import (
    Parameters,
    Pid,
    PidGains,
    PlantError,
    Structure,
    begin,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.plants import Peltier

PLATE = {"seebeck": 0.06, "conductance": 0.5, "heat_capacity": 27.0}
SINK = {"sink_heat_capacity": 300.0, "sink_convection": 4.0}
RIG = Peltier.model().parameters(**PLATE)
GAINS = Peltier.loop
KELVIN, VOLTS_PER_COUNT = 273.15, 12.0 / 255.0
UNITS = Scales(1.0, 1.0)


class Lagging(Peltier, name="lagging-peltier"):
    """A held sink seen through a lag, which no structure of the rig is."""

    followed = ""
    structures = {  # noqa: RUF012
        "sensor lag": Structure(free=("seebeck",), parts=frozenset({"sensor lag"}))
    }


def loop_margin(
    rig: Parameters, point: float, gains: PidGains = GAINS, scales: Scales | None = None
) -> float:
    return stability_margin(
        loop_plant(rig, point, gains, scales=scales), loop_controller(gains, scales=scales)
    )


def balance(rig: Parameters, celsius: float) -> tuple[float, float]:
    """Current and PWM that hold the plate on a held sink: α T I − ½ R I² + K (T − T_B) = 0."""
    plate = celsius + KELVIN
    peltier = rig["seebeck"] * plate
    root = math.sqrt(peltier**2 + 2 * rig["resistance"] * rig["conductance"] * (plate - rig["ambient"]))
    current = (peltier - root) / rig["resistance"]
    loop = rig["resistance"] + rig["bridge_resistance"]
    volts = -current * loop - rig["seebeck"] * (rig["ambient"] - plate)
    return current, volts / VOLTS_PER_COUNT


@pytest.mark.parametrize("celsius", [15.0, 30.0, 60.0, 90.0])
def test_the_plant_is_the_energy_balance_linearised_by_hand(celsius: float) -> None:
    plate, seebeck, capacity = celsius + KELVIN, RIG["seebeck"], RIG["heat_capacity"]
    current, _ = balance(RIG, celsius)
    loop = RIG["resistance"] + RIG["bridge_resistance"]
    by_current = seebeck * plate - RIG["resistance"] * current
    rate = (by_current * seebeck / loop + seebeck * current + RIG["conductance"]) / capacity
    drive = by_current * VOLTS_PER_COUNT / loop / capacity
    pole = math.exp(-rate)
    by_hand = control.tf([drive / rate * (1 - pole)], [1, -pole], 1.0)
    # with counts and °C as they are the plant's gain is far below 1; the ν-gap is then nearly linear in it
    assert nu_gap(loop_plant(RIG, celsius, scales=UNITS), by_hand) < 1e-8 * drive / rate
    scaled = loop_plant(RIG, celsius, scales=Scales(6.6, 255.0))
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
        Peltier.model("sink with mass").parameters(**PLATE, **SINK),
        Lagging.model().parameters(**PLATE, sensor_lag=1.5),
        Peltier.model("sink with mass, sensor lag").parameters(**PLATE, **SINK, sensor_lag=1.5),
    ],
    ids=["held sink", "sink with mass", "lagging sensor", "both"],
)
def test_the_plant_answers_a_small_pulse_as_the_simulation_does(rig: Parameters) -> None:
    """Two simulations a pulse apart."""
    d, n = (in_delays(p) for p in loop_plant(rig, 60.0, scales=UNITS).column)
    expected = lfilter(n, d, np.eye(1, 41)[0])
    settle = np.full(4000, 60.0)
    at_rest = simulate_closed_loop(rig, settle, states=begin(rig, 60.0))
    assert at_rest.output[-1] == pytest.approx(60.0, abs=1e-6)
    ran = []
    for pulse in (0.5, -0.5):
        pwm = np.full(4000 + 41, at_rest.input[-1])
        pwm[4000] += pulse
        ran.append(simulate_driven(rig, pwm, states=begin(rig, 60.0)).output[4000:])
    np.testing.assert_allclose(ran[0] - ran[1], expected, atol=1e-5 * np.abs(expected).max())


def test_the_controller_is_the_pid_that_runs() -> None:
    gains = GAINS
    symbol = loop_controller(gains, scales=UNITS)
    z = control.tf([1, 0], [1], 1.0)
    by_hand = gains.proportional + gains.integral / (z - 1) + gains.derivative * (z - 1) / z
    assert nu_gap_of(symbol, symbol) == 0.0
    assert nu_gap(symbol, by_hand) < 1e-12
    errors = np.random.default_rng(1).normal(0, 0.3, 60)
    pid = Pid(gains)
    ran = [pid.step(reference=float(e), output=0.0) for e in errors]
    assert np.abs(ran).max() < gains.high
    np.testing.assert_allclose(control.forced_response(by_hand, U=errors).outputs, ran, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("gains", "parts"),
    [
        (replace(GAINS, integral=0.0), 1),
        (replace(GAINS, derivative=0.0), 1),
        (replace(GAINS, integral=0.0, derivative=0.0), 0),
    ],
)
def test_a_controller_without_a_part_has_no_dynamics_of_it(gains: PidGains, parts: int) -> None:
    assert len(loop_controller(gains).column[0]) == parts + 1
    assert 0 < loop_margin(RIG, 50.0, gains) < 1


def test_the_margin_ends_where_the_simulated_loop_does() -> None:
    """All gains times k: the margin falls to 0 at the k above which a small movement grows."""
    low, high = 1.0, 200.0
    rig = Lagging.model().parameters(**PLATE, sensor_lag=2.0)

    def gains(k: float) -> PidGains:
        return replace(GAINS, proportional=38.57 * k, integral=1.46877 * k, derivative=6.66875 * k)

    scales = Scales.of(GAINS)
    assert loop_margin(rig, 50.0, gains(low), scales=scales) > 0
    assert loop_margin(rig, 50.0, gains(high), scales=scales) == 0.0
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        if loop_margin(rig, 50.0, gains(middle), scales=scales) > 0:
            low = middle
        else:
            high = middle

    def swing(k: float) -> float:
        """How much larger the last movements are than earlier ones, after a nudge of 1 mK."""
        reference = np.full(3000, 50.0)
        reference[2200:] += 1e-3
        run = simulate_closed_loop(rig, reference, states=begin(rig, 50.0), gains=gains(k)).input
        return float(np.ptp(run[2500:2600]) / np.ptp(run[2300:2400]))

    assert swing(0.97 * low) < 1.0 < swing(1.03 * high)


def test_the_scales_are_those_of_the_controller_and_only_their_ratio_counts() -> None:
    gains = GAINS
    assert Scales.of(gains) == (255.0 / 38.57, 255.0)
    margin = loop_margin(RIG, 50.0, gains)
    assert loop_margin(RIG, 50.0, gains, scales=Scales(2 * 255.0 / 38.57, 510.0)) == pytest.approx(margin)
    # not far below the best of all units, and far above bad ones
    others = [loop_margin(RIG, 50.0, gains, scales=Scales(t, 255.0)) for t in np.geomspace(0.5, 80.0, 40)]
    assert margin > 0.75 * max(others)
    assert min(others) < 0.25 * margin


def test_the_healthy_rig_is_held_with_room() -> None:
    """Plants a match may find; b ≥ 0.3 is what is usually asked of a loop (Zhou and Doyle)."""
    plant = loop_plant(RIG, 50.0)
    assert stability_margin(plant, loop_controller(GAINS)) == loop_margin(RIG, 50.0)
    assert loop_margin(RIG, 50.0) > 0.3
    hot = loop_plant(RIG, 90.0)
    assert nu_gap_of(plant, hot) < loop_margin(RIG, 50.0)


def test_operating_points_out_of_reach_are_refused() -> None:
    with pytest.raises(PlantError, match="no PWM between -255 and 255 holds it at 400 °C"):
        loop_plant(RIG, 300.0 + 100.0)
    with pytest.raises(PlantError, match="at -60 °C"):
        loop_margin(RIG, -60.0)
    with pytest.raises(DiscriminationError, match=r"PWM at 90 °C, beyond the controller's limits -10 and 10"):
        loop_plant(RIG, 90.0, replace(GAINS, low=-10.0, high=10.0))
    with pytest.raises(DiscriminationError, match="no proportional gain to scale by"):
        loop_margin(RIG, 50.0, replace(GAINS, proportional=0.0))
