"""The compiled arithmetic of a bank: filters of one plant that differ in how far they trust its equations,
and the traces that changes would have left in each of them.

A belief holds, in this order: the plant's states, its free parameters, of every drive the excess of its
effect and something that acts like more of it, of every output a lasting and a passing offset of the reading,
and a push that fades.

A change is a jump or a ramp of one of these numbers. To first order the filter then errs by the size of the
change times a trace, which is carried along as the error of the filter is (Willsky and Jones 1976). So a
hypothesis is a vector, a mean and a variance of its size; none of them runs a filter of its own.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 (kernels take arrays in a row, and a sample is one course)

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics.filters import _carry, _expected, _move, _use
from twinmatch.dynamics.kernels import N_UNKNOWN, OUTPUT_SLOPES, OUTPUTS, Code, call, work_for
from twinmatch.signals import FloatArray

WIDE, WIDENED = 0.03, 4.0
"""Share of readings with a wide noise, and by what factor it is wider."""
JUNK = 1e-4
"""Share of readings that say nothing: anything within the span."""
_ROOT, _PEAK = math.sqrt(2.0), 1.0 / math.sqrt(2.0 * math.pi)


class Fixed(NamedTuple):
    """What stays the same; a belief has N numbers, of which p are parameters."""

    vector: FloatArray
    """Initial values of all parameters of the plant."""
    places: Any
    """Indices of the free ones among them, integers, shape (p,)."""
    which: Any
    """Indices of their tangents, integers, shape (p,)."""
    logged: Any
    """Whether a parameter is the logarithm of its ratio to the initial value, shape (p,)."""
    least: FloatArray
    most: FloatArray
    """Limits of each parameter, in that form, shape (p,)."""
    keeps: FloatArray
    """Factor per period on each number, shape (N,)."""
    drift: FloatArray
    """Variance that a sample adds to each number at a model error of one, shape (N,)."""
    swift: float
    """Error of a movement of the output, as a share of it, at a model error of one."""
    rest: FloatArray
    """Rest values of the m drives."""
    spans: FloatArray
    """Widths of the o outputs' spans."""
    period: float
    steps: int


class Readings(NamedTuple):
    """One sample, of every output, shape (o,)."""

    y: FloatArray
    seen: Any
    repeated: Any
    """Whether it is the one before."""
    noise: FloatArray
    step: FloatArray
    """Of its last digit."""
    pauses: FloatArray
    """Probability that a healthy sensor repeats its reading, whatever the plant does."""
    inputs: FloatArray
    """Those that act, for each way in which they may act, shape (ways, m)."""
    disturbances: FloatArray


class Members(NamedTuple):
    """B filters."""

    at: FloatArray
    """Means, shape (B, N)."""
    covariance: FloatArray
    """Shape (B, N, N)."""
    error: FloatArray
    """Model error that each assumes."""
    way: Any
    """In which of the ways its inputs act."""
    alive: Any
    takes: Any
    """Whether it takes readings; the others forecast."""
    gained: FloatArray
    """Log-probability of each reading of the sample, shape (B, o)."""
    expected: FloatArray
    """Readings that it expected, shape (B, o) …"""
    variance: FloatArray
    """… and their variances without noise."""


class Traces(NamedTuple):
    """T hypotheses."""

    of: Any
    """The member in which it is a trace; −1: not in use."""
    row: Any
    """Its row in the table of changes."""
    born: Any
    """Sample before which it began."""
    trace: FloatArray
    """Error of the member's mean for a change of one, shape (T, N)."""
    mean: FloatArray
    variance: FloatArray
    """Of the size of the change."""
    now: FloatArray
    """Log-probability of the readings of this sample."""
    score: FloatArray
    """Evidence since it began, nats that count."""
    mass: FloatArray
    """Prior probability of the onsets that it stands for."""
    weight: FloatArray
    """Logarithm of the weight of its member when it began."""


class Rows(NamedTuple):
    """R ways in which something may change."""

    number: Any
    """Index of the number that changes."""
    rate: FloatArray
    """By how much a ramp rises in a sample; 0: it jumps."""
    wanders: FloatArray
    """Variance that a sample adds to the size, as a share of its square."""
    diffusion: FloatArray
    """The same in its unit …"""
    lasting: Any
    """… for so many samples."""


class Onsets(NamedTuple):
    """What opens each of the R rows."""

    shift: FloatArray
    spread: FloatArray
    mass: FloatArray
    """Prior probability of each onset."""
    whole: Any
    """Whether the number is −1 afterwards, whatever it was."""


@compiled(inside=True)
def _cell(off: float, spread: float, step: float) -> tuple[float, float, float]:
    """Probability that a normal value rounds to a reading that is `off` from its mean; by how much the mean
    moves, in spreads, if it does, and how much of the variance goes."""
    low, high = (off - 0.5 * step) / spread, (off + 0.5 * step) / spread
    if step < 0.5 * spread or abs(off) > 6.0 * spread + step:
        away = off / spread
        return _PEAK * math.exp(-0.5 * away * away) * step / spread, away, 1.0
    inside = 0.5 * (math.erf(high / _ROOT) - math.erf(low / _ROOT))
    if inside < 1e-9:
        return 0.0, off / spread, 1.0
    at_low, at_high = _PEAK * math.exp(-0.5 * low * low), _PEAK * math.exp(-0.5 * high * high)
    moved = (at_low - at_high) / inside
    return inside, moved, moved * moved + (high * at_high - low * at_low) / inside


@compiled(inside=True)
def _read(
    off: float, expected: float, noise: float, step: float, span: float, pauses: float, repeated: bool
) -> tuple[float, float, float]:
    """Log-probability of a reading that is `off` from the one expected with a variance; how far it moves the
    belief and how much of the covariance goes, both per unit of reach."""
    usual, wide = math.sqrt(expected + noise**2), math.sqrt(expected + (WIDENED * noise) ** 2)
    near, moves, goes = _cell(off, usual, step)
    far, moves_far, goes_far = _cell(off, wide, step)
    near *= (1.0 - WIDE) * (1.0 - JUNK) * (1.0 - pauses)
    far *= WIDE * (1.0 - JUNK) * (1.0 - pauses)
    junk = JUNK * min(step / span, 1.0)
    again = pauses * (1.0 - JUNK) if repeated else 0.0
    total = near + far + junk + again
    near, far = near / total, far / total
    moved = near * moves / usual + far * moves_far / wide
    squares = near * (moves / usual) ** 2 + far * (moves_far / wide) ** 2
    gone = near * goes / usual**2 + far * goes_far / wide**2 - (squares - moved * moved)
    return math.log(total), moved, gone


@compiled
def step(
    code: Code, fixed: Fixed, members: Members, traces: Traces, rows: Rows, readings: Readings, now: int
) -> None:
    """Correct all members and traces by a sample, and move them on to the next, in place."""
    o, m, p = readings.y.size, fixed.rest.size, fixed.places.size
    size = members.at.shape[1]
    n = size - p - 2 * m - 3 * o
    share, push, offset, passing, fading = (
        n + p,
        n + p + m,
        n + p + 2 * m,
        n + p + 2 * m + o,
        n + p + 2 * m + 2 * o,
    )
    given, vector = readings.disturbances, fixed.vector.copy()
    work, inputs = work_for(code, vector), np.zeros(m)
    traces.now[:] = 0.0
    slope, reach, noises, new = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    moved, there, by_push, was = np.zeros((n, size)), np.zeros(n), np.zeros((o, n)), np.zeros(o)
    for b in range(members.alive.size):
        if not members.alive[b]:
            continue
        at, covariance = members.at[b], members.covariance[b]
        _use(code, fixed, at, vector, work)  # type: ignore[arg-type]  # it has the names that this reads
        for i in range(o):
            call(code[OUTPUTS], at, inputs, given, work.p, work.b, work.seen)
            call(code[OUTPUT_SLOPES], at, inputs, given, work.p, work.b, work.shown)
            slope[:] = 0.0
            for j in range(n):
                slope[j] = work.shown[i * n + j]
            for j in range(p):
                by = work.shown[o * n + i * code[N_UNKNOWN] + fixed.which[j]]
                slope[n + j] = by * vector[fixed.places[j]] if fixed.logged[j] else by
            slope[offset + i] = slope[passing + i] = 1.0
            expected = max(_expected(covariance, slope, reach), 0.0)
            level = work.seen[i] + at[offset + i] + at[passing + i]
            off = readings.y[i] - level
            members.expected[b, i], members.variance[b, i] = level, expected
            members.gained[b, i] = 0.0
            if not readings.seen[i] or not members.takes[b]:
                continue
            gained, moves, goes = _read(
                off,
                expected,
                readings.noise[i],
                readings.step[i],
                fixed.spans[i],
                readings.pauses[i],
                readings.repeated[i],
            )
            members.gained[b, i] = gained
            keen = moves / off if abs(off) > 1e-9 else goes
            for t in range(traces.of.size):
                if traces.of[t] != b:
                    continue
                trace = traces.trace[t]
                a = 0.0
                for j in range(size):
                    a += slope[j] * trace[j]
                mean, var = traces.mean[t], traces.variance[t]
                found, moves1, goes1 = _read(
                    off - a * mean,
                    expected + a * a * var,
                    readings.noise[i],
                    readings.step[i],
                    fixed.spans[i],
                    readings.pauses[i],
                    readings.repeated[i],
                )
                traces.now[t] += found
                traces.mean[t] = mean + var * a * moves1
                traces.variance[t] = max(var - goes1 * (var * a) ** 2, 0.0)
                for j in range(size):
                    trace[j] -= keen * reach[j] * a
            for j in range(size):
                at[j] += moves * reach[j]
                for k in range(size):
                    covariance[j, k] -= goes * (reach[j] * reach[k])
        for j in range(p):
            at[n + j] = min(max(at[n + j], fixed.least[j]), fixed.most[j])
        for j in range(m):
            u = readings.inputs[members.way[b], j]
            inputs[j] = (
                fixed.rest[j]
                + (u - fixed.rest[j]) * (1.0 + min(max(at[share + j], -1.0), 1.0))
                + at[push + j]
            )
        _use(code, fixed, at, vector, work)  # type: ignore[arg-type]  # it has the names that this reads
        call(code[OUTPUTS], at, inputs, given, work.p, work.b, work.seen)
        call(code[OUTPUT_SLOPES], at, inputs, given, work.p, work.b, work.shown)
        for i in range(o):
            was[i], shows = work.seen[i], 0.0
            for j in range(n):
                shows += work.shown[i * n + j] ** 2
            for j in range(n):
                by_push[i, j] = work.shown[i * n + j] / max(shows, 1e-300)
        for j in range(n):
            there[j] = at[j]
        moved[:] = 0.0
        columns = _move(code, there, inputs, given, work, fixed.period, fixed.steps, fixed.which, moved)
        call(code[OUTPUTS], there, inputs, given, work.p, work.b, work.seen)
        error = members.error[b]
        for j in range(size):
            noises[j] = error * error * fixed.drift[j]
        for j in range(n):
            for q in range(p):
                if fixed.logged[q]:
                    moved[j, n + q] *= vector[fixed.places[q]]
            for q in range(m):
                u = readings.inputs[members.way[b], q]
                moved[j, share + q] = columns[j, p + n + q] * (u - fixed.rest[q])
                moved[j, push + q] = columns[j, p + n + q]
            for i in range(o):
                moved[j, fading + i] = by_push[i, j] * fixed.period
                there[j] += moved[j, fading + i] * at[fading + i]
                noises[j] += (error * fixed.swift * (work.seen[i] - was[i]) * by_push[i, j]) ** 2
        for j in range(n):
            at[j] = there[j]
        for j in range(n, size):
            at[j] *= fixed.keeps[j]
        _carry(moved, covariance, fixed.keeps, noises)
        for t in range(traces.of.size):
            if traces.of[t] != b:
                continue
            trace, r = traces.trace[t], traces.row[t]
            for j in range(n):
                new[j] = 0.0
                for k in range(size):
                    new[j] += moved[j, k] * trace[k]
            for j in range(n):
                trace[j] = new[j]
            for j in range(n, size):
                trace[j] *= fixed.keeps[j]
            trace[rows.number[r]] += rows.rate[r]
            traces.variance[t] += rows.wanders[r] * traces.mean[t] ** 2
            if now - traces.born[t] < rows.lasting[r]:
                traces.variance[t] += rows.diffusion[r]
        if not np.isfinite(at.sum() + covariance.sum()):
            members.alive[b] = False


@compiled
def spawn(
    traces: Traces, rows: Rows, onsets: Onsets, at: FloatArray, weights: FloatArray, slots: int, now: int
) -> None:
    """Have every change begin now in each of the first members, whose means are `at`. A row has `slots`
    places in each of them; if all are taken, of the two onsets whose ages are most alike the less likely one
    goes, and its prior goes to the other: ages are geometric, and the price of an onset is paid once
    (Andersson 1985)."""
    levels = weights.size
    for r in range(rows.number.size):
        for b in range(levels):
            begin, place = (r * levels + b) * slots, -1
            for t in range(begin, begin + slots):
                if traces.of[t] < 0:
                    place = t
            if place < 0:
                order, least, keep = np.argsort(traces.born[begin : begin + slots]), np.inf, -1
                for i in range(slots - 1):
                    old, new = begin + order[i], begin + order[i + 1]
                    alike = (traces.born[new] - traces.born[old]) / (now - traces.born[old])
                    if alike < least:
                        behind = (
                            traces.score[old] + traces.weight[old] < traces.score[new] + traces.weight[new]
                        )
                        least, place, keep = alike, old if behind else new, new if behind else old
                traces.mass[keep] += traces.mass[place]
            traces.of[place], traces.row[place], traces.born[place] = b, r, now
            traces.trace[place, :] = 0.0
            traces.trace[place, rows.number[r]] = 1.0 if rows.rate[r] == 0.0 else 0.0
            traces.mean[place] = -1.0 - at[b, rows.number[r]] if onsets.whole[r] else onsets.shift[r]
            traces.variance[place] = onsets.spread[r] ** 2
            traces.now[place], traces.score[place] = 0.0, 0.0
            traces.mass[place], traces.weight[place] = onsets.mass[r], weights[b]
