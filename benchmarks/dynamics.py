"""An hour of the closed loop with tangents of six parameters: generated code, CasADi, differences.
Also a sample of the observer, and a forecast of 300 samples.

The richest useful Peltier structure: plate and heat sink, six unknown parameters. CasADi gets the same
equations, also from SymPy, the same Runge–Kutta steps and the same controller, and differentiates in forward
mode; its graph is built beforehand and not counted. `solve_ivp` runs the loop without tangents. The note of a
peer gives the difference of its tangents, or its output, from ours. The observer is compared with the same
filter in NumPy, the forecast with 200 runs of the loop with random states, parameters and noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks.common import Row, main, measure_side_by_side, peer, rows_of
from twinmatch.dynamics import (
    Controller,
    Experiment,
    Foresight,
    Observer,
    SensorRealisation,
    advance,
    begin,
    law_of,
    simulate_closed_loop,
)
from twinmatch.dynamics.equations import derive
from twinmatch.plants import Peltier
from twinmatch.signals import Window

Array = NDArray[np.float64]

MODEL = Peltier.model("sink with mass, free ambient, switched drive")
RIG = MODEL.parameters()
LEVELS = (30.0, 55.0, 42.0, 75.0, 60.0, 90.0, 50.0)


def run(quick: bool) -> list[Row]:
    size = 600 if quick else 3600
    reference = np.repeat(
        [LEVELS[k % len(LEVELS)] for k in range(size // 240 + 1)], 240
    )[:size]
    sensor = Peltier.sensor.realise(size, 1.0, 7) if Peltier.sensor else None
    held = simulate_closed_loop(RIG, reference, states=begin(RIG, 30.0), sensor=sensor)
    experiment = Experiment(
        RIG, MODEL.structure.free, Window(reference, held.output, held.input)
    )
    values = experiment.values_of(RIG)

    def differences() -> Array:
        base = np.stack([(r := experiment.simulate(values)).output, r.input])
        columns = []
        for j in range(values.size):
            moved = values.copy()
            moved[j] *= 1 + 1e-6
            there = experiment.simulate(moved)
            columns.append(
                (np.stack([there.output, there.input]) - base) / (moved[j] - values[j])
            )
        return np.stack(columns, axis=2)

    cases: dict[str, Any] = {
        "twinmatch": lambda: experiment.tangents(values).by,
        "the same, normal equations only": lambda: experiment.normal(values),
        "the same, by differences": differences,
    }
    if (casadi := peer("casadi")) is not None:
        cases["CasADi, forward"] = _casadi_tangents(casadi, experiment, values)
    if not quick:
        cases["solve_ivp, no tangents"] = lambda: _solve_ivp(experiment)
    timings = measure_side_by_side(cases, 3 if quick else 15, patience=60.0)
    ours = timings["twinmatch"].result
    notes = {}
    for name in ("the same, by differences", "CasADi, forward"):
        theirs = timings[name].result if name in timings else None
        if theirs is not None:
            scale = np.max(np.abs(ours), axis=1, keepdims=True)
            notes[name] = (
                f"tangents differ by {np.max(np.abs(theirs - ours) / scale):.1e} at most"
            )
    if (
        "solve_ivp, no tangents" in timings
        and timings["solve_ivp, no tangents"].result is not None
    ):
        off = np.max(
            np.abs(
                timings["solve_ivp, no tangents"].result
                - experiment.simulate(values).output
            )
        )
        notes["solve_ivp, no tangents"] = f"output differs by {off:.1e} K at most"
    rows = rows_of(
        "dynamics",
        f"loop of {size} samples with {values.size} tangents",
        timings,
        targets={"twinmatch": 1e-3 * size / 3600},
        notes=notes,
    )
    return rows + _observer(quick) + _forecast(quick)


def _observer(quick: bool) -> list[Row]:
    """One sample: one correction and one prediction."""
    ours = Observer(RIG, 30.0, period=1.0, drift=[0.02, 0.02], start=[0.2, 3.0])
    theirs = Observer(RIG, 30.0, period=1.0, drift=[0.02, 0.02], start=[0.2, 3.0])
    held: dict[str, Array] = {"states": theirs.states, "covariance": theirs.covariance}
    vector = RIG.vector
    row = MODEL.disturbances
    steps = RIG.steps(1.0)
    noise = MODEL.plant.output.noise**2
    nowhere = np.zeros((2, 0), dtype=np.int64)

    def compiled() -> Array:
        ours.correct(30.1)
        ours.predict(10.0)
        return np.asarray(ours.states)

    def numpy() -> Array:
        states = held["states"]
        covariance = held["covariance"]
        slope = MODEL.kernels.slopes_at(vector, states, MODEL.rest, row)[4][0]
        reach = covariance @ slope
        gain = reach / (slope @ reach + noise)
        states = states + gain * (
            30.1 - MODEL.kernels.outputs_at(vector, states, MODEL.rest, row)[0][0]
        )
        kept = np.eye(2) - np.outer(gain, slope)
        covariance = kept @ covariance @ kept.T + noise * np.outer(gain, gain)
        slopes = MODEL.kernels.predict(
            vector,
            states,
            np.zeros((2, 2)),
            np.zeros(2),
            np.array([10.0]),
            row,
            1.0,
            steps,
            nowhere,
        )
        held["states"] = states
        held["covariance"] = slopes[:, :2] @ covariance @ slopes[
            :, :2
        ].T + 4e-4 * np.eye(2)
        return states

    cases = {"twinmatch": compiled, "the same filter in NumPy": numpy}
    timings = measure_side_by_side(cases, 3 if quick else 15, keeping=True)
    return rows_of(
        "dynamics",
        "a sample of the observer",
        timings,
        targets={"twinmatch": 4e-6},
        notes={},
    )


def _forecast(quick: bool) -> list[Row]:
    """The same mean and band by linearisation and by random runs."""
    unsure = MODEL.structure.free
    law = law_of(Peltier, 1.0)
    states = begin(RIG, 45.0)
    reference = np.repeat([45.0, 55.0], 150)
    spread = np.array(
        [0.05, 0.3, *(0.005 * MODEL.declared[name].scale for name in unsure)]
    )
    rng = np.random.default_rng(3)
    runs = 20 if quick else 200

    def foretold() -> Array:
        known = Foresight([(RIG, unsure)], law, drift=[[0.0, 0.0]])
        now = known.at([states], [np.diag(spread**2)], 0.0, None)
        return known.ahead(now, reference).output_variances

    def drawn() -> Array:
        outputs = np.empty((runs, reference.size))
        for k in range(runs):
            moved = spread * rng.standard_normal(spread.size)
            changes = {
                name: RIG[name] + change
                for name, change in zip(unsure, moved[2:], strict=True)
            }
            plant = RIG.replace(**changes)
            there = advance(plant, states + moved[:2], 0.0, 1.0)
            noise = SensorRealisation(
                0.1 * rng.standard_normal(reference.size), np.zeros(300, np.bool_), 0.0
            )
            outputs[k] = simulate_closed_loop(
                plant, reference, states=there, law=law, sensor=noise
            ).output  # fmt: skip
        return np.asarray(outputs.var(axis=0))

    cases = {"twinmatch": foretold, f"{runs} runs drawn at random": drawn}
    timings = measure_side_by_side(cases, 3 if quick else 15)
    ratio = np.sqrt(
        np.median(
            timings[f"{runs} runs drawn at random"].result / timings["twinmatch"].result
        )
    )
    return rows_of(
        "dynamics",
        f"a forecast of {reference.size} samples",
        timings,
        targets={"twinmatch": 2e-4},
        notes={
            f"{runs} runs drawn at random": f"its band of y is {ratio:.2f} times ours, in the median"
        },
    )


def _casadi_tangents(casadi: Any, experiment: Experiment, values: Array) -> Any:
    """A call that gives the derivatives of output and input, shape (2, N, n)."""
    import sympy  # noqa: PLC0415

    derived = derive(Peltier(), MODEL.structure.parts, frozenset(MODEL.structure.free))
    symbols = [*derived.states, *derived.inputs, *derived.parameters]
    written = Peltier().equations(MODEL.structure.parts)
    names = {"Max": casadi.fmax, "Min": casadi.fmin, "Abs": casadi.fabs}
    rates = sympy.lambdify(
        symbols, [written.rates[s] for s in derived.states], [names, casadi]
    )

    n = values.size
    nx = len(derived.states)
    state = casadi.SX.sym("x", nx + 2)
    reference = casadi.SX.sym("r")
    free = casadi.SX.sym("p", n)
    known = {name: float(RIG[name]) for name in RIG} | {
        m: free[j] for j, m in enumerate(experiment.free)
    }
    parameters = [known[str(s)] for s in derived.parameters]
    gains = Peltier.loop
    output = state[0] - 273.15
    error = reference - output
    wanted = (
        gains.proportional * error
        + state[nx]
        + gains.derivative * (error - state[nx + 1])
    )
    u = casadi.fmin(casadi.fmax(wanted, gains.low), gains.high)
    integral = (
        state[nx] + gains.integral * error + gains.back_calculation * (u - wanted)
    )
    steps = RIG.steps(1.0)
    h = 1.0 / steps
    now = casadi.vertcat(*[state[i] for i in range(nx)])

    def rate(at: Any) -> Any:
        return casadi.vertcat(*rates(*[at[i] for i in range(nx)], u, *parameters))

    for _ in range(steps):
        k1 = rate(now)
        k2 = rate(now + 0.5 * h * k1)
        k3 = rate(now + 0.5 * h * k2)
        k4 = rate(now + h * k3)
        now = now + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    tick = casadi.Function(
        "tick",
        [state, reference, free],
        [casadi.vertcat(now, integral, error), casadi.vertcat(output, u)],
    )
    size = experiment.measured.shape[1]
    unknown = casadi.MX.sym("p", n)
    ambient = unknown[experiment.free.index("ambient")]
    first = casadi.vertcat(
        experiment.measured[0, 0] + 273.15,
        ambient,
        *experiment.controller.tolist(),
    )
    _, found = tick.mapaccum("loop", size)(
        first,
        experiment.window.reference[2:].reshape(1, -1),
        casadi.repmat(unknown, 1, size),
    )
    jacobian = casadi.Function(
        "jacobian", [unknown], [casadi.jacobian(casadi.vec(found), unknown)]
    )

    def call() -> Array:
        return np.asarray(jacobian(values)).reshape(size, 2, n).transpose(1, 0, 2)

    return call


def _solve_ivp(experiment: Experiment) -> Array:
    """The output of the loop, with every tick integrated by scipy."""
    written = derive(Peltier(), MODEL.structure.parts, frozenset())
    import sympy  # noqa: PLC0415

    equations = Peltier().equations(MODEL.structure.parts)
    symbols = [*written.states, *written.inputs, *written.parameters]
    rates = sympy.lambdify(
        symbols, [equations.rates[s] for s in written.states], "math"
    )
    parameters = [RIG[str(s)] for s in written.parameters]
    pid = Controller(Peltier.loop, Peltier.loop.state(experiment.window))
    states = begin(RIG, float(experiment.measured[0, 0]))
    output = []

    def rate(_time: float, states: Array, u: float) -> Any:
        return rates(*states, u, *parameters)

    for reference in experiment.window.reference[2:].tolist():
        output.append(states[0] - 273.15)
        u = pid.step(reference, output[-1])[0]
        done = solve_ivp(rate, (0.0, 1.0), states, args=(u,), rtol=1e-8, atol=1e-8)
        states = done.y[:, -1]
    return np.array(output)


if __name__ == "__main__":
    main(run, __doc__)
