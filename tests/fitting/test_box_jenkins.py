"""Orders in the way the paper writes them, what can be done with a model, and starts around the best one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from twinmatch.compiled import compiled
from twinmatch.fitting import (
    ORDERS,
    BoxJenkins,
    FittingError,
    estimate,
    estimate_ladder,
    parse_order,
)
from twinmatch.fitting.data import Order
from twinmatch.fitting.delayed import (
    SLACK,
    cholesky,
    correlate,
    ridge_solve,
    triangularise,
)
from twinmatch.fitting.descent import Rules, descend
from twinmatch.fitting.polynomials import (
    LARGEST_ROOT,
    all_pole_into,
    boundary_normals,
    fir,
    is_stable,
    stabilise,
)
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
from twinmatch.fitting.starts import Hops
from twinmatch.signals import FloatArray, Window


@pytest.mark.parametrize(
    "written", ["22221", "2 2 2 2 1", "2,2,2,2,1", (2, 2, 2, 2, 1), [2, 2, 2, 2, 1]]
)
def test_an_order_may_be_written_in_five_ways(written: str | tuple[int, ...]) -> None:
    assert parse_order(written) == Order(nb=2, nc=2, nd=2, nf=2, nk=1)


def test_an_order_reads_back() -> None:
    for order in (*ORDERS, "10 0 2 1 12"):
        assert str(parse_order(order)) == order


def test_the_ladder_is_nested() -> None:
    rungs = [parse_order(order) for order in ORDERS]
    for lower, higher in pairwise(rungs):
        assert higher.covers(lower)
        assert not lower.covers(higher)


def test_covering_respects_the_span_of_b() -> None:
    assert parse_order("31110").covers(parse_order("21111"))
    assert not parse_order("21110").covers(parse_order("21111"))


@pytest.mark.parametrize(
    ("order", "message"),
    [
        *(
            (order, "five whole numbers")
            for order in ("2222", "222211", "two", (2,) * 4, (1.5, 2, 2, 2, 1))
        ),
        ("02221", "nb must be at least 1"),
        ((2, -1, 2, 2, 1), "outside 0 to 50"),
        ((2, 2, 2, 2, 51), "outside 0 to 50"),
    ],
)
def test_what_is_not_an_order_is_refused(order: str, message: str) -> None:
    with pytest.raises(FittingError, match=message):
        parse_order(order)


B = np.array([0.0, 1.0, 0.5])
C = np.array([1.0, -0.5, 0.2])
D = np.array([1.0, -1.2, 0.5])
F = np.array([1.0, -1.5, 0.7])


@pytest.fixture
def model() -> BoxJenkins:
    order = Order(2, 2, 2, 2, 1)
    return BoxJenkins(order, B, C, D, F, 0.01, np.zeros(4), 100, period=0.5)


@pytest.fixture
def u() -> np.ndarray:
    return np.random.default_rng(5).standard_normal(150)


def test_transfer_function_is_that_of_the_model(
    model: BoxJenkins, u: np.ndarray
) -> None:
    size = max(model.B.size, model.F.size)
    parts = [np.pad(part, (0, size - part.size)) for part in (model.B, model.F)]
    system = control.TransferFunction(*parts, model.period)
    times = np.arange(u.size) * 0.5
    answer = control.forced_response(system, times, u).outputs
    np.testing.assert_allclose(model.simulate(u), answer, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            lambda m, u: m.simulate(u[:2], outputs=[1.0, 2.0, 3.0]),
            "3 recorded outputs for 2",
        ),
        (
            lambda m, _: m.simulate(np.where(np.arange(20) == 7, np.nan, 0.0)),
            "nan at sample 7",
        ),
        (lambda m, _: m.simulate(np.zeros((2, 2))), "give one value per sample"),
        (lambda m, u: m.prediction_errors(u[1:], u), "149 samples and output y 150"),
        (lambda m, u: m.prediction_errors(u, u, "backwards"), "'backwards' is unknown"),
        (
            lambda _, __: estimate(*two_tones(1), "22221", hops=-1),
            "-1 starts requested; give 0 or more",
        ),
    ],
)
def test_what_no_model_can_do_is_refused(
    model: BoxJenkins,
    u: np.ndarray,
    asked: Callable[[BoxJenkins, np.ndarray], object],
    message: str,
) -> None:
    with pytest.raises(FittingError, match=message):
        asked(model, u)


def test_control_is_not_imported_before_it_is_needed() -> None:
    code = "import sys, twinmatch.fitting; sys.exit('control' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_simulation_continues_from_recorded_outputs(
    model: BoxJenkins, u: np.ndarray
) -> None:
    whole = lfilter(B, F, u, zi=[0.3, -0.2])[0]
    np.testing.assert_allclose(
        model.simulate(u, outputs=whole[:3]), whole, rtol=1e-9, atol=1e-10
    )
    np.testing.assert_array_equal(
        model.simulate(u, outputs=[5.0, 6.0, 7.0])[:3], [5.0, 6.0, 7.0]
    )


def test_prediction_errors_are_the_innovations(
    model: BoxJenkins, u: np.ndarray
) -> None:
    e = 0.1 * np.random.default_rng(6).standard_normal(u.size)
    y = lfilter(B, F, u) + lfilter(C, D, e)
    np.testing.assert_allclose(model.prediction_errors(u, y, "zero"), e, atol=1e-10)
    assert model.loss(u, y, "zero") == pytest.approx(np.mean(e**2))


def test_estimated_start_finds_any_transient(model: BoxJenkins, u: np.ndarray) -> None:
    y = (
        lfilter(B, F, u, zi=[20.0, -15.0])[0]
        + lfilter(C, D, np.zeros(u.size), zi=[3.0, 1.0])[0]
    )
    np.testing.assert_allclose(model.prediction_errors(u, y), 0.0, atol=1e-7)
    assert model.loss(u, y, "zero") > 1.0


@pytest.mark.parametrize(
    ("order", "hops", "most"),
    [("22221", 0, 1e-6), ("44441", 0, 1e-3), ("44441", 1, 1e-6)],
)
def test_a_search_leaves_little_of_the_way_to_rounding(
    order: str, hops: int, most: float
) -> None:
    """In characters of the window's code, to the minimum into which it has fallen."""
    rng = np.random.default_rng(12)
    u = rng.standard_normal(300)
    y = lfilter(B, F, u) + lfilter(C, D, 0.5 * rng.standard_normal(300))
    found = estimate(u, y, order, hops=hops).found
    assert found is not None
    task, end = found
    until_rounding, _, _ = descend(task, end.theta, Rules(steps=100, settled=1e-14))
    left = 0.5 * u.size * np.log10(end.cost / until_rounding.cost)
    assert -1e-9 <= left < most


def test_own_initial_state_gives_the_loss_of_the_estimate() -> None:
    rng = np.random.default_rng(9)
    u = rng.standard_normal(300)
    y = lfilter(B, F, u) + lfilter(C, D, 0.1 * rng.standard_normal(300))
    model = estimate(u[50:], y[50:], "22221")
    assert model.loss(u[50:], y[50:], model.initial_state) == pytest.approx(
        model.variance, rel=1e-9
    )
    assert model.loss(u[50:], y[50:]) == pytest.approx(model.variance, rel=1e-9)


def test_arrays_of_a_model_cannot_be_written(model: BoxJenkins) -> None:
    with pytest.raises(ValueError, match="read-only"):
        model.B[0] = 1.0


DEGREES = st.integers(0, 5)


@given(DEGREES, DEGREES, DEGREES, st.integers(0, 2**31))
def test_hops_keep_the_degrees_and_stay_stable(
    nc: int, nd: int, nf: int, seed: int
) -> None:
    order = Order(1, nc, nd, nf, 1)
    hops = Hops(order)
    assert hops.possible == (nc + nd + nf > 0)
    if not hops.possible:
        return
    rng = np.random.default_rng(seed)
    theta = np.concatenate(
        [np.atleast_1d(np.poly(rng.uniform(-0.9, 0.9, n)))[1:] for n in (nc, nd, nf)]
    )
    for _ in range(5):
        moved = hops.from_model(theta)
        assert moved.shape == theta.shape
        for part in np.split(moved, [nc, nc + nd]):
            roots = np.roots(np.append(1.0, part))
            # Roots stay inside; a cluster of them is known to no better than the root of rounding.
            assert np.all(np.abs(roots) < 1.0)


def test_one_hop_touches_one_polynomial_or_the_noise() -> None:
    theta = np.concatenate(
        [np.poly(r)[1:] for r in ([0.5, 0.2], [0.9, 0.3], [0.8, 0.4])]
    )
    hops = Hops(parse_order("22221"))
    for _ in range(50):
        moved = np.any(
            np.abs(hops.from_model(theta) - theta).reshape(3, 2) > 1e-12, axis=1
        )
        assert list(moved) in (
            [True, False, False],
            [False, True, False],
            [False, False, True],
            [True, True, False],
        )


def test_the_sequence_is_always_the_same() -> None:
    theta = np.concatenate([np.poly([0.5, 0.2])[1:]] * 3)
    first, second = (Hops(parse_order("22221")) for _ in range(2))
    for _ in range(20):
        assert first.from_model(theta).tobytes() == second.from_model(theta).tobytes()


def two_tones(seed: int) -> tuple[FloatArray, FloatArray]:
    """Noise with two narrow bands, of which a low order can follow one."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(75), 4)
    narrow = np.real(
        np.poly(
            [
                *(0.98 * np.exp(s * 0.5j) for s in (1, -1)),
                *(0.96 * np.exp(s * 1.9j) for s in (1, -1)),
            ]
        )
    )
    return u, lfilter([0.0, 0.5], [1.0, -0.8], u) + lfilter(
        [1.0], narrow, 0.1 * rng.standard_normal(300)
    )


def test_more_hops_are_never_worse_and_find_lower_minima() -> None:
    gained = 0
    for seed in range(6):
        losses = [
            estimate(*two_tones(seed), "33331", hops=hops).variance
            for hops in (0, 4, 16)
        ]
        # Draws begin alike, so the longer search passes through the shorter one's minima.
        assert all(b <= a * (1.0 + 1e-5) for a, b in pairwise(losses))
        gained += losses[2] < 0.99 * losses[0]
    assert gained > 0


# The compiled arithmetic against scipy, and derivatives against differences.

ROOTS = st.lists(st.floats(-0.9, 0.9), min_size=0, max_size=4)


@compiled
def all_pole(denominator: FloatArray, x: FloatArray) -> FloatArray:
    """Only kernels call the one inside."""
    out = np.empty(x.size)
    all_pole_into(denominator, x, out)
    return out


def test_filters_give_what_scipys_give() -> None:
    rng = np.random.default_rng(1)
    x = rng.standard_normal(200)
    a = np.array([1.0, -1.1, 0.3, 0.1])
    b = rng.standard_normal(4)
    np.testing.assert_allclose(fir(b, x), lfilter(b, [1.0], x), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(
        all_pole(a, x), lfilter([1.0], a, x), rtol=1e-12, atol=1e-13
    )


@given(st.integers(0, 2**31), st.integers(0, 5), st.integers(1, 4), st.integers(0, 3))
def test_normal_matrix_and_triangle_agree_with_the_matrix(
    seed: int, d: int, n: int, first: int
) -> None:
    rng = np.random.default_rng(seed)
    pad = 9 + SLACK
    count = 117
    signals = np.zeros((2, pad + count))
    signals[:, pad:] = rng.standard_normal((2, count))
    spans = np.array([[0, d, n], [1, 1, 3], [0, 0, 1 if d else 0]], dtype=np.int64)
    columns = [
        signals[s, pad - k : pad - k + count]
        for s, lowest_lag, m in spans
        for k in range(lowest_lag, lowest_lag + m)
    ]
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
    R = np.triu(rng.standard_normal((5, 5)))
    rhs = rng.standard_normal(5)
    damping = rng.uniform(0, 1, 5)
    stacked = np.linalg.lstsq(
        np.vstack((R, np.diag(damping))), np.append(rhs, np.zeros(5)), rcond=None
    )[0]
    np.testing.assert_allclose(ridge_solve(R, rhs, damping), stacked, rtol=1e-10)


@given(ROOTS, st.floats(0.01, 3.0))
def test_stability_is_that_of_the_roots(roots: list[float], size: float) -> None:
    polynomial = np.poly([*roots, size])
    if abs(size - 1.0) > 1e-3:
        assert is_stable(polynomial, 1.0) == (size < 1.0)


@given(ROOTS, st.floats(1.01, 50.0), st.floats(0.1, 3.0))
def test_unstable_roots_come_inside(
    roots: list[float], size: float, angle: float
) -> None:
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
    np.testing.assert_array_equal(
        stabilise(np.array([1.0, np.nan, 2.0]), LARGEST_ROOT, 1.0), [1.0, 0.0, 0.0]
    )


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
    order = Order(
        draw(st.integers(1, 3)),
        draw(count),
        draw(count),
        draw(count),
        draw(st.integers(0, 3)),
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    u, y = np.cumsum(rng.standard_normal((2, 80)), axis=1)
    task = task_of(u, y, order, "estimate" if draw(st.booleans()) else "zero")
    parts = [
        np.atleast_1d(np.poly(rng.uniform(-0.8, 0.8, n)))[1:]
        for n in (order.nc, order.nd, order.nf)
    ]
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
        slope = (
            place_at(task, theta + step).cost - place_at(task, theta - step).cost
        ) / (4.0 * h)
        size = np.max(np.abs(gradient)) + 1e-3 * place.cost
        assert gradient[i] == pytest.approx(slope, abs=1e-4 * size)
        column = (gradient_at(task, theta + step) - gradient_at(task, theta - step)) / (
            2.0 * h
        )
        size = np.max(np.abs(hessian)) + 1e-3 * place.cost
        np.testing.assert_allclose(hessian[:, i], column, atol=1e-3 * size)


def test_a_ladder_begins_like_an_estimate_of_its_lowest_order() -> None:
    """What its orders share is that of their delay."""
    u, y = two_tones(3)
    ladder = estimate_ladder(u, y, ["21120", "21121"], hops=0)
    for order, model in ladder.items():
        below = ladder["21120"] if order == "21121" else None
        covered = below is not None and parse_order(order).covers(below.order)
        alone = estimate(u, y, order, hops=0, start=below if covered else None)
        assert model.coefficients.tobytes() == alone.coefficients.tobytes()


# On the real rig: r → y and r → u, windows that begin in the middle of a transient.

Hour = Callable[[int], Window]
SPANS = [
    (1, 0, 500),
    (1, 0, 3600),
    (2, 300, 800),
    (5, 1000, 1500),
    (9, 200, 800),
    (14, 900, 1800),
    (27, 0, 700),
]


@pytest.mark.parametrize(("number", "first", "last"), SPANS)
@pytest.mark.parametrize("output", ["output", "input"])
def test_loss_never_grows_up_the_ladder(
    recorded_hour: Hour, number: int, first: int, last: int, output: str
) -> None:
    window = recorded_hour(number).part(first, last)
    models = list(estimate_ladder(window.reference, getattr(window, output)).values())
    losses = [model.variance for model in models]
    assert all(b <= a * (1.0 + 1e-9) for a, b in pairwise(losses))
    for model in models:
        assert max(np.max(np.abs(np.roots(p))) for p in (model.D, model.F)) < 1.0
        # forgets within the window
        assert np.max(np.abs(np.roots(model.C))) < 1.0 - 5.9 / len(window)
        assert np.all(np.isfinite(model.standard_errors))
        assert np.max(np.abs(model.simulate(window.reference))) < 1e4


@pytest.mark.parametrize(("last", "bound"), [(500, 0.09), (3600, 0.045)])
def test_the_estimated_start_brings_the_loss_near_the_noise(
    recorded_hour: Hour, last: int, bound: float
) -> None:
    window = recorded_hour(1).part(0, last)
    loss = {
        initial: estimate(
            window.reference, window.output, "22221", initial=initial
        ).variance
        for initial in ("estimate", "zero")
    }
    assert loss["estimate"] < bound
    assert loss["zero"] > 2.0 * loss["estimate"]


def test_closed_loop_gain_is_one(recorded_hour: Hour) -> None:
    window = recorded_hour(5)
    model = estimate(window.reference, window.output, "33331")
    # The PID integrates: what is left is the noise of an hour over steps of some ten degrees.
    assert model.B.sum() / model.F.sum() == pytest.approx(1.0, abs=0.01)


def test_a_model_judges_itself_on_the_next_window(recorded_hour: Hour) -> None:
    hour = recorded_hour(5)
    fitted_window = hour.part(200, 1400)
    next_window = hour.part(1401, 2600)
    model: BoxJenkins = estimate(fitted_window.reference, fitted_window.output, "22221")
    assert model.loss(next_window.reference, next_window.output) < 1.5 * model.variance
    assert model.loss(next_window.reference, next_window.output, "zero") > model.loss(
        next_window.reference, next_window.output
    )
