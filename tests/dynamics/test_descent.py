"""The search: against scipy, against its own conditions for a minimum in a box, and where it must stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import least_squares, lsq_linear

from twinmatch.dynamics import Descended, box_step, descend
from twinmatch.dynamics.descent import new_search


class Curve:
    """Residuals and Jacobian of a function, as the search wants them."""

    def __init__(self, residuals: np.ndarray, jacobian: np.ndarray) -> None:
        self.cost = float(residuals @ residuals)
        self.normal = self.cost, jacobian.T @ residuals, jacobian.T @ jacobian


def rosenbrock(x: np.ndarray) -> Curve:
    return Curve(
        np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]),
    )


def search(
    evaluate: Callable[[np.ndarray], Curve],
    start: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
    *,
    most: int = 200,
    earlier: Descended | None = None,
    settled: float = 0.0,
) -> Descended:
    arrays = (np.array(v, dtype=float) for v in (start, lower, upper))
    return descend(
        lambda x: evaluate(x).normal,
        *arrays,
        np.ones(len(start)),
        most,
        earlier,
        settled,
    )


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (0.0, 0.0)])
@pytest.mark.parametrize(
    "upper", [(10.0, 10.0), (0.5, 10.0), (10.0, 0.25), (0.3, 0.01)]
)
def test_a_curved_valley_is_followed_to_its_end_or_to_the_bound(
    start: tuple[float, float], upper: tuple[float, float]
) -> None:
    low = (-5.0, -5.0)
    begin = np.minimum(start, upper)
    minimum = search(rosenbrock, begin, low, upper)
    theirs = least_squares(
        lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        np.minimum(begin, np.array(upper) - 1e-6),
        bounds=(low, upper),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    assert minimum.converged
    assert minimum.cost <= 2 * theirs.cost + 1e-8
    np.testing.assert_allclose(minimum.values, theirs.x, atol=1e-4)
    assert np.all(minimum.values <= upper)


@given(
    entries=st.lists(st.floats(-3.0, 3.0), min_size=24, max_size=24),
    right=st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6),
)
def test_an_undamped_step_solves_the_linear_problem_in_its_box(
    entries: list[float], right: list[float]
) -> None:
    """Against scipy's active-set solver."""
    matrix = np.array(entries[:18]).reshape(6, 3)
    target = np.array(right)
    matrix[:3] += 2.0 * np.eye(3)
    if np.linalg.cond(matrix) > 1e3:
        return
    start = np.full(3, 0.1)
    lower = np.full(3, 0.0)
    upper = np.array([1.0, 0.5, 2.0])
    residuals = matrix @ start - target
    step, promised = box_step(
        matrix.T @ matrix, matrix.T @ residuals, start, lower, upper, 1e-12
    )
    end = start + step
    assert np.all((end >= lower - 1e-12) & (end <= upper + 1e-12))
    before = residuals @ residuals
    after = np.sum(np.square(matrix @ end - target))
    assert promised == pytest.approx(before - after, abs=1e-7 * (1 + before))
    assert promised >= -1e-9
    best = 2 * lsq_linear(matrix, target, (lower, upper), method="bvls", tol=1e-12).cost
    assert after == pytest.approx(best, abs=1e-6 * (1 + best))


@given(seed=st.integers(0, 10_000))
@example(seed=1003)
@example(seed=2782)
def test_parameters_that_trade_off_do_not_leave_their_box(seed: int) -> None:
    """Seven parameters of which some combinations hardly show: the step promises about what scipy's does.

    Some may send one another from bound to bound; a step that ended there anyhow could promise a rise, and a
    search took that for its end. What is promised under more damping instead may be half of what there is.
    """
    rng = np.random.default_rng(seed)
    n = 7
    matrix = (
        rng.normal(size=(30, n))
        @ np.diag(np.logspace(0, -5, n))
        @ rng.normal(size=(n, n))
    )
    residuals = 10.0 * rng.normal(size=30)
    lower = -rng.uniform(0.0, 2.0, n)
    upper = rng.uniform(0.5, 50.0, n)
    step, promised = box_step(
        matrix.T @ matrix, matrix.T @ residuals, np.zeros(n), lower, upper, 1e-12
    )
    theirs = lsq_linear(
        matrix, -residuals, (lower, upper), method="bvls", tol=1e-14, max_iter=1000
    )
    best = residuals @ residuals - 2.0 * theirs.cost
    assert np.all(step >= lower - 1e-9)
    assert np.all(step <= upper + 1e-9)
    assert promised >= 0.4 * best


def test_a_direction_that_is_not_seen_is_left_alone() -> None:
    def flat(x: np.ndarray) -> Curve:
        return Curve(np.array([x[0] - 1.0, 0.5]), np.array([[1.0, 0.0], [0.0, 0.0]]))

    minimum = search(flat, (0.0, 0.3), (-5.0, -5.0), (5.0, 5.0))
    assert minimum.converged
    assert minimum.values == pytest.approx([1.0, 0.3])


def test_a_kink_ends_the_search_and_too_few_evaluations_are_reported() -> None:
    def kink(x: np.ndarray) -> Curve:
        return Curve(np.array([abs(x[0]) + 1.0]), np.array([[np.sign(x[0]) or 1.0]]))

    minimum = search(kink, (1.0,), (-5.0,), (5.0,))
    assert minimum.converged
    assert abs(minimum.values[0]) < 1e-3
    short = search(rosenbrock, (-1.2, 1.0), (-5.0, -5.0), (5.0, 5.0), most=3)
    assert not short.converged
    assert short.evaluations == 3


def test_a_search_that_comes_into_a_known_valley_ends_with_its_minimum() -> None:
    def well(x: np.ndarray) -> Curve:
        return Curve(
            np.array([x[0] + 0.1 * x[0] ** 2, 1.0]),
            np.array([[1.0 + 0.2 * x[0]], [0.0]]),
        )

    first = search(well, (3.0,), (-4.0,), (4.0,))
    second = search(well, (2.0,), (-4.0,), (4.0,), earlier=first)
    assert second is first

    def two(x: np.ndarray) -> Curve:  # minima at −1 and 2, the second one higher
        return Curve(
            np.array([(x[0] + 1.0) * (x[0] - 2.0), 0.3 * (x[0] + 1.0)]),
            np.array([[2.0 * x[0] - 1.0], [0.3]]),
        )

    from_left = search(two, (-2.0,), (-5.0,), (5.0,))
    from_right = search(two, (3.0,), (-5.0,), (5.0,), earlier=from_left)
    assert from_left.values == pytest.approx([-1.0], abs=1e-3)
    assert from_right.values[0] > 1.5


def test_bounds_that_are_columns_need_no_kernel_of_their_own() -> None:
    start = np.array([0.5, 0.5])
    bounds = np.array([[0.0, 1.0], [0.2, 2.0]])

    def layouts(low: np.ndarray, high: np.ndarray) -> list[bool]:
        return [
            array.flags.c_contiguous
            for array in new_search(start, low, high, np.ones(2), 9)
        ]

    assert layouts(*bounds.T) == layouts(*bounds.T.copy())


@pytest.mark.parametrize("settled", [1e-1, 1e-2, 1e-3])
def test_a_search_ends_where_little_more_is_promised(settled: float) -> None:
    box = (-5.0, -5.0), (10.0, 10.0)
    whole = search(rosenbrock, (-1.2, 1.0), *box)
    early = search(rosenbrock, (-1.2, 1.0), *box, settled=settled)
    assert early.converged
    assert early.evaluations < whole.evaluations
    # the least sum is zero, and the last valley is nearly a parabola: what is promised is what is left
    assert 0.0 < early.cost <= settled
