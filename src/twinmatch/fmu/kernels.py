"""Simulation and derivatives of an FMU, with the interface of the compiled kernels of native equations.

The functions have the names and arguments of those in `twinmatch.dynamics.kernels`, `runs` and
`filters`. Most FMUs provide no derivatives by parameters, so every derivative is a central difference:
of whole runs for the sensitivities of a match, and of single samples for the linearisations of an observer or
a forecast. One request to the FMU's process contains all of these runs.
"""

# ruff: noqa: PLR0917 (they take the arguments of kernels)

from __future__ import annotations

from typing import Any, Final

import numpy as np

from twinmatch.dynamics.descent import Search, update_search
from twinmatch.dynamics.loop import Gains
from twinmatch.dynamics.runs import LeastSquares
from twinmatch.fmu.archive import MODEL_EXCHANGE, FmuError
from twinmatch.fmu.differences import Differences
from twinmatch.fmu.runner import Runner, Signals
from twinmatch.signals import FloatArray


def _weighted(
    simulated: FloatArray, measured: FloatArray, weights: FloatArray, robust: bool
) -> tuple[FloatArray, FloatArray, float]:
    """Residuals, squared weights, and total cost, as in `add_row`."""
    count = len(simulated)
    left = simulated - measured[:count]
    square = np.square(weights[:count])
    lost = square * left * left
    if robust:
        root = np.sqrt(1.0 + lost)
        return left, square / root, float(np.sum(2.0 * (root - 1.0)))
    return left, square, float(np.sum(lost))


def cost_of(simulated: FloatArray, measured: FloatArray, weights: FloatArray, robust: bool) -> float:
    """Sum of the squared weighted residuals, or of their robust cost if `robust`."""
    return _weighted(simulated, measured, weights, robust)[2]


def normal_of(
    simulated: FloatArray, by: FloatArray, measured: FloatArray, weights: FloatArray, robust: bool
) -> FloatArray:
    """[J r]ᵀ[J r] with the sum of the costs in its last entry, shape (n + 1, n + 1)."""
    left, square, cost = _weighted(simulated, measured, weights, robust)
    rows = np.concatenate([by, left[:, :, None]], axis=2).reshape(-1, by.shape[2] + 1)
    normal = np.asarray(np.einsum("ki,k,kj->ij", rows, square.ravel(), rows))
    normal[-1, -1] = cost
    return normal


class FmuKernels:
    """The kernels of a structure that is an FMU; each has the arguments of the compiled one."""

    QUANTITIES: Final[tuple[str, ...]] = ()
    RATE_LIMIT: Final = 0.06
    """Integrator step in units of the fastest time constant, as for the native equations."""
    MOST_STEPS: Final = 2000

    def __init__(self, runner: Runner, differences: Differences) -> None:
        self._runner, self._differences = runner, differences
        self.STATES, self.PARAMETERS = runner.map.known_states, runner.map.known_parameters
        self.UNKNOWN = self.PARAMETERS
        self._counts: dict[tuple[bytes, float, float], int] = {}

    def begin(
        self, vector: FloatArray, y: float, u: float, d: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Initial states at an output y after a drive u, and their derivatives by y and by the parameters."""
        return self._differences.begin(vector, y, u, d)

    def advance(
        self, vector: FloatArray, x: FloatArray, u: float, d: FloatArray, period: float, steps: int
    ) -> FloatArray:
        """The states one period later."""
        return self._numbers(self._ticks(vector, x, u, d, period, steps)[1][0])

    def outputs_at(
        self, vector: FloatArray, x: FloatArray, u: float, d: FloatArray
    ) -> tuple[float, FloatArray]:
        """The output; an FMU has no other quantities."""
        found = self._runner.outputs(np.append(vector, x)[None], np.array([u]), d[None])
        return float(found[0]), np.zeros(0)

    def parts(
        self, vector: FloatArray, y: float, before: FloatArray, u: float, rest: float, d: FloatArray,
        period: float, steps: int,
    ) -> tuple[float, float, FloatArray]:  # fmt: skip
        """Change of the output over one period due to the drive, change due to all else, and the states."""
        x, by_y, _ = self.begin(vector, y, u, d)
        x = np.where((by_y == 0.0) & ~np.isnan(before), before, x)
        both = np.tile(np.append(vector, x), (2, 1))
        at, after = self._runner.ticks(both, np.array([u, rest]), np.tile(d, (2, 1)), period, steps)
        n = vector.size
        both[:, n:] = after
        driven, idle = self._runner.outputs(both, np.array([u, rest]), np.tile(d, (2, 1)))
        return float(driven - idle), float(idle - at[0]), after[0]

    def slopes_at(
        self, vector: FloatArray, x: FloatArray, u: float, d: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Rates, their derivatives by states, drive and parameters, and the output's by states, parameters.

        For co-simulation, the rates are differences over one sample, which have the same equilibria.
        """
        n, m = x.size, vector.size
        moved = self._differences.around(np.append(vector, x), u, range(n + m), drive_too=True)
        given = np.tile(d, (len(moved.drive), 1))
        if self._started() == MODEL_EXCHANGE:
            y, rates = self._runner.rates(moved.fixed, moved.drive, given)
        else:
            period = self._differences.period
            y, after = self._runner.ticks(moved.fixed, moved.drive, given, period, 1)
            rates = (after - moved.fixed[:, m:]) / period
        of_rates, of_y = moved.slopes(rates), moved.slopes(y[:, None])[0]
        fx, fu, fp = of_rates[:, m : m + n], of_rates[:, -1], of_rates[:, :m]
        return rates[0], fx, fu, fp, of_y[m : m + n], of_y[:m]

    def step_count(
        self, vector: FloatArray, corners: FloatArray, drives: FloatArray, d: FloatArray, period: float,
        limit: float,
    ) -> int:  # fmt: skip
        """Runge–Kutta steps per sample, as for the native equations; 1 for co-simulation."""
        if self._started() != MODEL_EXCHANGE:
            return 1
        key = (vector.tobytes(), period, limit)
        if key not in self._counts:
            if len(self._counts) > self.MOST_STEPS:
                self._counts.clear()
            count = np.ceil(period * self._fastest(vector, corners, drives, d) / limit)
            self._counts[key] = int(max(count, 1.0)) if count <= self.MOST_STEPS else self.MOST_STEPS + 1
        return self._counts[key]

    def run(
        self, vector: FloatArray, x: FloatArray, closed: bool, gains: Gains, reference: FloatArray,
        given: FloatArray, disturbances: FloatArray, noise: FloatArray, frozen: FloatArray,
        resolution: float, integral: float, previous_error: float, period: float, steps: int,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Output, input, both shape (N,), and states before each sample, shape (N + 1, nx)."""
        signals = Signals(
            closed, gains, reference if closed else given, disturbances, noise, frozen, resolution,
            integral, previous_error, period, steps,
        )  # fmt: skip
        y, u, states = self._runner.runs(np.append(vector, x)[None], signals)
        return self._numbers(y[0]), self._numbers(u[0]), self._numbers(states[0])

    def run_with_tangents(
        self, vector: FloatArray, which: Any, x: FloatArray, columns: FloatArray, closed: bool, gains: Gains,
        reference: FloatArray, given: FloatArray, disturbances: FloatArray, integral: float,
        previous_error: float, period: float, steps: int, measured: FloatArray, weights: FloatArray,
        robust: bool, stored: bool, limit: float,
    ) -> tuple[
        FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray
    ]:  # fmt: skip
        """The run with its derivatives: as arrays if `stored`, otherwise as normal equations."""
        still = np.zeros(disturbances.shape[0])
        signals = Signals(
            closed, gains, reference if closed else given, disturbances, still, still, 0.0,
            integral, previous_error, period, steps,
        )  # fmt: skip
        m, n = vector.size, columns.shape[1]
        y, u, states = self._runner.runs(np.append(vector, x)[None], signals)
        outputs = 2 if closed else 1
        simulated = np.stack([y[0], u[0]])
        normal = np.zeros((n + 1, n + 1))
        by = np.zeros((2, simulated.shape[1], n))
        cost = cost_of(simulated[:outputs], measured, weights, robust)
        if stored or not cost > limit:
            directions = np.zeros((n, m + x.size))
            directions[np.arange(len(which)), which] = 1.0
            directions[:, m:] = columns.T
            moved = self._differences.along(np.append(vector, x), directions)
            of_y, of_u, _ = self._runner.runs(moved.fixed, signals)
            by[:outputs] = np.stack([moved.slopes(of_y), moved.slopes(of_u)])[:outputs]
        if not stored:
            normal[:, :] = normal_of(simulated[:outputs], by[:outputs], measured, weights, robust)
            none = np.zeros((0, 0))
            return y[0][:0], u[0][:0], by[:, :0], none, none, none, none, normal
        free = ((u[0] > gains.low) & (u[0] < gains.high)).astype(np.float64) if closed else np.zeros(y.size)
        by_state, by_drive, seen = self._movements(vector, states[0][:-1], u[0], disturbances, period, steps)
        return y[0], u[0], by, by_state, by_drive, free, seen, normal

    def foresee(
        self, vector: FloatArray, which: Any, x: FloatArray, joint: FloatArray, process_noise: FloatArray,
        u: float, closed: bool, gains: Gains, signal: FloatArray, disturbances: FloatArray, integral: float,
        previous: float, period: float, steps: int, banded: bool,
    ) -> tuple[FloatArray, ...]:  # fmt: skip
        """Output and input beyond the newest sample and, if `banded`, the derivatives of that run; `x` and
        `joint`, those at that sample, are then moved by one period."""
        begun = self.advance(vector, x, u, disturbances[0], period, steps)
        loop = (closed, gains, signal, signal, disturbances[1:])
        still, ahead = np.zeros(signal.size), (integral, previous, period, steps)
        y, commanded, _ = self.run(vector, begun, *loop, still, still, 0.0, *ahead)
        if not banded:
            return y, commanded
        n, m, none = x.size, which.shape[1], np.zeros((2, signal.size))
        moved = np.zeros((n, m + n + 1))
        self.predict(vector, x, joint, process_noise, u, disturbances[0], period, steps, which, moved)
        columns = np.eye(n, m + n, m)
        derivatives = self.run_with_tangents(
            vector, which[0], begun, columns, *loop, *ahead, none, none, False, True, np.inf
        )
        return y, commanded, *derivatives[2:7]

    def start_at(
        self, problem: LeastSquares, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, int]:
        """Parameters, initial states, their derivatives by the unknowns, and steps per sample."""
        n, started = problem.which.size, problem.started
        vector = problem.base.copy()
        vector[problem.places] = values[:n]
        x, _, by_parameters = self.begin(vector, problem.first, problem.input_before, problem.disturbances[0])
        columns = np.zeros((x.size, values.size))
        columns[:, :n] = by_parameters[:, problem.which]
        x[started] = values[n:]
        columns[started] = 0.0
        columns[started, n + np.arange(started.size)] = 1.0
        steps = self.step_count(
            vector,
            problem.corners,
            problem.drives,
            problem.default_disturbances,
            problem.period,
            problem.rate_limit,
        )
        return vector, x, columns, steps

    def normal_at(
        self, problem: LeastSquares, values: FloatArray, limit: float
    ) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient Jᵀr and JᵀJ of the weighted residuals; infinite if the FMU has no finite values."""
        n = values.size
        nowhere = np.inf, np.zeros(n), np.zeros((n, n))
        vector, x, columns, steps = self.start_at(problem, values)
        if steps > self.MOST_STEPS:
            return nowhere
        normal = self.run_with_tangents(
            vector, problem.which, x, columns, problem.closed, problem.gains, problem.reference,
            problem.measured[1], problem.disturbances, problem.integral, problem.previous, problem.period,
            steps, problem.measured, problem.weights, problem.robust, False, limit,
        )[7]  # fmt: skip
        if not np.isfinite(normal).all():
            return nowhere
        off = values - problem.expected
        cost = normal[n, n] + float(np.sum(problem.pull * off * off))
        return cost, normal[n, :n] + problem.pull * off, normal[:n, :n] + np.diag(problem.pull)

    def search(self, problem: LeastSquares, state: Search) -> None:
        """Let a search run to its end."""
        found = self.normal_at(problem, state.point.copy(), np.inf)
        while update_search(state, *found):
            found = self.normal_at(problem, state.point.copy(), float(state.best[0]))

    def correct(
        self, vector: FloatArray, x: FloatArray, covariance: FloatArray, y: float, d: FloatArray,
        noise: float, limit: float, which: Any, bounds: FloatArray,
    ) -> tuple[float, float]:  # fmt: skip
        """Innovation of a measurement and its predicted variance; updates states, parameters and covariance
        in place."""
        m, n = vector.size, x.size
        places = [*(m + np.arange(n)), *which[1]]
        moved = self._differences.around(np.append(vector, x), self._differences.rest, places)
        seen = self._runner.outputs(moved.fixed, moved.drive, np.tile(d, (len(moved.drive), 1)))
        surprise, slope = y - float(seen[0]), moved.slopes(seen[:, None])[0]
        reach = covariance @ slope
        variance = noise * noise + float(slope @ reach)
        if not np.isfinite(surprise + variance):
            return np.nan, np.nan
        most = limit * np.sqrt(variance)
        gain = (most / abs(surprise) if abs(surprise) > most else 1.0) * reach / variance
        x += gain[:n] * surprise
        vector[which[1]] = np.clip(vector[which[1]] + gain[n:] * surprise, *bounds)
        kept = np.eye(gain.size) - np.outer(gain, slope)
        after = kept @ covariance @ kept.T + noise * noise * np.outer(gain, gain)
        covariance[:] = 0.5 * (after + after.T)
        return surprise, variance

    def predict(
        self, vector: FloatArray, x: FloatArray, covariance: FloatArray, process_noise: FloatArray, u: float,
        d: FloatArray, period: float, steps: int, which: Any, columns: FloatArray,
    ) -> None:  # fmt: skip
        """Advance states and joint covariance by one period, in place."""
        m, n = vector.size, x.size
        estimated = which.shape[1]
        places = [*which[0], *(m + np.arange(n))]
        moved = self._differences.around(np.append(vector, x), u, places, drive_too=True)
        given = np.tile(d, (len(moved.drive), 1))
        _, after = self._runner.ticks(moved.fixed, moved.drive, given, period, steps)
        columns[:] = moved.slopes(after)
        x[:] = after[0]
        whole = np.eye(n + estimated)
        whole[:n, :n], whole[:n, n:] = columns[:, estimated : estimated + n], columns[:, :estimated]
        joint = whole @ covariance @ whole.T + np.diag(process_noise)
        covariance[:] = 0.5 * (joint + joint.T)

    def _numbers(self, values: FloatArray) -> FloatArray:
        if not np.isfinite(values).all():
            raise FmuError(f"{self._runner.title}: the FMU has no finite values at these parameters")
        return values

    def _started(self) -> str:
        """The FMU's interface type; the first call starts its process."""
        if not self._runner.kind:
            self._runner.start()
        return self._runner.kind

    def _ticks(
        self, vector: FloatArray, x: FloatArray, u: float, d: FloatArray, period: float, steps: int
    ) -> tuple[FloatArray, FloatArray]:
        return self._runner.ticks(np.append(vector, x)[None], np.array([u]), d[None], period, steps)

    def _movements(
        self, vector: FloatArray, states: FloatArray, u: FloatArray, disturbances: FloatArray,
        period: float, steps: int,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Derivatives of each tick by state (N, nx, nx) and drive (N, nx), and of its output by state."""
        m, n, size = vector.size, states.shape[1], states.shape[0]
        self._numbers(states)
        all_moved = [
            self._differences.around(np.append(vector, x), at, range(m, m + n), drive_too=True)
            for x, at in zip(states, u.tolist(), strict=True)
        ]
        each = len(all_moved[0].drive) if all_moved else 0
        y, after = self._runner.ticks(
            np.concatenate([moved.fixed for moved in all_moved]),
            np.concatenate([moved.drive for moved in all_moved]),
            np.repeat(disturbances, each, axis=0),
            period,
            steps,
        )
        by_state, by_drive, seen = np.empty((size, n, n)), np.empty((size, n)), np.empty((size, n))
        for k, moved in enumerate(all_moved):
            part = slice(k * each, (k + 1) * each)
            slopes = moved.slopes(after[part])
            by_state[k], by_drive[k] = slopes[:, :n], slopes[:, n]
            seen[k] = moved.slopes(y[part][:, None])[0, :n]
        return by_state, by_drive, seen

    def _fastest(self, vector: FloatArray, corners: FloatArray, drives: FloatArray, d: FloatArray) -> float:
        """Upper bound of the eigenvalues of df/dx: least of three norms, at the worst corner and drive."""
        m, n = vector.size, corners.shape[1]
        everywhere = [
            self._differences.around(np.append(vector, x), float(u), range(m, m + n))
            for x in corners
            for u in drives
        ]
        each = len(everywhere[0].drive)
        fixed, drive = (
            np.concatenate([getattr(one, name) for one in everywhere]) for name in ("fixed", "drive")
        )
        _, rates = self._runner.rates(fixed, drive, np.tile(d, (len(drive), 1)))
        worst = 0.0
        for k, moved in enumerate(everywhere):
            size = np.abs(moved.slopes(rates[k * each : (k + 1) * each]))
            norms = (
                size.sum(axis=1).max(initial=0.0),
                size.sum(axis=0).max(initial=0.0),
                np.linalg.norm(size),
            )
            worst = max(worst, float(min(norms)))
        return worst
