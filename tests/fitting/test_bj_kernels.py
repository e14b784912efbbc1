"""The compiled arithmetic against scipy, and derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from twinmatch.fitting.data import Order
from twinmatch.fitting.delayed import SLACK, cholesky, correlate, ridge_solve, triangularise
from twinmatch.fitting.polynomials import LARGEST_ROOT, all_pole, boundary_normals, fir, is_stable, stabilise
from twinmatch.fitting.prediction import (
    ROWS,
    Place,
    Task,
    curvature,
    evaluate,
    linear_size,
    linearise,
    task_of,
)
from twinmatch.signals import FloatArray

ROOTS = st.lists(st.floats(-0.9, 0.9), min_size=0, max_size=4)


def test_filters_are_scipys() -> None:
    rng = np.random.default_rng(1)
    x, a, b = rng.standard_normal(200), np.array([1.0, -1.1, 0.3, 0.1]), rng.standard_normal(4)
    np.testing.assert_allclose(fir(b, x), lfilter(b, [1.0], x), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(all_pole(a, x), lfilter([1.0], a, x), rtol=1e-12, atol=1e-13)


@given(st.integers(0, 2**31), st.integers(0, 5), st.integers(1, 4), st.integers(0, 3))
def test_normal_matrix_and_triangle_agree_with_the_matrix(seed: int, d: int, n: int, first: int) -> None:
    rng = np.random.default_rng(seed)
    pad, count = 9 + SLACK, 117
    signals = np.zeros((2, pad + count))
    signals[:, pad:] = rng.standard_normal((2, count))
    spans = np.array([[0, d, n], [1, 1, 3], [0, 0, 1 if d else 0]], dtype=np.int64)
    columns = [signals[s, pad - k : pad - k + count] for s, at, m in spans for k in range(at, at + m)]
    matrix = np.stack(columns, axis=1)[first:]
    # Sums of 117 products of order 1: rounding is some 1e-14 of them.
    G = correlate(signals, pad + first, spans)
    np.testing.assert_allclose(np.triu(G), np.triu(matrix.T @ matrix), atol=1e-11)
    R = triangularise(signals, pad + first, spans)
    np.testing.assert_allclose(R.T @ R, matrix.T @ matrix, atol=1e-11)
    np.testing.assert_allclose(np.abs(cholesky(G)), np.abs(R), atol=1e-9)


def test_dependent_columns_are_dropped_by_cholesky() -> None:
    R = cholesky(np.array([[2.0, 2.0], [2.0, 2.0]]))
    np.testing.assert_array_equal(R[1], 0.0)


def test_ridge_solution_is_that_of_the_stacked_system() -> None:
    rng = np.random.default_rng(3)
    R, rhs, damping = np.triu(rng.standard_normal((5, 5))), rng.standard_normal(5), rng.uniform(0, 1, 5)
    stacked = np.linalg.lstsq(np.vstack((R, np.diag(damping))), np.append(rhs, np.zeros(5)), rcond=None)[0]
    np.testing.assert_allclose(ridge_solve(R, rhs, damping), stacked, rtol=1e-10)


@given(ROOTS, st.floats(0.01, 3.0))
def test_stability_is_that_of_the_roots(roots: list[float], size: float) -> None:
    polynomial = np.poly([*roots, size])
    if abs(size - 1.0) > 1e-3:
        assert is_stable(polynomial, 1.0) == (size < 1.0)


@given(ROOTS, st.floats(1.01, 50.0), st.floats(0.1, 3.0))
def test_unstable_roots_come_inside(roots: list[float], size: float, angle: float) -> None:
    pair = size * np.exp(1j * angle)
    polynomial = np.real(np.poly([*roots, pair, np.conj(pair)]))
    reflected = stabilise(polynomial, LARGEST_ROOT, 1.0)
    assert is_stable(reflected, LARGEST_ROOT)
    # A mirrored zero leaves the shape of the spectrum: |P| on the circle changes by one factor.
    z = np.exp(1j * np.linspace(0.1, 3.0, 7))
    ratio = np.abs(np.polyval(reflected, z)) / np.abs(np.polyval(polynomial, z))
    if size < 20.0 and abs(size - 1.0) > 0.05:
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)
    clamped = stabilise(polynomial, LARGEST_ROOT, np.inf)
    assert is_stable(clamped, LARGEST_ROOT)
    assert np.max(np.abs(np.roots(clamped))) > 0.99


def test_what_is_not_finite_becomes_one() -> None:
    np.testing.assert_array_equal(stabilise(np.array([1.0, np.nan, 2.0]), LARGEST_ROOT, 1.0), [1.0, 0.0, 0.0])


def test_normals_are_the_gradient_of_the_root() -> None:
    radius = 0.95
    polynomial = np.real(np.poly([0.95 * np.exp(0.7j), 0.95 * np.exp(-0.7j), 0.3]))
    (normal,) = boundary_normals(polynomial, radius)
    h = 1e-6
    for i in range(3):
        moved = polynomial.copy()
        moved[i + 1] += h
        change = (np.max(np.abs(np.roots(moved))) - radius) / h
        assert change == pytest.approx(normal[i], abs=1e-5)  # second order in h


@st.composite
def tasks(draw: st.DrawFn) -> tuple[Task, FloatArray]:
    count = st.integers(0, 3)
    order = Order(draw(st.integers(1, 3)), draw(count), draw(count), draw(count), draw(st.integers(0, 3)))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    u, y = np.cumsum(rng.standard_normal((2, 80)), axis=1)
    task = task_of(u, y, order, "estimate" if draw(st.booleans()) else "zero")
    parts = [np.atleast_1d(np.poly(rng.uniform(-0.8, 0.8, n)))[1:] for n in (order.nc, order.nd, order.nf)]
    return task, np.concatenate(parts)


def place_at(task: Task, theta: FloatArray) -> Place:
    return evaluate(task, theta, np.zeros((ROWS, task.pad + task.u.size)), True)


def gradient_at(task: Task, theta: FloatArray) -> FloatArray:
    R = linearise(task, place_at(task, theta), True)
    inner = slice(linear_size(task), -1)
    return np.asarray(R[inner, inner].T @ R[inner, -1])


@given(tasks())
def test_derivatives_are_those_of_differences(case: tuple[Task, FloatArray]) -> None:
    task, theta = case
    place = place_at(task, theta)
    R = linearise(task, place, True)
    hessian = curvature(task, place, R)
    gradient = gradient_at(task, theta)
    h = 1e-5
    # Differences of order h² ≈ 1e-10 and rounding ≈ 1e-16/h, both against the size of the cost.
    for i in range(theta.size):
        step = h * np.eye(theta.size)[i]
        slope = (place_at(task, theta + step).cost - place_at(task, theta - step).cost) / (4.0 * h)
        size = np.max(np.abs(gradient)) + 1e-3 * place.cost
        assert gradient[i] == pytest.approx(slope, abs=1e-4 * size)
        column = (gradient_at(task, theta + step) - gradient_at(task, theta - step)) / (2.0 * h)
        size = np.max(np.abs(hessian)) + 1e-3 * place.cost
        np.testing.assert_allclose(hessian[:, i], column, atol=1e-3 * size)
