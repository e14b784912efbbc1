"""The compiled extended Kalman filter over states and, after them, other numbers: `_take` takes one reading,
`_move` and `_carry` move means and covariance on.

`correct` and `predict` use it for an `Observer`, which estimates states and some parameters; `track` for a
`Tracker`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import (
    N_UNKNOWN,
    OUTPUT_SLOPES,
    OUTPUTS,
    Code,
    Work,
    call,
    copy_into,
    prepare,
    tick_with_tangents,
    work_for,
)
from twinmatch.signals import FloatArray

CLIPPED = 3.0
"""Innovations are clipped at so many of their standard deviations."""
SUSPECT = 2.0
"""Innovation, in standard deviations, above which a repeated reading counts as the sensor's fault."""
STALE = 1e6
"""Variance given to a reading that is not used."""


ADAPTS = 0.07
"""Relative change of the process noise per sample and unit of correlation: some 15 samples."""
SURPRISE = 3.0
"""Most that one innovation counts, in standard deviations: jumps of a self-correcting sensor are not the plant's."""
LEAST_NOISE = 1e-3
"""Least factor on the process noise: from there it is back at 1 after 15 samples of largest surprise."""
MAX_NOISE = 1e8
"""Greatest factor."""


SHARE, OFFSET, PASSING, FADING, PUSH, RATE = range(-6, 0)
"""Places in a belief, from its end, of what no plant file declares: share of the drive, permanent and passing
offset of the reading, fading and permanent push, and the rate at which one of the others rises."""
EXTRA = 6
"""How many these are."""


class TrackedParameters(NamedTuple):
    """How m parameters of a plant are tracked."""

    vector: FloatArray
    """Initial values of all parameters of the plant."""
    places: Any
    """Indices of the m parameters among them, integers, shape (m,)."""
    which: Any
    """Indices of their tangents, integers, shape (m,)."""
    logged: Any
    """Whether a parameter is tracked as the logarithm of its ratio to the initial value, shape (m,)."""
    least: FloatArray
    """Lower limit of each parameter, in that form, shape (m,)."""
    most: FloatArray
    """Upper limit, shape (m,)."""


class TrackerConstants(NamedTuple):
    """Constants for a belief of n numbers."""

    free: TrackedParameters
    keeps: FloatArray
    """Factor per period on each number: below 1 for those that fade, 1 for the others, shape (n,)."""
    rest: float
    """Rest value of the drive."""
    period: float
    """Sample time, s."""
    steps: int
    """Runge–Kutta steps per sample."""


class Readings(NamedTuple):
    """Consecutive samples."""

    output: FloatArray
    """Readings, shape (N + 2,): the first two are those before (NaN if there are none)."""
    input: FloatArray
    """Shape (N,)."""
    disturbances: FloatArray
    """Shape (N, m)."""
    noise: FloatArray
    """Standard deviation of each reading, shape (N,); infinite where it was lost."""

    def part(self, begin: int, end: int) -> Readings:
        """Samples from `begin` to before `end`."""
        return Readings(
            self.output[begin : end + 2],
            self.input[begin:end],
            self.disturbances[begin:end],
            self.noise[begin:end],
        )

    @property
    def unseen(self) -> Readings:
        """The same samples, to be forecast: all their readings are lost."""
        return self._replace(noise=np.full_like(self.noise, np.inf))


class Traces(NamedTuple):
    """Traces that jumps at past samples would have left in the innovations since."""

    effects: FloatArray
    """Effects on the current belief, shape (n, kinds, starts)."""
    hits: FloatArray
    """Sums of innovation times effect over variance, shape (kinds, starts)."""
    weights: FloatArray
    """Sums of squared effect over variance, shape (kinds, starts)."""


class Drift(NamedTuple):
    """How a belief strays."""

    each: FloatArray
    """Standard deviations of its numbers' drift, per root of a second, shape (n,)."""
    swift: float
    """Error of a movement of the output, as a share of it."""


class Opening(NamedTuple):
    """What is tested of a belief: numbers that may change from now on."""

    drift: FloatArray
    """Additional drift, per root of a second, in the first samples, shape (n,)."""
    lasting: int
    """Number of those samples."""
    rising: int
    """Index of the number that rises at the believed rate; negative: none."""


@compiled(innermost=True)
def _expected(covariance: FloatArray, slope: FloatArray, reach: FloatArray) -> float:
    """The variance expected of a reading without noise; `reach` gets its covariances."""
    variance = 0.0
    reach[:] = 0.0
    for i in range(slope.size):
        for j in range(slope.size):
            reach[j] += slope[i] * covariance[i, j]
    for i in range(slope.size):
        variance += slope[i] * reach[i]
    return variance


@compiled(innermost=True)
def _take(  # noqa: PLR0917
    covariance: FloatArray,
    slope: FloatArray,
    reach: FloatArray,
    innovation: float,
    variance: float,
    noise: float,
    limit: float,
    at: FloatArray,
    gain: FloatArray,
) -> None:
    """Take a reading of this innovation, whose expected variance contains that of its noise, in place.

    The innovation is clipped at `limit` standard deviations: with a reduced gain the reading is less
    informative, and Joseph's form (I − gain·slopeᵀ)·covariance·(I − gain·slopeᵀ)ᵀ + noise·gain·gainᵀ is
    correct for any gain.
    """
    size = slope.size
    halves = np.empty(slope.size)
    most = limit * math.sqrt(variance)
    weight = (most / abs(innovation) if abs(innovation) > most else 1.0) / variance
    for i in range(size):
        gain[i] = weight * reach[i]
        halves[i] = 0.5 * noise * gain[i]
        at[i] += gain[i] * innovation
    # First (I − gain·slopeᵀ)·covariance, then, half from each side, the rest: exactly symmetric.
    for i in range(size):
        for j in range(size):
            covariance[i, j] -= weight * (reach[i] * reach[j])
            halves[j] -= 0.5 * slope[i] * covariance[i, j]
    for i in range(size):
        for j in range(size):
            covariance[i, j] += gain[i] * halves[j] + gain[j] * halves[i]


@compiled(innermost=True)
def _move(  # noqa: PLR0917
    code: Code,
    x: FloatArray,
    u: FloatArray,
    d: FloatArray,
    work: Work,
    period: float,
    steps: int,
    which: NDArray[np.int64],
    moved: FloatArray,
) -> FloatArray:
    """Move states one period on, in place; returns their derivatives by the m parameters `which`, by the
    states and by the inputs, shape (n, m + n + inputs); `moved` gets those by states, then parameters."""
    n = x.size
    m = which.size
    inputs = u.size
    columns = np.zeros((n, m + n + inputs))
    du = np.zeros((inputs, m + n + inputs))
    for i in range(n):
        columns[i, m + i] = 1.0
    for i in range(inputs):
        du[i, m + n + i] = 1.0
    tick_with_tangents(code, x, u, d, work, period, steps, which, columns, du)
    for i in range(n):
        for j in range(n + m):
            moved[i, j] = columns[i, m + j if j < n else j - n]
    return columns


@compiled(innermost=True)
def _carry(
    moved: FloatArray, covariance: FloatArray, keeps: FloatArray, noise: FloatArray
) -> None:
    """Predict a covariance, in place: `moved` are the rows of the states, shape (n, size), the other numbers
    fade by `keeps`, and `noise` adds to the diagonal."""
    n, size = moved.shape
    wide = np.zeros((n, size))
    for i in range(n):
        for q in range(size):
            for j in range(size):
                wide[i, j] += moved[i, q] * covariance[q, j]
    for i in range(n, size):
        for j in range(n, size):
            covariance[i, j] *= keeps[i] * keeps[j]
        covariance[i, i] += noise[i]
    for i in range(n):
        for j in range(n, size):
            covariance[i, j] = covariance[j, i] = wide[i, j] * keeps[j]
        for j in range(i + 1):
            total = noise[i] if i == j else 0.0
            for q in range(size):
                total += wide[i, q] * moved[j, q]
            covariance[i, j] = covariance[j, i] = total


@compiled
def correct(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    x: FloatArray,
    covariance: FloatArray,
    y: FloatArray,
    d: FloatArray,
    u: FloatArray,
    noise: FloatArray,
    limit: float,
    which: NDArray[np.int64],
    bounds: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Correct by readings, shape (o,), under the inputs u, in place; return the innovation of each, given
    those before it, and its expected variance. `noise` are their standard deviations.

    `which`, shape (2, m), holds the indices of the estimated parameters among those with tangents and among
    all; `bounds`, shape (2, m), limits them. Innovations are clipped at `limit` standard deviations.
    """
    size = covariance.shape[0]
    n = x.size
    q = code[N_UNKNOWN]
    outputs = y.size
    slope = np.zeros(size)
    reach = np.zeros(size)
    gain = np.zeros(size)
    moved = np.zeros(size)
    innovations = np.zeros(outputs)
    variances = np.zeros(outputs)
    work = work_for(code, vector)
    call(code[OUTPUTS], x, u, d, work.p, work.b, work.outputs)
    call(code[OUTPUT_SLOPES], x, u, d, work.p, work.b, work.output_slopes)
    for o in range(outputs):
        innovation = y[o] - work.outputs[o]
        for i in range(size):
            place = o * n + i if i < n else outputs * n + o * q + which[0, i - n]
            slope[i] = work.output_slopes[place]
            innovation -= slope[i] * moved[i]
        noise_variance = noise[o] * noise[o]
        variance = _expected(covariance, slope, reach) + noise_variance
        _take(
            covariance,
            slope,
            reach,
            innovation,
            variance,
            noise_variance,
            limit,
            moved,
            gain,
        )
        innovations[o] = innovation
        variances[o] = variance
    for i in range(n):
        x[i] += moved[i]
    for j in range(size - n):
        after = vector[which[1, j]] + moved[n + j]
        vector[which[1, j]] = min(max(after, bounds[0, j]), bounds[1, j])
    return innovations, variances


@compiled
def predict(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    x: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray,
    u: FloatArray,
    d: FloatArray,
    period: float,
    steps: int,
    which: NDArray[np.int64],
) -> FloatArray:
    """Predict states and joint covariance one period ahead; `process_noise`, shape (n + m,), adds to its
    diagonal. Returns the derivatives of the states by the m parameters which[0], by the states and by the
    inputs, shape (n, m + n + inputs)."""
    moved = np.empty((x.size, covariance.shape[0]))
    columns = _move(
        code, x, u, d, work_for(code, vector), period, steps, which[0], moved
    )
    _carry(moved, covariance, np.ones(covariance.shape[0]), process_noise)
    return columns


@compiled
def adapt(
    process_noise: FloatArray,
    adaptation: FloatArray,
    innovations: FloatArray,
    variances: FloatArray,
) -> None:
    """Adapt the process noise, in place, to the innovations of a sample of o outputs.

    `adaptation`, shape (1 + o,), begins with the factor by which the process noise exceeds the one given; the
    others are the innovations of the sample before, in standard deviations. Empty: nothing adapts.
    """
    if not adaptation.size:
        return
    outputs = innovations.size
    correlation = 0.0
    for o in range(outputs):
        deviation = innovations[o] / math.sqrt(variances[o])
        deviation = min(max(deviation, -SURPRISE), SURPRISE)
        correlation += deviation * adaptation[1 + o] / outputs
        adaptation[1 + o] = deviation
    factor = adaptation[0] * math.exp(ADAPTS * correlation)
    factor = min(max(factor, LEAST_NOISE), MAX_NOISE)
    for i in range(process_noise.size):
        process_noise[i] *= factor / adaptation[0]
    adaptation[0] = factor


@compiled
def follow(  # noqa: PLR0917
    codes: NDArray[np.int64],
    sizes: NDArray[np.int64],
    vectors: FloatArray,
    x: FloatArray,
    covariances: FloatArray,
    process_noise: FloatArray,
    adaptations: FloatArray,
    rows: FloatArray,
    steps: NDArray[np.int64],
    u: FloatArray,
    now: FloatArray,
    seen: NDArray[np.bool_],
    y: FloatArray,
    d: FloatArray,
    period: float,
    noise: FloatArray,
    limit: float,
) -> NDArray[np.int64]:
    """For each of N samples: `predict` under the inputs u, shape (N, m), and the disturbances `rows` of the
    sample before, then, if this one was `seen`, `correct` under its own inputs `now`, shape (N, m); for
    several plants in place, one row of each array per plant. Returns how many samples each took, shape (C,),
    up to one without finite results.

    `sizes`, shape (C, 2), are the numbers of states and parameters.
    """
    counts = np.zeros(len(sizes), dtype=np.int64)
    none = np.zeros((2, 0), dtype=np.int64)
    unbounded = np.zeros((2, 0))
    for i in range(len(sizes)):
        n, m = sizes[i]
        code = codes[i]
        vector = vectors[i, :m]
        states = x[i, :n]
        row = rows[i]
        covariance = covariances[i, : n * n].reshape((n, n))
        for k in range(len(u)):
            predict(
                code,
                vector,
                states,
                covariance,
                process_noise[i, :n],
                u[k],
                row,
                period,
                steps[i],
                none,
            )
            if seen[k]:
                copy_into(d[k], row)
                innovations, variances = correct(
                    code,
                    vector,
                    states,
                    covariance,
                    y[k],
                    row,
                    now[k],
                    noise,
                    limit,
                    none,
                    unbounded,
                )
                total = 0.0
                for o in range(innovations.size):
                    total += innovations[o] + variances[o]
                if not np.isfinite(total):
                    break
                adapt(process_noise[i, :n], adaptations[i], innovations, variances)
            counts[i] += 1
    return counts


@compiled(inside=True)
def _use(
    code: Code, free: TrackedParameters, at: FloatArray, vector: FloatArray, work: Work
) -> None:
    """Write the parameters of a belief into `vector`, and use them."""
    n = work.after.size - 1
    for j in range(free.places.size):
        q = at[n + j]
        start = free.vector[free.places[j]]
        vector[free.places[j]] = start * math.exp(q) if free.logged[j] else start + q
    prepare(code, vector, work)


@compiled
def track(  # noqa: PLR0917
    code: Code,
    fixed: TrackerConstants,
    at: FloatArray,
    covariance: FloatArray,
    drift: Drift,
    readings: Readings,
    opening: Opening,
    traces: Traces,
    cost: float,
) -> float:
    """Track some samples; belief and traces change in place. Return the code length, in nats, of these
    readings and of those before, which is `cost`; not finite if the equations had no solution on the way.

    `at`, shape (n,), are the means of the belief: states, parameters, and the places SHARE to RATE;
    `covariance`, shape (n, n), is theirs.
    """
    # One function for its length: the steps of an extended Kalman filter on one set of arrays, which are made
    # once for all samples.
    free = fixed.free
    m = free.places.size
    size = at.size
    n = size - m - EXTRA
    share = size + SHARE
    offset = size + OFFSET
    passing = size + PASSING
    rate = size + RATE
    y = readings.output
    u = readings.input
    opened = opening.drift
    rising = opening.rising
    vector = free.vector.copy()
    inputs = np.empty(1)
    work = work_for(code, vector)
    slope = np.zeros(size)
    reach = np.zeros(size)
    gain = np.zeros(size)
    noises = np.zeros(size)
    moved = np.zeros((n, size))
    next_states = np.zeros(n)
    next_effects = np.zeros((n, traces.effects.shape[2]))
    output_slopes = work.output_slopes
    slope[offset] = slope[passing] = 1.0
    _use(code, free, at, vector, work)
    for k in range(u.size):
        d = readings.disturbances[k]
        inputs[0] = fixed.rest + (u[k] - fixed.rest) * (1.0 + at[share])
        call(code[OUTPUTS], at, inputs, d, work.p, work.b, work.outputs)
        call(code[OUTPUT_SLOPES], at, inputs, d, work.p, work.b, output_slopes)
        for i in range(n):
            slope[i] = work.output_slopes[i]
        for j in range(m):
            derivative = work.output_slopes[n + free.which[j]]
            slope[n + j] = (
                derivative * vector[free.places[j]] if free.logged[j] else derivative
            )
        slope[share] = work.output_slopes[n + code[N_UNKNOWN]] * (u[k] - fixed.rest)
        innovation = y[k + 2] - work.outputs[0] - at[offset] - at[passing]
        expected = _expected(covariance, slope, reach)
        variance, noise_variance = _weigh(
            y, k, innovation, expected, readings.noise[k], passing, covariance, reach
        )
        if noise_variance < STALE:
            cost += 0.5 * math.log(variance) + 0.5 * innovation**2 / variance
        _take(
            covariance,
            slope,
            reach,
            innovation,
            variance,
            noise_variance,
            math.inf,
            at,
            gain,
        )
        _correct_effects(slope, gain, innovation, variance, traces)
        for j in range(m):
            at[n + j] = min(max(at[n + j], free.least[j]), free.most[j])
        at[share] = min(max(at[share], -1.0), 1.0)
        _use(code, free, at, vector, work)
        way = _move_belief(code, fixed, at, vector, work, u[k], d, moved, next_states)
        for i in range(size):
            noises[i] = drift.each[i] ** 2 * fixed.period
            if k < opening.lasting:
                noises[i] += opened[i] ** 2 * fixed.period
            if i < n:
                noises[i] += (
                    drift.swift * way * moved[i, size + FADING] / fixed.period
                ) ** 2
        _carry(moved, covariance, fixed.keeps, noises)
        if rising >= 0:
            at[rising] += at[rate] * fixed.period
            for i in range(size):
                covariance[rising, i] += covariance[rate, i] * fixed.period
            for i in range(size):
                covariance[i, rising] += covariance[i, rate] * fixed.period
            _use(code, free, at, vector, work)
        _carry_effects(moved, next_effects, traces.effects, fixed.keeps)
    return cost if _is_finite(at, covariance) else math.nan


@compiled(innermost=True)
def _is_finite(at: FloatArray, covariance: FloatArray) -> bool:
    """Whether all numbers of a belief are finite."""
    total = 0.0
    for i in range(at.size):
        total += at[i]
        for j in range(at.size):
            total += covariance[i, j]
    return math.isfinite(total)


@compiled(innermost=True)
def _weigh(  # noqa: PLR0917
    y: FloatArray,
    k: int,
    innovation: float,
    expected: float,
    noise: float,
    passing: int,
    covariance: FloatArray,
    reach: FloatArray,
) -> tuple[float, float]:
    """The variance with which a reading counts, and its own in it: `STALE` if it was lost, or is repeated by
    its sensor. One that has just stopped to repeat opens the passing offset."""
    noise_variance = STALE if math.isinf(noise) else noise**2
    if noise_variance < STALE and innovation**2 > SUSPECT**2 * (
        expected + noise_variance
    ):
        if y[k + 2] == y[k + 1]:
            noise_variance = STALE
        elif y[k + 1] == y[k]:
            covariance[passing, passing] += innovation**2
            reach[passing] += innovation**2
            expected += innovation**2
    if noise_variance < STALE:
        noise_variance = max(noise_variance, (innovation / CLIPPED) ** 2 - expected)
    return expected + noise_variance, noise_variance


@compiled(innermost=True)
def _move_belief(  # noqa: PLR0917
    code: Code,
    fixed: TrackerConstants,
    at: FloatArray,
    vector: FloatArray,
    work: Work,
    u: float,
    d: FloatArray,
    moved: FloatArray,
    there: FloatArray,
) -> float:
    """Move a belief one period on; returns how far the equations move the output. `moved` gets the
    derivatives of the states by all of its numbers. A push moves them as far as the output shows them."""
    free = fixed.free
    n = there.size
    m = fixed.free.places.size
    share = at.size + SHARE
    fading = at.size + FADING
    push = at.size + PUSH
    inputs = np.empty(1)
    shows = 0.0
    for i in range(n):
        there[i] = at[i]
        shows += work.output_slopes[i] * work.output_slopes[i]
    inputs[0] = fixed.rest + (u - fixed.rest) * (1.0 + at[share])
    call(code[OUTPUTS], at, inputs, d, work.p, work.b, work.outputs)
    before = work.outputs[0]
    columns = _move(
        code, there, inputs, d, work, fixed.period, fixed.steps, free.which, moved
    )
    call(code[OUTPUTS], there, inputs, d, work.p, work.b, work.outputs)
    for i in range(n):
        for j in range(m):
            if free.logged[j]:
                moved[i, n + j] *= vector[free.places[j]]
        moved[i, share] = columns[i, m + n] * (u - fixed.rest)
        by_push = work.output_slopes[i] / shows * fixed.period
        moved[i, fading] = moved[i, push] = by_push
        at[i] = there[i] + by_push * (at[fading] + at[push])
    for i in range(n, at.size):
        at[i] *= fixed.keeps[i]
    return float(work.outputs[0] - before)


@compiled(inside=True)
def _correct_effects(
    slope: FloatArray,
    gain: FloatArray,
    innovation: float,
    variance: float,
    traces: Traces,
) -> None:
    """Correct the effects of jumps as the belief is, and add what they leave in this innovation."""
    effects, hits, weights = traces
    kinds, starts = hits.shape
    shown = np.empty(starts)
    for kind in range(kinds):
        # The starts are next to each other in memory: as the innermost loop they fill the vector unit.
        for start in range(starts):
            shown[start] = 0.0
        for i in range(slope.size):
            for start in range(starts):
                shown[start] += slope[i] * effects[i, kind, start]
        for start in range(starts):
            hits[kind, start] += shown[start] * innovation / variance
            weights[kind, start] += shown[start] * shown[start] / variance
        for i in range(slope.size):
            for start in range(starts):
                effects[i, kind, start] -= gain[i] * shown[start]


@compiled(inside=True)
def _carry_effects(
    moved: FloatArray, there: FloatArray, effects: FloatArray, keeps: FloatArray
) -> None:
    """Predict the effects of jumps one period ahead; `there`, shape (n, starts), gets those on the states."""
    n, size = moved.shape
    _, kinds, starts = effects.shape
    for kind in range(kinds):
        for i in range(n):
            for start in range(starts):
                there[i, start] = 0.0
            for q in range(size):
                for start in range(starts):
                    there[i, start] += moved[i, q] * effects[q, kind, start]
        for i in range(n):
            for start in range(starts):
                effects[i, kind, start] = there[i, start]
        for i in range(n, size):
            for start in range(starts):
                effects[i, kind, start] *= keeps[i]
