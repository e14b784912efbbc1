"""Matching three parameters on a closed loop: twinmatch, CasADi, numba with Runge–Kutta, solve_ivp.

One fit of Seebeck coefficient, conductance and heat capacity to a simulated, noisy window. Ours searches
from three starts, the peers from one; a separate row shows ours from one. All use the same loop, start and
weights; the peers integrate each tick with Runge–Kutta of order 4 in four steps (solve_ivp with its own
steps). CasADi's graph is built beforehand and not counted. The note gives the estimated parameters, on which
all should agree.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from benchmarks.common import Row, Timing, main, measure_side_by_side, peer, rows_of
from twinmatch.dynamics import PidGains, Sensor, begin, simulate_closed_loop
from twinmatch.fitting import Noise, match
from twinmatch.fitting.estimation import solve, starts_for
from twinmatch.fitting.problem import Problem
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, Window

Array = NDArray[np.float64]

MODEL = Peltier.model()
TRUTH = MODEL.parameters(seebeck=0.07, conductance=0.6, heat_capacity=31.0)
START = MODEL.parameters()
LEVELS = (30.0, 55.0, 42.0, 75.0, 60.0, 90.0, 50.0)
assert Peltier.loop is not None
GAINS: PidGains = Peltier.loop
NOISE = Noise.of(Peltier)
FREE = MODEL.structure.free
AMBIENT = START["ambient"]
RESISTANCE = START["resistance"]
LOOP_RESISTANCE = RESISTANCE + START["bridge_resistance"]
CURRENT_LIMIT = START["current_limit"]
VOLTS_PER_COUNT = START["supply"] / GAINS.high
KP, KI, KD, KB, PERIOD, LIMIT = *GAINS.code[5:9], GAINS.period, GAINS.high
STEPS = 4
"""Runge–Kutta steps of the peers in each tick."""
LOW, HIGH = (
    np.array([MODEL.declared[name].bounds[end] for name in FREE]) for end in (0, 1)
)
SCALE = np.array([MODEL.declared[name].scale for name in FREE])
FIRST = np.array([START[name] for name in FREE])


def run(quick: bool) -> list[Row]:
    rows = []
    repeats = 3 if quick else 11
    for samples, target in ((500, 5e-3),) if quick else ((500, 5e-3), (3600, 30e-3)):
        rows += _one_fit(samples, repeats, target, slow=not quick and samples == 500)
    rows += _whole_match(repeats)
    return rows + _growth(
        (600, 1200) if quick else (600, 1200, 3600, 12_000, 36_000), repeats
    )


def record(samples: int, seed: int = 7) -> Window:
    """A window of the rig: a new level every 240 samples, measured by a noisy camera."""
    count = -(-samples // 240)
    reference = np.repeat([LEVELS[k % len(LEVELS)] for k in range(count)], 240)[
        :samples
    ].astype(np.float64)
    camera = Sensor(noise=NOISE.output).realise(samples, GAINS.period, seed)
    response = simulate_closed_loop(
        TRUTH, reference, states=begin(TRUTH, LEVELS[0]), sensor=camera
    )
    return Window(reference, response.output, response.input)


def pose(window: Window) -> Problem:
    return Problem(window, FREE, START, NOISE, GAINS)


def fit(window: Window) -> Array:
    problem = pose(window)
    return solve(problem, starts_for(problem, START)).values


def fit_from_one(window: Window) -> Array:
    problem = pose(window)
    return solve(problem, [problem.values_of(START)]).values


def _one_fit(samples: int, repeats: int, target: float, *, slow: bool) -> list[Row]:
    window = record(samples)
    problem = pose(window)
    cases: dict[str, Callable[[], object]] = {
        "twinmatch": lambda: fit(window),
        "twinmatch, one start": lambda: fit_from_one(window),
        "numba RK4, differences": lambda: _by_differences(problem, _numba_outputs),
    }
    if (casadi := peer("casadi")) is not None:
        linearise = _casadi_residuals(casadi, problem)
        cases["CasADi, Gauss–Newton"] = lambda: _gauss_newton(linearise)
    if slow:
        cases["solve_ivp, least_squares"] = lambda: _by_differences(
            problem, _solve_ivp_outputs
        )
    timings = measure_side_by_side(cases, repeats, patience=60.0)
    return rows_of(
        "matching",
        f"one fit, {samples} samples",
        timings,
        targets={
            "twinmatch": target,
            "CasADi, Gauss–Newton": 20,
            "solve_ivp, least_squares": 300,
        },
        notes=_found(timings),
    )


def _found(timings: dict[str, Timing]) -> dict[str, str]:
    return {
        name: "α {:.5f}, K {:.4f}, C {:.3f}".format(*timing.result)
        for name, timing in timings.items()
        if timing.result is not None
    }


def _whole_match(repeats: int) -> list[Row]:
    """The complete match: test fit, fit, covariance, intervals, suggestion."""
    rows = []
    for samples in (300, 720):
        window = record(samples)
        timings = measure_side_by_side(
            {"twinmatch": partial(match, window, start=START)}, repeats
        )
        case = f"a match with intervals and suggestion, {samples} samples"
        rows += rows_of("matching", case, timings, targets={"twinmatch": 20e-3})
    return rows


def _growth(sizes: tuple[int, ...], repeats: int) -> list[Row]:
    windows = {size: record(size) for size in sizes}
    cases = {
        str(size): (lambda window=window: fit(window))
        for size, window in windows.items()
    }
    timings = measure_side_by_side(cases, repeats)
    smallest = timings[str(sizes[0])]
    rows = []
    for size in sizes:
        timing = timings[str(size)]
        more = timing.ratio_to(smallest) or float("nan")
        note = f"{more:.1f} times the time for {size / sizes[0]:g} times the samples"
        case = f"one fit, growth, {size} samples"
        rows += rows_of(
            "matching", case, {"twinmatch": timing}, notes={"twinmatch": note}
        )
    return rows


def _by_differences(
    problem: Problem, outputs: Callable[[Problem, Array], tuple[Array, Array]]
) -> Array:
    def residuals(values: Array) -> Array:
        temperature, pwm = outputs(problem, values)
        return np.concatenate(
            [
                (problem.measured[0] - temperature) / NOISE.output,
                (problem.measured[1] - pwm) / NOISE.input,
            ]
        )

    return np.asarray(
        least_squares(residuals, FIRST, bounds=(LOW, HIGH), x_scale=SCALE, ftol=1e-8).x
    )


def _numba_outputs(problem: Problem, values: Array) -> tuple[Array, Array]:
    return _runge_kutta_loop(
        values,
        np.array([RESISTANCE, LOOP_RESISTANCE, CURRENT_LIMIT, AMBIENT]),
        np.array([KP, KI, KD, KB, PERIOD, LIMIT]),
        VOLTS_PER_COUNT,
        problem.window.reference[2:],
        float(problem.window.output[2]) + KELVIN,
        *problem.experiment.controller.tolist(),
    )


@numba.njit
def _rate(values: Array, rig: Array, volts: float, plate: float) -> float:
    current = (-volts - values[0] * (rig[3] - plate)) / rig[1]
    current = min(max(current, -rig[2]), rig[2])
    drawn = (
        values[0] * plate * current
        - 0.5 * current * current * rig[0]
        + values[1] * (plate - rig[3])
    )
    return -drawn / values[2]


@numba.njit
def _runge_kutta_loop(  # noqa: PLR0917
    values: Array,
    rig: Array,
    gains: Array,
    volts_per_count: float,
    reference: Array,
    plate: float,
    integral: float,
    previous: float,
) -> tuple[Array, Array]:
    p, i, d, back, period, limit = gains
    temperature = np.empty(reference.size)
    pwm = np.empty(reference.size)
    h = period / STEPS
    for k in range(reference.size):
        error = reference[k] - (plate - KELVIN)
        wanted = p * error + integral + d * (error - previous) / period
        u = min(max(wanted, -limit), limit)
        integral += period * (i * error + back * (u - wanted))
        previous = error
        temperature[k], pwm[k] = plate - KELVIN, u
        volts = u * volts_per_count
        for _ in range(STEPS):
            k1 = _rate(values, rig, volts, plate)
            k2 = _rate(values, rig, volts, plate + 0.5 * h * k1)
            k3 = _rate(values, rig, volts, plate + 0.5 * h * k2)
            k4 = _rate(values, rig, volts, plate + h * k3)
            plate += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return temperature, pwm


def _solve_ivp_outputs(problem: Problem, values: Array) -> tuple[Array, Array]:
    a, k, c = values.tolist()
    integral, previous = problem.experiment.controller.tolist()
    plate = float(problem.window.output[2]) + KELVIN
    temperature = []
    pwm = []

    def rate(_time: float, state: Array, volts: float) -> list[float]:
        current = (-volts - a * (AMBIENT - state[0])) / LOOP_RESISTANCE
        current = min(max(current, -CURRENT_LIMIT), CURRENT_LIMIT)
        half_joule = 0.5 * current * current * RESISTANCE
        return [-(a * state[0] * current - half_joule + k * (state[0] - AMBIENT)) / c]

    for reference in problem.window.reference[2:].tolist():
        error = reference - (plate - KELVIN)
        wanted = KP * error + integral + KD * (error - previous) / PERIOD
        u = min(max(wanted, -LIMIT), LIMIT)
        integral += PERIOD * (KI * error + KB * (u - wanted))
        previous = error
        temperature.append(plate - KELVIN)
        pwm.append(u)
        done = solve_ivp(
            rate,
            (0.0, PERIOD),
            [plate],
            args=(u * VOLTS_PER_COUNT,),
            rtol=1e-7,
            atol=1e-7,
        )
        plate = float(done.y[0, -1])
    return np.array(temperature), np.array(pwm)


def _casadi_residuals(
    casadi: Any, problem: Problem
) -> Callable[[Array], tuple[Array, Array]]:
    """Residuals and their Jacobian from one graph: a tick, accumulated over the window."""
    state = casadi.SX.sym("x", 3)
    reference = casadi.SX.sym("r")
    values = casadi.SX.sym("p", 3)
    plate = state[0]
    integral = state[1]
    previous = state[2]
    error = reference - (plate - KELVIN)
    wanted = KP * error + integral + KD * (error - previous) / PERIOD
    u = casadi.fmin(casadi.fmax(wanted, -LIMIT), LIMIT)

    def rate(now: Any) -> Any:
        current = (-u * VOLTS_PER_COUNT - values[0] * (AMBIENT - now)) / LOOP_RESISTANCE
        current = casadi.fmin(casadi.fmax(current, -CURRENT_LIMIT), CURRENT_LIMIT)
        half_joule = 0.5 * current**2 * RESISTANCE
        return (
            -(values[0] * now * current - half_joule + values[1] * (now - AMBIENT))
            / values[2]
        )

    h = PERIOD / STEPS
    after = plate
    for _ in range(STEPS):
        k1 = rate(after)
        k2 = rate(after + 0.5 * h * k1)
        k3 = rate(after + 0.5 * h * k2)
        k4 = rate(after + h * k3)
        after = after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    following = casadi.vertcat(
        after, integral + PERIOD * (KI * error + KB * (u - wanted)), error
    )
    outputs = casadi.vertcat(
        (plate - KELVIN) / NOISE.output,
        u / NOISE.input,
    )
    tick = casadi.Function("tick", [state, reference, values], [following, outputs])
    size = problem.measured.shape[1]
    loop = tick.mapaccum("loop", size)
    free = casadi.MX.sym("p", 3)
    integral, previous = problem.experiment.controller.tolist()
    start = casadi.DM([float(problem.window.output[2]) + KELVIN, integral, previous])
    _, simulated = loop(
        start, problem.window.reference[2:].reshape(1, -1), casadi.repmat(free, 1, size)
    )
    measured = problem.measured * problem.weights
    left = casadi.vec(casadi.DM(measured) - simulated)
    both = casadi.Function("both", [free], [left, casadi.jacobian(left, free)])

    def linearise(values: Array) -> tuple[Array, Array]:
        residuals, jacobian = both(values)
        return np.asarray(residuals).ravel(), np.asarray(jacobian)

    return linearise


def _gauss_newton(linearise: Callable[[Array], tuple[Array, Array]]) -> Array:
    """Gauss–Newton inside the bounds, damped only as much as necessary."""
    values = FIRST.copy()
    residuals, jacobian = linearise(values)
    damping = 1e-4
    for _ in range(60):
        scaled = jacobian * SCALE
        hessian = scaled.T @ scaled
        gradient = scaled.T @ residuals
        step = (
            -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
            * SCALE
        )
        tried = np.clip(values + step, LOW, HIGH)
        there, slopes = linearise(tried)
        before = residuals @ residuals
        after = there @ there
        if after < before:
            values = tried
            residuals = there
            jacobian = slopes
            damping = damping / 10
            if before - after <= 1e-8 * before:
                break
        elif np.max(np.abs(step) / SCALE) < 1e-8:
            break
        else:
            damping *= 10
    return values


if __name__ == "__main__":
    main(run, __doc__)
