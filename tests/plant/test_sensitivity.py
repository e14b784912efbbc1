"""Derivatives of the closed loop, against differences of the plant's own simulation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinmatch.plant import Driver, PidGains, PidState, PlantError, RigParameters, noise_sensitivity
from twinmatch.plant.rig import simulate_closed_loop
from twinmatch.plant.sensitivity import DIFFERENTIABLE, LoopSensitivity, noise_scores

PLATE = 303.15
WEIGHTS = (1 / 0.1, 1 / 7.0)


def values_of(rig: RigParameters) -> np.ndarray:
    return np.array([getattr(rig, name) for name in DIFFERENTIABLE])


def outputs(rig: RigParameters, reference: np.ndarray, driver: Driver) -> np.ndarray:
    response = simulate_closed_loop(
        rig, reference, plate=PLATE, controller=PidState(20.0, 0.3), driver=driver
    )
    return np.stack([response.output, response.input])


def loop(names: tuple[str, ...], reference: np.ndarray, driver: Driver) -> LoopSensitivity:
    return LoopSensitivity(names, reference, plate=PLATE, controller=PidState(20.0, 0.3), driver=driver)


rigs = st.builds(
    RigParameters,
    seebeck=st.floats(0.01, 0.12),
    resistance=st.floats(2.0, 6.0),
    conductance=st.floats(0.0, 1.5),
    heat_capacity=st.floats(25.0, 100.0),  # a lighter plate makes the loop unstable
    ambient=st.floats(285.0, 305.0),
)


@settings(max_examples=30)
@given(rig=rigs, low=st.floats(15.0, 45.0), step=st.floats(-25.0, 45.0), limit=st.sampled_from([1.5, 5.0]))
def test_the_loop_is_the_plants_and_its_derivatives_are_those_of_differences(
    rig: RigParameters, low: float, step: float, limit: float
) -> None:
    reference, driver = np.repeat([low, low + step, low + step / 2], 30), Driver(current_limit=limit)
    found = loop(DIFFERENTIABLE, reference, driver)(values_of(rig))
    simulated = outputs(rig, reference, driver)
    np.testing.assert_allclose(found.temperature, simulated[0], atol=1e-8)
    np.testing.assert_allclose(found.pwm, simulated[1], atol=1e-6)
    for p, name in enumerate(DIFFERENTIABLE):
        value = getattr(rig, name)
        size = 1e-6 * max(value, 0.1)
        # One-sided and of second order, because a conductance of 0 has only one side.
        near, ahead = (outputs(rig.replace(**{name: value + n * size}), reference, driver) for n in (1, 2))
        differences = (4 * near - ahead - 3 * simulated) / (2 * size)
        exact = found.derivative[:, :, p]
        scale = np.max(np.abs(exact), axis=1, keepdims=True) + 1e-3
        # Differences may straddle the tick in which the PWM leaves its limit; the derivative does not.
        assert np.mean(np.abs(differences - exact) > 1e-4 * scale) < 0.05


def test_the_limiter_is_passed_within_a_tick() -> None:
    rig, driver = RigParameters(seebeck=0.1, conductance=0.5, heat_capacity=30.0), Driver(current_limit=2.5)
    reference = np.repeat([30.0, 70.0, 35.0], 60)
    found = loop(("seebeck",), reference, driver)(values_of(rig))
    current = (-found.pwm * 12 / 255 - 0.1 * (296.0 - 273.15 - found.temperature)) / 3.4
    assert np.sum(np.abs(current) > 2.5) >= 2
    size = 1e-7
    change = outputs(rig.replace(seebeck=0.1 + size), reference, driver)
    change -= outputs(rig.replace(seebeck=0.1 - size), reference, driver)
    np.testing.assert_allclose(found.derivative[:, :, 0], change / (2 * size), rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("time_scale", [1e-3, 1.0, 30.0])
def test_fast_and_slow_plates_have_derivatives_too(time_scale: float) -> None:
    """Short ticks use series, long ones exponentials: the same plate at several sample times."""
    gains = PidGains(proportional=3.0, integral=0.1 / time_scale, derivative=0.0, period=time_scale)
    rig, reference = RigParameters(conductance=0.6), np.repeat([30.0, 45.0], 40)
    run = LoopSensitivity(("conductance", "heat_capacity"), reference, plate=PLATE, gains=gains)
    found = run(values_of(rig))
    for p, name in enumerate(("conductance", "heat_capacity")):
        size = 1e-5 * getattr(rig, name)
        change = [
            simulate_closed_loop(
                rig.replace(**{name: getattr(rig, name) + sign * size}), reference, plate=PLATE, gains=gains
            ).output
            for sign in (1, -1)
        ]
        differences = (change[0] - change[1]) / (2 * size)
        scale = np.max(np.abs(differences))
        np.testing.assert_allclose(found.derivative[0, :, p], differences, atol=1e-5 * scale + 1e-8)


@settings(max_examples=30)
@given(rig=rigs, low=st.floats(15.0, 45.0), step=st.floats(-25.0, 45.0))
def test_the_normal_equations_are_those_of_the_arrays(rig: RigParameters, low: float, step: float) -> None:
    names = ("seebeck", "conductance", "heat_capacity")
    reference = np.repeat([low, low + step], 50)
    run = loop(names, reference, Driver())
    measured = outputs(RigParameters(), reference, Driver())
    found = run(values_of(rig))
    left = ((measured - np.stack([found.temperature, found.pwm])) * np.array(WEIGHTS)[:, None]).ravel()
    jacobian = (-found.derivative * np.array(WEIGHTS)[:, None, None]).reshape(-1, 3)
    cost, gradient, hessian = run.normal_equations(values_of(rig), measured, WEIGHTS)
    assert cost == pytest.approx(left @ left, rel=1e-9)
    size = np.sqrt(np.diag(hessian))
    np.testing.assert_allclose(gradient / size, jacobian.T @ left / size, atol=1e-9 * (1 + np.sqrt(cost)))
    np.testing.assert_allclose(hessian / np.outer(size, size), (jacobian.T @ jacobian) / np.outer(size, size))


@pytest.mark.parametrize("levels", [(30.0, 34.0), (30.0, 75.0, 40.0)])
def test_noise_goes_round_the_loop_as_in_the_plant(levels: tuple[float, ...]) -> None:
    """Sums over all samples at once, against the response to the noise of each sample by differences."""
    names, gains = ("seebeck", "conductance", "heat_capacity"), PidGains()
    rig, reference = RigParameters(conductance=0.6, heat_capacity=30.0), np.repeat(levels, 50)
    run = LoopSensitivity(names, reference, plate=PLATE)
    found = run(values_of(rig))
    weighed = -found.derivative * np.array(WEIGHTS)[:, None, None]
    sums, mean_square = noise_scores(found, weighed, (1.0, 0.1 / 7.0), gains)
    response = noise_sensitivity(rig, reference, plate=PLATE)
    starts = [simulate_closed_loop(rig, reference, plate=PLATE + size) for size in (1e-3, 0.0)]
    response[0, 0] -= (starts[0].output - starts[1].output) / 1e-3
    response[0, 1] -= (starts[0].input - starts[1].input) / 1e-3
    left = response * np.array([1.0, 0.1 / 7.0])[:, None]
    expected = np.einsum("kcj,cjp->kp", left, weighed)
    np.testing.assert_allclose(sums, expected, atol=2e-4 * np.max(np.abs(expected)))
    assert mean_square == pytest.approx(np.sum(np.square(left)) / (2 * reference.size), rel=1e-3)


def test_the_same_run_gives_the_same_bits() -> None:
    run = loop(DIFFERENTIABLE, np.repeat([30.0, 60.0], 100), Driver())
    one, two = (run(values_of(RigParameters())) for _ in range(2))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(one, two, strict=True))


def test_only_a_plain_rig_is_differentiated() -> None:
    assert LoopSensitivity.handles(RigParameters(seebeck=0.1, resistance=2.0, ambient=290.0))
    assert not LoopSensitivity.handles(RigParameters(sink_heat_capacity=300.0, sink_convection=3.0))
    assert not LoopSensitivity.handles(RigParameters(sensor_lag=1.0))
    assert not LoopSensitivity.handles(RigParameters(seebeck_slope=1e-4))
    with pytest.raises(PlantError, match="sensitivity: 'sink_convection' is none of seebeck, resistance"):
        LoopSensitivity(("sink_convection",), np.zeros(5), plate=PLATE)
    with pytest.raises(PlantError, match="give kelvin"):
        LoopSensitivity(("seebeck",), np.zeros(5), plate=30.0)
