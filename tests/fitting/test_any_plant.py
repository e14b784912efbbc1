"""Plants that are not thermal: matched by what their files say, with their loop and without one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.support.plants import Lag, Motor
from twinmatch.dynamics import Sensor, begin, simulate_closed_loop, simulate_driven
from twinmatch.fitting import FittingError, Status, match
from twinmatch.signals import Window

MOTOR = Motor.model()
TRUTH = MOTOR.parameters(k=0.06, j=6e-4, b=2e-4)
LAG = Lag.model()


def spun(levels: tuple[float, ...] = (50.0, 150.0, 90.0), seed: int | None = 3) -> Window:
    """The motor in its speed loop, every 0.05 s, under a load that changes halfway."""
    reference = np.repeat(levels, 120)
    load = np.where(np.arange(reference.size) < reference.size // 2, 0.0, 0.05)[:, None]
    sensor = None if seed is None else Sensor(noise=0.2).realise(reference.size, 0.05, seed)
    run = simulate_closed_loop(
        TRUTH, reference, states=begin(TRUTH, 50.0), gains=Motor.loop, disturbances=load, sensor=sensor
    )
    return Window(reference, run.output, run.input, period=0.05, disturbances=load)


def driven(seed: int | None = 5) -> Window:
    """A lag under a staircase of voltages; nobody knows what commands them."""
    u = np.repeat([0.0, 3.0, -2.0, 4.0], 60)
    sensor = None if seed is None else Sensor(noise=0.01).realise(u.size, 1.0, seed)
    truth = LAG.parameters(gain=3.0, lag=7.0)
    run = simulate_driven(truth, u, states=begin(truth, 0.0), sensor=sensor)
    return Window(np.zeros(u.size), run.output, u)


def test_a_motor_is_found_without_noise() -> None:
    found = match(spun(seed=None), start=MOTOR.parameters())
    assert found.free == ("k", "j", "b")
    assert found.accepted
    for name in found.free:
        assert found.parameters[name] == pytest.approx(TRUTH[name], rel=1e-6)


def test_a_motor_is_found_through_its_sensor() -> None:
    found = match(spun(), start=MOTOR.parameters())
    assert found.accepted
    truth = np.array([TRUTH[name] for name in found.free])
    values = np.array([found.parameters[name] for name in found.free])
    assert np.all(np.abs(values - truth) < 4.0 * found.standard_errors)


def test_words_use_the_plant_s_own_units() -> None:
    still = match(spun((50.0, 51.0)), start=MOTOR.parameters())
    assert still.status is Status.NO_EXCITATION
    assert still.reason == "the set-point did not move by 4 rad/s within the window's 240 samples"


def test_a_lag_without_a_known_loop_is_found_from_its_input() -> None:
    found = match(driven(None), start=LAG.parameters())
    assert found.accepted
    assert found.parameters["gain"] == pytest.approx(3.0, rel=1e-6)
    assert found.parameters["lag"] == pytest.approx(7.0, rel=1e-6)
    assert found.fit.y == pytest.approx(1.0, abs=1e-6)
    assert np.isnan(found.fit.u)
    assert found.suggestion == ""


def test_what_a_driven_twin_says_of_its_error_is_that_of_plain_regression() -> None:
    """Noise meets nothing on its way round, so (JᵀJ)⁻¹ of scipy's own Jacobian is the covariance."""
    window = driven()
    found = match(window, start=LAG.parameters())

    def residuals(x: np.ndarray) -> np.ndarray:
        plant = LAG.parameters(gain=x[0], lag=x[1])
        run = simulate_driven(plant, window.input[2:], states=begin(plant, float(window.output[2])))
        return (window.output[2:] - run.output) / Lag.y.noise

    theirs = least_squares(residuals, [2.5, 6.0], x_scale=[1.0, 5.0], diff_step=1e-7)
    assert [found.parameters["gain"], found.parameters["lag"]] == pytest.approx(theirs.x, rel=1e-5)
    plain = np.sqrt(np.diag(np.linalg.inv(theirs.jac.T @ theirs.jac)) * found.chi2)
    assert found.standard_errors == pytest.approx(plain, rel=0.05)
    assert found.accepted


def test_an_input_that_stands_still_excites_nothing() -> None:
    still = Window(np.zeros(100), np.full(100, 6.0), np.full(100, 2.0))
    found = match(still, start=LAG.parameters())
    assert found.status is Status.NO_EXCITATION
    assert found.reason == "the input did not move by 2 V within the window's 100 samples"


def test_names_of_another_plant_are_refused() -> None:
    with pytest.raises(FittingError, match="'seebeck' cannot be free in Lag, lag"):
        match(driven(), start=LAG.parameters(), free=["seebeck"])
