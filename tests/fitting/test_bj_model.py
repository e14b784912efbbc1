"""What can be done with a model."""

from __future__ import annotations

import subprocess
import sys

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from twinmatch.fitting import BoxJenkins, FittingError, Order, estimate

B = np.array([0.0, 1.0, 0.5])
C = np.array([1.0, -0.5, 0.2])
D = np.array([1.0, -1.2, 0.5])
F = np.array([1.0, -1.5, 0.7])


@pytest.fixture
def model() -> BoxJenkins:
    order = Order(2, 2, 2, 2, 1)
    return BoxJenkins(order, B, C, D, F, 0.01, np.zeros((8, 8)), np.zeros(4), 100, period=0.5)


@pytest.fixture
def u() -> np.ndarray:
    return np.random.default_rng(5).standard_normal(150)


def test_transfer_function_is_that_of_the_model(model: BoxJenkins, u: np.ndarray) -> None:
    system = model.transfer_function
    assert system.dt == 0.5
    times = np.arange(u.size) * 0.5
    answer = control.forced_response(system, times, u).outputs
    np.testing.assert_allclose(model.simulate(u), answer, rtol=1e-9, atol=1e-10)


def test_transfer_function_round_trip(model: BoxJenkins) -> None:
    back = BoxJenkins.from_transfer_function(model.transfer_function, C=C, D=D, variance=0.01)
    assert back.order == model.order
    for name in ("B", "C", "D", "F"):
        np.testing.assert_allclose(getattr(back, name), getattr(model, name))
    assert back.period == 0.5
    assert np.isnan(back.covariance).all()


def test_unstated_period_counts_as_one() -> None:
    assert BoxJenkins.from_transfer_function(control.tf([1.0], [1.0, -0.5], True)).period == 1.0


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (control.tf([1.0], [1.0, 1.0]), "discretise"),
        (control.tf([1.0, 0.0, 0.0], [1.0, 1.0], 1.0), "needs future inputs"),
        (control.ss(np.eye(1), np.ones((1, 2)), np.eye(1), np.zeros((1, 2)), 1.0), "2 inputs"),
    ],
)
def test_systems_that_are_not_models(system: control.TransferFunction, message: str) -> None:
    with pytest.raises(FittingError, match=message):
        BoxJenkins.from_transfer_function(system)


def test_control_is_not_imported_before_it_is_needed() -> None:
    code = "import sys, twinmatch.fitting; sys.exit('control' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_simulation_continues_from_recorded_outputs(model: BoxJenkins, u: np.ndarray) -> None:
    whole = lfilter(B, F, u, zi=[0.3, -0.2])[0]
    np.testing.assert_allclose(model.simulate(u, outputs=whole[:3]), whole, rtol=1e-9, atol=1e-10)
    np.testing.assert_array_equal(model.simulate(u, outputs=[5.0, 6.0, 7.0])[:3], [5.0, 6.0, 7.0])


def test_more_recorded_outputs_than_inputs(model: BoxJenkins, u: np.ndarray) -> None:
    with pytest.raises(FittingError, match="3 recorded outputs for 2"):
        model.simulate(u[:2], outputs=[1.0, 2.0, 3.0])


def test_prediction_errors_are_the_innovations(model: BoxJenkins, u: np.ndarray) -> None:
    e = 0.1 * np.random.default_rng(6).standard_normal(u.size)
    y = lfilter(B, F, u) + lfilter(C, D, e)
    np.testing.assert_allclose(model.prediction_errors(u, y, "zero"), e, atol=1e-10)
    assert model.loss(u, y, "zero") == pytest.approx(np.mean(e**2))


def test_estimated_start_finds_any_transient(model: BoxJenkins, u: np.ndarray) -> None:
    y = lfilter(B, F, u, zi=[20.0, -15.0])[0] + lfilter(C, D, np.zeros(u.size), zi=[3.0, 1.0])[0]
    np.testing.assert_allclose(model.prediction_errors(u, y), 0.0, atol=1e-7)
    assert model.loss(u, y, "zero") > 1.0


def test_own_initial_state_gives_the_loss_of_the_estimate() -> None:
    rng = np.random.default_rng(9)
    u = rng.standard_normal(300)
    y = lfilter(B, F, u) + lfilter(C, D, 0.1 * rng.standard_normal(300))
    found = estimate(u[50:], y[50:], "22221")
    assert found.loss(u[50:], y[50:], found.initial_state) == pytest.approx(found.variance, rel=1e-9)
    assert found.loss(u[50:], y[50:]) == pytest.approx(found.variance, rel=1e-9)


def test_arrays_of_a_model_cannot_be_written(model: BoxJenkins) -> None:
    with pytest.raises(ValueError, match="read-only"):
        model.B[0] = 1.0


def test_unknown_initial(model: BoxJenkins, u: np.ndarray) -> None:
    with pytest.raises(FittingError, match="'backwards' is unknown"):
        model.prediction_errors(u, u, "backwards")


def test_signals_that_cannot_be_used(model: BoxJenkins, u: np.ndarray) -> None:
    with pytest.raises(FittingError, match="149 samples and output y 150"):
        model.prediction_errors(u[1:], u)
    with pytest.raises(FittingError, match="nan at sample 7"):
        model.simulate(np.where(np.arange(20) == 7, np.nan, 0.0))
    with pytest.raises(FittingError, match="give one value per sample"):
        model.simulate(np.zeros((2, 2)))
