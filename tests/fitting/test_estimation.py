"""Recovery of known truth, an independent program, and a covariance that keeps its word."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from twinmatch.dynamics import Parameters
from twinmatch.fitting import Match, match
from twinmatch.fitting.estimation import Estimate, on_bounds, solve, starts_for, uncertainty
from twinmatch.fitting.problem import Noise, Problem
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, Window

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)
SINK = Peltier.model("sink with mass")
WITH_SINK = SINK.parameters(**{**dict(TRUTH), "sink_heat_capacity": 250.0, "sink_convection": 2.0})
FREE = ("seebeck", "conductance", "heat_capacity")


def problem(window: Window, free: tuple[str, ...] = FREE, base: Parameters = TRUTH) -> Problem:
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
def test_without_noise_the_truth_is_found(record: Recorder, free: tuple[str, ...], truth: Parameters) -> None:
    changes = {name: truth[name] + 1.0 if name == "ambient" else 1.15 * truth[name] for name in free}
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
    record: Recorder, seebeck: float, conductance: float, heat_capacity: float, step: float
) -> None:
    truth = RIG.parameters(seebeck=seebeck, conductance=conductance, heat_capacity=heat_capacity)
    window = record(truth, levels=(30.0, 30.0 + step, 35.0))
    posed = problem(window)
    found = solve(posed, starts_for(posed, RIG.parameters()))
    assert found.converged
    assert found.values == pytest.approx([seebeck, conductance, heat_capacity], rel=1e-5)


def test_an_independent_program_finds_the_same(record: Recorder) -> None:
    """The plant by a general integrator, the PID spelled out, derivatives by scipy: one short window."""
    window = record(TRUTH, levels=(40.0, 48.0), seed=3, samples=30)
    r, y, u = window.reference, window.output, window.input
    noise = Noise.of(Peltier)

    def simulate(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, k, c = values
        e, before = r[1] - y[1], r[0] - y[0]
        x = u[1] + 1.46877 * e - 38.57 * e - 6.66875 * (e - before)
        plate, temperatures, commands = y[2] + 273.15, [], []
        for reference in r[2:]:
            error = reference - (plate - 273.15)
            wanted = 38.57 * error + x + 6.66875 * (error - e)
            command = float(np.clip(wanted, -255, 255))
            x, e = x + 1.46877 * error + (command - wanted), error
            temperatures.append(plate - 273.15)
            commands.append(command)

            def rate(_t: float, t: np.ndarray, volts: float = 12 * command / 255) -> np.ndarray:
                current = np.clip((-volts - a * (296.0 - t)) / 3.4, -5, 5)
                return -(a * t * current - current**2 * 3.3 / 2 + k * (t - 296.0)) / c

            plate = solve_ivp(rate, (0, 1), [plate], rtol=1e-9, atol=1e-9).y[0, -1]
        return np.array(temperatures), np.array(commands)

    def residuals(values: np.ndarray) -> np.ndarray:
        temperature, pwm = simulate(values)
        return np.concatenate([(y[2:] - temperature) / noise.output, (u[2:] - pwm) / noise.input])

    theirs = least_squares(residuals, [0.07, 0.5, 28.0], x_scale=[0.1, 0.5, 30.0], diff_step=1e-6)
    posed = problem(window)
    ours = solve(posed, [posed.values_of(RIG.parameters())])
    # Both stop where the cost no longer changes by 1e-8; the valley is flat to about the root of that.
    assert ours.values == pytest.approx(theirs.x, rel=1e-3)
    assert ours.residuals.ravel() == pytest.approx(residuals(ours.values), abs=1e-5)
    assert ours.chi2 <= 2 * theirs.cost / ours.residuals.size * (1 + 1e-6)


def test_the_covariance_is_honest(record: Recorder) -> None:
    """Sixty noisy windows: the spread of the estimates against the spread they claim."""
    estimates, errors = [], []
    for seed in range(60):
        posed = problem(record(TRUTH, seed=seed))
        found = solve(posed, [posed.values_of(TRUTH)])
        estimates.append(found.values)
        errors.append(np.sqrt(np.diag(uncertainty(posed, found).covariance)))
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
    found = solve(posed, [posed.values_of(TRUTH)])
    known = uncertainty(posed, found)
    coarse = Problem(window, posed.free, TRUTH, Noise(0.2, 14.0), Peltier.loop)
    again = solve(coarse, [found.values])
    other = uncertainty(coarse, again)
    np.testing.assert_allclose(other.fisher, known.fisher / 4.0, rtol=1e-3)
    # The covariance is scaled by what is left, so the weights' common factor drops out.
    np.testing.assert_allclose(other.covariance, known.covariance, rtol=1e-2)
    assert np.all(np.linalg.eigvalsh(known.covariance) > 0.0)
    assert known.condition == pytest.approx(np.sqrt(known.eigenvalues[-1] / known.eigenvalues[0]))


def test_the_jacobian_is_the_derivative(record: Recorder) -> None:
    posed = problem(record(TRUTH, seed=1), (*FREE, "ambient"))
    values = posed.values_of(TRUTH)
    jacobian = posed.jacobian(values)
    direction = np.array([0.01, -0.05, 2.0, 0.5])
    for size in (1e-4, 2e-4):
        change = posed.residuals(values + size * direction) - posed.residuals(values - size * direction)
        np.testing.assert_allclose(change / (2 * size), jacobian @ direction, atol=1e-3)
    at_bound = posed.lower.copy()
    assert np.isfinite(posed.jacobian(at_bound)).all()


def test_what_is_not_seen_has_infinite_covariance() -> None:
    window = Window(np.full(60, 296.0 - KELVIN), np.full(60, 296.0 - KELVIN), np.zeros(60))
    posed = problem(window)
    found = Estimate(posed, posed.values_of(TRUTH), converged=True)
    known = uncertainty(posed, found)
    assert known.condition == np.inf
    assert np.isinf(known.covariance).all()


def test_starts_cover_the_valley_of_what_is_free(record: Recorder) -> None:
    window = record(TRUTH)
    assert len(starts_for(problem(window), TRUTH)) == 3
    assert len(starts_for(problem(window, ("ambient",)), TRUTH)) == 1
    mass = Problem(window, SINK.structure.free, WITH_SINK, Noise.of(Peltier), Peltier.loop)
    assert [s[-1] for s in starts_for(mass, WITH_SINK)] == [296.0] * 3
    posed = problem(window, ("conductance", "ambient"))
    assert [s.tolist() for s in starts_for(posed, TRUTH)] == [[0.6, 296.0], [0.6, 296.0], [0.5, 296.0]]
    with pytest.raises(ValueError, match="no start; give at least one"):
        solve(posed, [])


def test_bounds_are_named(record: Recorder) -> None:
    posed = problem(record(TRUTH))
    assert on_bounds(posed, np.array([0.075, 0.6, 30.0])) == ()
    assert on_bounds(posed, np.array([0.2, 0.0, 30.0])) == ("seebeck", "conductance")
