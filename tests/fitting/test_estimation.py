"""Recovery of known truth, an independent program, and a covariance that keeps its word."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.signal import lfilter

from twinmatch.dynamics import Parameters
from twinmatch.fitting import FittingError, Match, estimate, estimate_ladder, match
from twinmatch.fitting.estimation import (
    Effort,
    Estimate,
    Uncertainty,
    on_bounds,
    solve,
    starts_for,
    uncertainty,
)
from twinmatch.fitting.prediction import MEMORY
from twinmatch.fitting.problem import Noise, Problem
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, FloatArray, Window

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)
SINK = Peltier.model("sink with mass")
WITH_SINK = SINK.parameters(
    **{**dict(TRUTH), "sink_heat_capacity": 250.0, "sink_convection": 2.0}
)
FREE = ("seebeck", "conductance", "heat_capacity")


def problem(
    window: Window, free: tuple[str, ...] = FREE, base: Parameters = TRUTH
) -> Problem:
    return Problem(window, free, base, Noise.of(Peltier), Peltier.loop)


def relative(result: Match, truth: Parameters) -> list[float]:
    names = [name for name in result.free if name not in result.starts]
    return [result.parameters[name] / truth[name] - 1.0 for name in names]


@pytest.mark.parametrize(
    ("free", "truth"),
    [
        (FREE, TRUTH),
        (("seebeck",), TRUTH),
        (("conductance", "heat_capacity", "ambient"), TRUTH.replace(ambient=291.0)),
        (("seebeck", "resistance", "heat_capacity"), TRUTH.replace(resistance=2.9)),
        (FREE, WITH_SINK),
        ((*FREE, "sink_heat_capacity", "sink_convection"), WITH_SINK),
    ],
)
def test_without_noise_the_truth_is_found(
    record: Recorder, free: tuple[str, ...], truth: Parameters
) -> None:
    changes = {
        name: truth[name] + 1.0 if name == "ambient" else 1.15 * truth[name]
        for name in free
    }
    result = match(record(truth), free=free, start=truth.replace(**changes))
    assert relative(result, truth) == pytest.approx([0.0] * len(free), abs=1e-6)
    assert result.fit == pytest.approx((1.0, 1.0), abs=1e-6)


@settings(max_examples=15)
@given(
    seebeck=st.floats(0.03, 0.15),
    conductance=st.floats(0.2, 1.2),
    heat_capacity=st.floats(12.0, 60.0),
    step=st.floats(8.0, 35.0),
)
def test_any_rig_is_found_from_the_default_start(
    record: Recorder,
    seebeck: float,
    conductance: float,
    heat_capacity: float,
    step: float,
) -> None:
    truth = RIG.parameters(
        seebeck=seebeck, conductance=conductance, heat_capacity=heat_capacity
    )
    window = record(truth, levels=(30.0, 30.0 + step, 35.0))
    posed = problem(window)
    estimate = solve(posed, starts_for(posed, RIG.parameters()))
    assert estimate.converged
    assert estimate.values == pytest.approx(
        [seebeck, conductance, heat_capacity], rel=1e-5
    )


def test_a_search_of_less_effort_leaves_about_what_it_neglects(
    record: Recorder,
) -> None:
    """Near a minimum steps promise what they keep, so an order of magnitude is far more than that."""
    window = record(TRUTH, seed=1)
    posed = problem(window)
    starts = starts_for(posed, RIG.parameters())
    full = solve(posed, starts)
    quick = solve(posed, starts, Effort(100, negligible=0.01))
    assert quick.converged
    assert not np.array_equal(quick.values, full.values)
    assert full.chi2 <= quick.chi2 <= full.chi2 + 0.1


def test_a_search_with_too_few_evaluations_has_not_converged(record: Recorder) -> None:
    posed = problem(record(TRUTH))
    assert not solve(posed, starts_for(posed, RIG.parameters()), Effort(2)).converged


def test_an_independent_program_finds_the_same(record: Recorder) -> None:
    """The plant by a general integrator, the PID spelled out, derivatives by scipy: one short window."""
    window = record(TRUTH, levels=(40.0, 48.0), seed=3, samples=30)
    r = window.reference
    y = window.output
    u = window.input
    noise = Noise.of(Peltier)

    def simulate(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, k, c = values
        e = r[1] - y[1]
        before = r[0] - y[0]
        x = u[1] + 1.46877 * e - 38.57 * e - 6.66875 * (e - before)
        plate = y[2] + 273.15
        temperatures = []
        commands = []
        for reference in r[2:]:
            error = reference - (plate - 273.15)
            wanted = 38.57 * error + x + 6.66875 * (error - e)
            command = float(np.clip(wanted, -255, 255))
            x = x + 1.46877 * error + (command - wanted)
            e = error
            temperatures.append(plate - 273.15)
            commands.append(command)

            def rate(
                _t: float, t: np.ndarray, volts: float = 12 * command / 255
            ) -> np.ndarray:
                current = np.clip((-volts - a * (296.0 - t)) / 3.4, -5, 5)
                return -(a * t * current - current**2 * 3.3 / 2 + k * (t - 296.0)) / c

            plate = solve_ivp(rate, (0, 1), [plate], rtol=1e-9, atol=1e-9).y[0, -1]
        return np.array(temperatures), np.array(commands)

    def residuals(values: np.ndarray) -> np.ndarray:
        temperature, pwm = simulate(values)
        return np.concatenate(
            [(y[2:] - temperature) / noise.output, (u[2:] - pwm) / noise.input]
        )

    theirs = least_squares(
        residuals, [0.07, 0.5, 28.0], x_scale=[0.1, 0.5, 30.0], diff_step=1e-6
    )
    posed = problem(window)
    ours = solve(posed, [posed.values_of(RIG.parameters())])
    # Both stop where the cost no longer changes by 1e-8; the valley is flat to about the root of that.
    assert ours.values == pytest.approx(theirs.x, rel=1e-3)
    assert ours.residuals.ravel() == pytest.approx(residuals(ours.values), abs=1e-5)
    assert ours.chi2 <= 2 * theirs.cost / ours.residuals.size * (1 + 1e-6)


def test_the_covariance_is_honest(record: Recorder) -> None:
    """Sixty noisy windows: the spread of the estimates against the spread they claim."""
    estimates = []
    errors = []
    for seed in range(60):
        posed = problem(record(TRUTH, seed=seed))
        estimate = solve(posed, [posed.values_of(TRUTH)])
        estimates.append(estimate.values)
        errors.append(np.sqrt(np.diag(uncertainty(posed, estimate).covariance)))
    spread = np.std(estimates, axis=0, ddof=1)
    truth = np.array([TRUTH[name] for name in FREE])
    # A standard deviation of 60 draws is known to a tenth; white-noise theory would give 0.6.
    assert np.median(errors, axis=0) / spread == pytest.approx(np.ones(3), abs=0.35)
    assert np.mean(errors, axis=0) / spread == pytest.approx(np.ones(3), abs=0.35)
    within = np.abs(np.array(estimates) - truth) < 4.0 * np.array(errors)
    # The errors are themselves estimates along a curved valley: one in a hundred may lie farther off.
    assert within.mean() > 0.98
    assert np.all(np.abs(np.mean(estimates, axis=0) - truth) < 0.6 * spread)


def test_fisher_and_covariance_follow_the_noise(record: Recorder) -> None:
    window = record(TRUTH, seed=1)
    posed = problem(window)
    estimate = solve(posed, [posed.values_of(TRUTH)])
    knowledge = uncertainty(posed, estimate)
    coarse = Problem(window, posed.free, TRUTH, Noise(0.2, 14.0), Peltier.loop)
    coarse_estimate = solve(coarse, [estimate.values])
    coarse_knowledge = uncertainty(coarse, coarse_estimate)
    np.testing.assert_allclose(
        coarse_knowledge.fisher, knowledge.fisher / 4.0, rtol=1e-3
    )
    # The covariance is scaled by what is left, so the weights' common factor drops out.
    np.testing.assert_allclose(
        coarse_knowledge.covariance, knowledge.covariance, rtol=1e-2
    )
    assert np.all(np.linalg.eigvalsh(knowledge.covariance) > 0.0)
    assert knowledge.condition == pytest.approx(
        np.sqrt(knowledge.eigenvalues[-1] / knowledge.eigenvalues[0])
    )


def test_gradient_and_information_are_those_of_the_residuals(record: Recorder) -> None:
    posed = problem(record(TRUTH, seed=1), (*FREE, "ambient"))
    evaluated = posed.evaluate(posed.values_of(TRUTH))
    direction = 1e-4 * np.array([0.01, -0.05, 2.0, 0.5])
    ahead, back = (
        posed.residuals(evaluated.values + way).ravel()
        for way in (direction, -direction)
    )
    change = (ahead - back) / 2
    residuals = posed.residuals(evaluated.values).ravel()
    assert evaluated.cost == pytest.approx(residuals @ residuals, rel=1e-12)
    assert evaluated.gradient @ direction == pytest.approx(change @ residuals, rel=1e-5)
    assert direction @ evaluated.hessian @ direction == pytest.approx(
        change @ change, rel=1e-5
    )
    assert np.isfinite(posed.evaluate(posed.lower).hessian).all()


def test_a_sum_is_exact_unless_it_is_too_large(record: Recorder) -> None:
    """One above the most that is asked is only known to be above it."""
    posed = problem(record(TRUTH, seed=1))
    near = posed.evaluate(posed.values_of(TRUTH))
    again = posed.evaluate(near.values, near.cost)
    assert again.cost == near.cost
    assert again.hessian.tolist() == near.hessian.tolist()
    far = posed.evaluate(posed.lower)
    cut_short = posed.evaluate(posed.lower, near.cost)
    assert near.cost < cut_short.cost < far.cost


def test_what_is_not_seen_has_infinite_covariance() -> None:
    window = Window(
        np.full(60, 296.0 - KELVIN), np.full(60, 296.0 - KELVIN), np.zeros(60)
    )
    posed = problem(window)
    estimate = Estimate(posed, posed.values_of(TRUTH), converged=True)
    knowledge = uncertainty(posed, estimate)
    assert knowledge.condition == np.inf
    assert np.isinf(knowledge.covariance).all()


def test_starts_cover_the_valley_of_what_is_free(record: Recorder) -> None:
    window = record(TRUTH)
    assert len(starts_for(problem(window), TRUTH)) == 3
    assert len(starts_for(problem(window, ("ambient",)), TRUTH)) == 1
    mass = Problem(
        window, SINK.structure.free, WITH_SINK, Noise.of(Peltier), Peltier.loop
    )
    assert [s[-1] for s in starts_for(mass, WITH_SINK)] == [296.0] * 3
    posed = problem(window, ("conductance", "ambient"))
    assert [s.tolist() for s in starts_for(posed, TRUTH)] == [
        [0.6, 296.0],
        [0.6, 296.0],
        [0.5, 296.0],
    ]


def test_bounds_are_named(record: Recorder) -> None:
    posed = problem(record(TRUTH))
    assert on_bounds(posed, np.array([0.075, 0.6, 30.0])) == ()
    assert on_bounds(posed, np.array([0.2, 0.0, 30.0])) == ("seebeck", "conductance")


def test_a_value_far_from_its_bound_is_not_on_it_however_wide_the_bounds_are(
    record: Recorder,
) -> None:
    posed = problem(record(TRUTH))
    posed.lower[:] = 1e-9
    posed.upper[:] = 1e6
    assert on_bounds(posed, np.array([0.075, 0.6, 30.0])) == ()
    assert on_bounds(posed, np.array([1e-9, 0.6, 1e6])) == (
        posed.names[0],
        posed.names[2],
    )


# Estimates against published figures, known truth and a plain program.

B = np.array([0.0, 1.0, 0.5])
C = np.array([1.0, 0.7, 0.2])
D = np.array([1.0, -1.2, 0.5])
F = np.array([1.0, -1.5, 0.7])
TRUTH_BJ_ESTIMATION = np.concatenate((B[1:], C[1:], D[1:], F[1:]))


def binary_signal(count: int, rng: np.random.Generator) -> FloatArray:
    """A random binary signal that holds each value for four samples."""
    return np.repeat(rng.choice([-1.0, 1.0], size=count // 4 + 1), 4)[:count]


def recorded(
    count: int, seed: int, *, sigma: float = 0.3, skip: int = 0
) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = binary_signal(count + skip, rng)
    y = lfilter(B, F, u) + lfilter(C, D, sigma * rng.standard_normal(count + skip))
    return u[skip:], y[skip:]


@pytest.fixture(scope="module")
def gas_furnace() -> tuple[FloatArray, FloatArray]:
    """Series J of Box and Jenkins: gas rate and CO₂, their means taken off."""
    spec = importlib.util.find_spec("TimeSeriesSRC")
    assert spec is not None, "the test extra brings the package timeseries-toolbox"
    assert spec.submodule_search_locations is not None
    path = (
        Path(spec.submodule_search_locations[0])
        / "TestData"
        / "Series_J_Gas_Furnace.csv"
    )
    rate, gas = np.loadtxt(path, delimiter=",", skiprows=1).T
    return rate - rate.mean(), gas - gas.mean()


def test_the_gas_furnace_from_rest_has_the_published_coefficients(
    gas_furnace: tuple[FloatArray, FloatArray],
) -> None:
    """A Levenberg–Marquardt program printed these coefficients and 0.0569 for the data from rest."""
    model = estimate(*gas_furnace, (3, 0, 2, 1, 3), initial="zero")
    np.testing.assert_allclose(model.B[3:], [-0.531, -0.380, -0.517], atol=1e-3)
    np.testing.assert_allclose(model.F[1:], [-0.549], atol=1e-3)
    np.testing.assert_allclose(model.D[1:], [-1.529, 0.630], atol=1e-3)
    assert model.variance == pytest.approx(0.0569, abs=5e-5)


def test_the_gas_furnace_with_its_start_agrees_with_the_book(
    gas_furnace: tuple[FloatArray, FloatArray],
) -> None:
    """The book: −(0.53 + 0.37B + 0.51B²)/(1 − 0.57B), 1/(1 − 1.53B + 0.63B²), σ² = 0.0561."""
    model = estimate(*gas_furnace, (3, 0, 2, 1, 3))
    book = np.array([-0.53, -0.37, -0.51, -1.53, 0.63, -0.57])
    assert np.all(np.abs(model.coefficients - book) < 0.6 * model.standard_errors)
    assert model.variance == pytest.approx(0.0561, abs=1e-4)


@pytest.mark.parametrize("count", [300, 1000, 3000])
def test_truth_is_recovered_within_its_standard_errors(count: int) -> None:
    distances = []
    for seed in range(12):
        model = estimate(*recorded(count, seed), "22221")
        error = model.coefficients - TRUTH_BJ_ESTIMATION
        distances.append(error @ np.linalg.solve(model.covariance, error))
        assert model.variance == pytest.approx(0.09, rel=4.0 * (2.0 / count) ** 0.5)
    # Sum of twelve χ²(8): mean 96, standard deviation 13.9; short windows are allowed a longer tail.
    assert 50.0 < sum(distances) < (180.0 if count == 300 else 150.0)


def test_white_noise_needs_no_noise_model() -> None:
    rng = np.random.default_rng(4)
    u = binary_signal(800, rng)
    model = estimate(u, lfilter(B, F, u) + 0.1 * rng.standard_normal(800), "20021")
    np.testing.assert_allclose(model.B, B, atol=0.02)
    np.testing.assert_allclose(model.F, F, atol=0.01)
    np.testing.assert_array_equal(model.C, [1.0])


def test_truth_is_recovered_from_closed_loop_data() -> None:
    rng = np.random.default_rng(5)
    count = 3000
    reference = binary_signal(3000, rng)
    noise = lfilter(C, D, 0.1 * rng.standard_normal(count))
    u = np.zeros(count)
    w = np.zeros(count)
    y = np.zeros(count)
    for t in range(count):
        w[t] = sum(B[i] * u[t - i] for i in (1, 2) if t >= i) - sum(
            F[i] * w[t - i] for i in (1, 2) if t >= i
        )
        y[t] = w[t] + noise[t]
        u[t] = 0.15 * (reference[t] - y[t])
    model = estimate(u[100:], y[100:], "22221")
    assert np.all(
        np.abs(model.coefficients - TRUTH_BJ_ESTIMATION) < 4.0 * model.standard_errors
    )


def test_a_window_that_begins_in_a_transient() -> None:
    """A slow plant whose past reaches far into the window, seven times."""
    slow = np.poly([0.98, 0.9])
    gain = np.array([0.0, 0.02, 0.01])
    error: dict[str, list[float]] = {"estimate": [], "zero": []}
    for seed in range(7):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(20), 50)
        y = 10.0 * lfilter(gain, slow, u) + lfilter(C, D, rng.standard_normal(1000))
        for initial, gain_errors in error.items():
            model = estimate(u[700:], y[700:], "22221", initial=initial)
            gain_errors.append(abs(model.B.sum() / model.F.sum() - 150.0) / 150.0)
    # Noise of 1 through C/D on an output of some hundred: a gain good to a per cent or two.
    assert np.median(error["estimate"]) < 0.03
    assert np.median(error["zero"]) > 3.0 * np.median(error["estimate"])


def plain_errors(x: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
    """Order 22221 written down without any of our code: filters and their states as parameters."""
    b = np.append(0.0, x[:2])
    c = np.append(1.0, x[2:4])
    d = np.append(1.0, x[4:6])
    f = np.append(1.0, x[6:8])
    if (
        np.max(np.abs(np.roots(c))) >= 1.0 - MEMORY / u.size
        or np.max(np.abs(np.roots(f))) >= 1.0
    ):
        return np.full(u.size, 1e3)
    w = lfilter(b, f, u, zi=x[8:10])[0]
    return np.asarray(lfilter(d, c, y - w, zi=x[10:12])[0])


@pytest.mark.parametrize("seed", [1, 2])
def test_no_plain_search_finds_a_lower_loss(seed: int) -> None:
    u, y = recorded(250, seed, skip=60)
    rng = np.random.default_rng(seed)
    losses = []
    for _ in range(8):
        c, d, f = (np.poly(rng.uniform(-0.5, 0.9, 2))[1:] for _ in range(3))
        x = np.concatenate((rng.standard_normal(2), c, d, f, np.zeros(4)))
        minimum = least_squares(
            plain_errors,
            x,
            args=(u, y),
            x_scale="jac",
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        losses.append(2.0 * minimum.cost / u.size)
    model = estimate(u, y, "22221")
    assert model.variance == pytest.approx(min(losses), rel=1e-6)


def test_covariance_is_that_of_finite_differences() -> None:
    u, y = recorded(300, 7, skip=50)
    model = estimate(u, y, "22221")

    def errors(coefficients: FloatArray) -> FloatArray:
        b, c, d, f = coefficients.reshape(4, 2)
        monic = {
            name: np.append(1.0, part)
            for name, part in zip("CDF", (c, d, f), strict=True)
        }
        return replace(model, B=np.append(0.0, b), **monic).prediction_errors(u, y)

    h = 1e-6
    base = model.coefficients
    jacobian = np.stack(
        [(errors(base + h * e) - errors(base - h * e)) / (2.0 * h) for e in np.eye(8)],
        axis=1,
    )
    # Errors with the start projected out: their Jacobian gives the same covariance without the
    # initial conditions appearing in it (up to the second derivatives, a few per cent here).
    noise = model.variance * 300 / (300 - 8 - 4)
    expected = noise * np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(
        model.standard_errors, np.sqrt(np.diag(expected)), rtol=0.1
    )


def test_same_data_same_bits() -> None:
    u, y = recorded(400, 8)
    first, second = (estimate_ladder(u, y, ("22221", "44441")) for _ in range(2))
    for name, model in first.items():
        assert model.coefficients.tobytes() == second[name].coefficients.tobytes()
        assert model.covariance.tobytes() == second[name].covariance.tobytes()
        assert model.variance == second[name].variance


def test_more_freedom_is_never_worse() -> None:
    for seed in range(5):
        losses = [
            m.variance for m in estimate_ladder(*recorded(200, seed, skip=30)).values()
        ]
        assert all(b <= a * (1.0 + 1e-9) for a, b in pairwise(losses))


def test_a_ladder_keeps_the_order_of_its_rungs() -> None:
    u, y = recorded(150, 9)
    assert list(estimate_ladder(u, y, ("33331", "22221", (2, 1, 1, 2, 1)))) == [
        "33331",
        "22221",
        "21121",
    ]


def test_a_warm_start_is_never_worse_than_where_it_starts() -> None:
    u, y = recorded(500, 10)
    before = estimate(u[:400], y[:400], "22221")
    warm = estimate(u[100:], y[100:], "33331", start=before)
    assert warm.variance <= before.loss(u[100:], y[100:]) * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (lambda _, y: estimate(np.full(100, 3.0), y), "input u is constant"),
        (lambda u, y: estimate(u[1:], y), "99 samples and output y 100"),
        (
            lambda u, y: estimate(u, np.where(np.arange(100) == 2, np.inf, y)),
            "inf at sample 2",
        ),
        (
            lambda u, y: estimate(u[:30], y[:30], "55551"),
            "30 samples are too few .* 55551; give at least 40",
        ),
        (lambda u, y: estimate(u, y, initial="guess"), "'guess' is unknown"),
        (
            lambda u, y: estimate(u, y, "22221", start=estimate(u, y, "33331")),
            "33331 cannot start one of order 22221",
        ),
    ],
)
def test_what_cannot_be_estimated_is_refused(
    asked: Callable[..., object], message: str
) -> None:
    with pytest.raises(FittingError, match=message):
        asked(*recorded(100, 19))


@pytest.mark.parametrize("order", ["22221", "55551"])
def test_data_without_noise_are_explained_exactly(order: str) -> None:
    u = binary_signal(300, np.random.default_rng(12))
    y = lfilter(B, F, u, zi=[2.0, 1.0])[0]
    model = estimate(u, y, order)
    assert model.variance < 1e-16 * np.mean(y**2)
    assert np.all(np.isfinite(model.covariance))
    steady = model.B.sum() / model.F.sum()
    assert steady == pytest.approx(B.sum() / F.sum(), rel=1e-5)


@pytest.mark.parametrize("output", ["zero", "constant", "input"])
def test_outputs_that_leave_nothing_are_explained_exactly(output: str) -> None:
    u = binary_signal(120, np.random.default_rng(13))
    y = {"zero": np.zeros(120), "constant": np.full(120, 25.0), "input": u}[output]
    model = estimate(u, y, "33330" if output == "input" else "33331")
    # The input itself cannot be predicted one sample ahead; the rest can, exactly.
    assert model.variance <= 1e-12 * max(1.0, float(np.mean(y**2)))
    assert np.all(np.isfinite(model.coefficients))


def test_an_input_that_hardly_varies_gives_finite_errors() -> None:
    rng = np.random.default_rng(14)
    u = np.full(200, 60.0)
    u[100] += 1e-6
    model = estimate(u, rng.standard_normal(200), "55551")
    assert np.isfinite(model.variance)
    assert np.all(np.isfinite(model.standard_errors))


def test_an_order_that_is_too_high_keeps_a_finite_covariance() -> None:
    u, y = recorded(600, 15)
    model = estimate(u, y, "55551")
    assert np.all(np.isfinite(model.standard_errors))
    assert max(np.max(np.abs(np.roots(p))) for p in (model.C, model.D, model.F)) < 1.0


@pytest.mark.parametrize("order", ["10001", "10100", "11001", "21021", (2, 0, 0, 2, 7)])
def test_polynomials_may_be_missing(order: str) -> None:
    u, y = recorded(200, 16)
    model = estimate(u, y, order)
    assert model.covariance.shape == (model.n_parameters, model.n_parameters)
    assert model.variance < float(np.mean(y**2))


def test_sixty_samples_are_enough_for_the_ladder() -> None:
    models = estimate_ladder(*recorded(60, 17, skip=20), period=0.5)
    assert list(models) == ["22221", "33331", "44441", "55551"]
    assert {model.period for model in models.values()} == {0.5}
    assert models["22221"].n_samples == 60
    assert models["55551"].n_parameters == 20


@given(st.integers(0, 2**31), st.integers(2, 7), st.integers(1, 3), st.booleans())
def test_what_is_held_leaves_the_others_with_the_variance_that_they_have(
    seed: int, n: int, hidden: int, prefer_last: bool
) -> None:
    """Parameters of a linear model, of which some are copies of others: only their sums show."""
    random = np.random.default_rng(seed)
    slopes = random.normal(size=(40, n))
    copied = random.integers(0, n, hidden).tolist()
    jacobian = np.hstack([slopes, slopes[:, copied]])
    fisher = jacobian.T @ jacobian
    size = n + hidden
    eigenvalues, directions = np.linalg.eigh(fisher)
    known = Uncertainty(
        fisher=fisher,
        scores=fisher,
        scales=np.ones(size),
        eigenvalues=np.maximum(eigenvalues, 0.0),
        directions=directions,
        condition=float("inf"),
        covariance=np.full_like(fisher, np.inf),
    )
    first = range(n, size) if prefer_last else ()
    held = known.hidden(first).held
    assert len(set(held)) == hidden
    if prefer_last:
        assert sorted(held) == [*first]
    assert sorted(known.hidden().concerned) == sorted({*copied, *range(n, size)})
    others = [i for i in range(n) if i not in copied]
    shown = known.covariance_of_shown
    assert np.isinf(np.diag(shown)[[*copied, *range(n, size)]]).all()
    alone = np.linalg.inv(slopes.T @ slopes)
    np.testing.assert_allclose(
        shown[np.ix_(others, others)], alone[np.ix_(others, others)], rtol=1e-6
    )
