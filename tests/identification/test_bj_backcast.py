"""The unconditional sum of squares against the Gaussian quadratic form written out."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.signal import lfilter

from twinmatch.identification import estimate, estimate_ladder
from twinmatch.identification.kernels import ROWS, Place, Task, evaluate, linearise, noise_factor
from twinmatch.identification.order import parse_order
from twinmatch.identification.prediction import linear_size, task_of
from twinmatch.signals import FloatArray

B = np.array([0.0, 1.0, 0.5])
C = np.array([1.0, 0.7, 0.2])
D = np.array([1.0, -1.2, 0.5])
F = np.array([1.0, -1.5, 0.7])
THETA = np.concatenate((C[1:], D[1:], F[1:]))


def window(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(count + 100)
    y = lfilter(B, F, u) + lfilter(C, D, 0.5 * rng.standard_normal(count + 100))
    return u[100:], y[100:]


def quadratic_form(u: FloatArray, y: FloatArray) -> float:
    """min over b, s of vᵀ Γ⁻¹ v, Γ the covariance of stationary C/D noise, by dense algebra."""
    impulse = np.eye(1, 2000)[0]
    h = lfilter(C, D, impulse)
    covariances = np.array([h[k:] @ h[: h.size - k] for k in range(u.size)])
    root = np.linalg.cholesky(scipy.linalg.toeplitz(covariances))
    through = [lfilter([1.0], F, x) for x in (u, impulse[: u.size])]
    delayed = [
        np.append(np.zeros(k), x[: x.size - k])
        for x, ks in zip(through, ((1, 2), (0, 1)), strict=True)
        for k in ks
    ]
    A, target = (scipy.linalg.solve_triangular(root, x, lower=True) for x in (np.array(delayed).T, y))
    return float(np.sum((target - A @ np.linalg.lstsq(A, target, rcond=None)[0]) ** 2))


def task(u: FloatArray, y: FloatArray) -> Task:
    return task_of(u, y, parse_order("22221"), "backcast")


def place(at: Task, theta: FloatArray) -> Place:
    return evaluate(at, theta, np.zeros((ROWS, at.pad + at.u.size)), True, True)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_cost_is_the_quadratic_form(seed: int) -> None:
    u, y = window(80, seed)
    assert place(task(u, y), THETA).cost == pytest.approx(quadratic_form(u, y), rel=1e-8)


def test_gradient_is_that_of_differences() -> None:
    problem = task(*window(80, 4))
    R = linearise(problem, place(problem, THETA), True, True)
    gradient = (R.T @ R)[linear_size(problem, True) : -1, -1]
    h = 1e-5
    for i, step in enumerate(h * np.eye(6)):
        slope = (place(problem, THETA + step).cost - place(problem, THETA - step).cost) / (4.0 * h)
        # The factor L is differentiated by a quotient of step 1e-6: six digits.
        assert gradient[i] == pytest.approx(slope, rel=1e-3, abs=1e-4 * np.max(np.abs(gradient)))


def test_noise_factor_is_the_covariance_of_the_state() -> None:
    rng = np.random.default_rng(5)
    L = noise_factor(C, D)
    ends = [lfilter(C, D, rng.standard_normal(200), zi=np.zeros(2))[1] for _ in range(4000)]
    # Four thousand draws: a variance good to √(2/4000), some 2.2 per cent.
    np.testing.assert_allclose(np.cov(np.array(ends).T), L @ L.T, rtol=0.1)


def test_estimates_recover_the_truth() -> None:
    model = estimate(*window(1500, 6), "22221", initial="backcast")
    truth = np.concatenate((B[1:], THETA))
    assert np.all(np.abs(model.coefficients - truth) < 4.0 * model.standard_errors)
    assert model.loss(*window(1500, 6)) <= model.variance


def test_without_noise_filter_nothing_is_weighed() -> None:
    u, y = window(200, 7)
    free, weighed = (estimate(u, y, "20021", initial=how) for how in ("estimate", "backcast"))
    np.testing.assert_allclose(weighed.coefficients, free.coefficients, rtol=1e-5)


def test_a_ladder_of_weighed_starts() -> None:
    models = estimate_ladder(*window(150, 8), ("22221", "33331"), initial="backcast")
    assert all(np.all(np.isfinite(model.standard_errors)) for model in models.values())
