"""The compiled arithmetic of a bank: filters of one plant that differ in how far they trust its equations,
and the traces that changes would have left in each of them.

A belief holds, in this order: the plant's states, its free parameters, of every drive the excess of its
effect and something that acts like more of it, of every output a lasting and a passing offset of the reading,
and a push that fades.

A change is a jump or a ramp of one of these numbers. To first order the filter then errs by the size of the
change times a trace, which is carried along as the error of the filter is (Willsky and Jones 1976). So a
hypothesis is a vector, a mean and a variance of its size; none of them runs a filter of its own. A parameter that
changes by a share of what it was also changes how the plant settles after an error: a plant that loses three times
as much settles in a third of the time. That part of the second order is in its trace, with the size believed so far.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics.filters import TrackedParameters, _carry, _expected, _move, _use
from twinmatch.dynamics.kernels import (
    N_UNKNOWN,
    OUTPUT_SLOPES,
    OUTPUTS,
    Code,
    Work,
    call,
    work_for,
)
from twinmatch.signals import FloatArray

WIDE = 0.03
WIDENED = 4.0
"""Share of readings with a wide noise, and by what factor it is wider."""
JUNK = 1e-4
"""Share of readings that say nothing: anything within the span."""
_SHOWS = 1e-8
"""Share of the expected variance below which a change does not show in a reading."""
_HOPELESS = -8.0
"""Evidence at which an onset is dropped, nats."""
LEAST_SHARE = -0.95
"""Least change of a parameter as a share of what it was: it keeps its sign."""
_ROOT = math.sqrt(2.0)
_PEAK = 1.0 / math.sqrt(2.0 * math.pi)


class BankConstants(NamedTuple):
    """What stays the same; a belief has N numbers."""

    free: TrackedParameters
    """Of the p parameters."""
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


class Reading(NamedTuple):
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
    crossing: FloatArray
    """Those that arrive at the places of the other drives, shape (m,)."""
    disturbances: FloatArray


class BankMembers(NamedTuple):
    """B filters; the first of them, as many as there are levels of model error, have traces."""

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


class ChangeTraces(NamedTuple):
    """Onsets of R rows in L levels, S slots for each, in the order level, row, slot: shape (L·R·S,)."""

    born: Any
    """Sample before which it began; −1: not in use."""
    trace: FloatArray
    """Error of the member's mean for a change of one, shape (L·R·S, N)."""
    mean: FloatArray
    variance: FloatArray
    """Of the size of the change as it is now."""
    lasting_mean: FloatArray
    lasting_variance: FloatArray
    """Of the size that it wanders about."""
    covariance: FloatArray
    """Of the two sizes."""
    now: FloatArray
    """Log-probability of the readings of this sample."""
    score: FloatArray
    """Evidence since it began, nats that count."""
    mass: FloatArray
    """Prior probability of the onsets that it stands for."""
    weight: FloatArray
    """Logarithm of the weight of its level when it began."""
    usual: FloatArray
    """What the inputs that its number follows amounted to when it began."""
    way: FloatArray
    """By how much its number changes, for a size of one."""
    bends: FloatArray
    """By how much, as a share of what it was, the parameter changes by which the plant settles, for a size of one."""


def unborn(count: int, size: int) -> ChangeTraces:
    """Room for so many onsets, of filters of so many numbers."""
    born = np.full(count, -1, dtype=np.int64)
    trace = np.zeros((count, size))
    return ChangeTraces(born, trace, *(np.zeros(count) for _ in range(12)))


class ChangeRows(NamedTuple):
    """R ways in which something may change."""

    number: Any
    """Index of the number that changes."""
    also: Any
    """Indices of other numbers that change by the same, shape (R, a); −1: there is none."""
    cause: Any
    """Index of what is reported."""
    rate: FloatArray
    """By how much a ramp rises in a sample; 0: it jumps."""
    wanders: FloatArray
    """Variance that a sample adds to the size, as a share of the square of the size that it wanders about."""
    returns: float
    """Share of its distance from that size that a sample leaves."""
    diffusion: FloatArray
    """The same in its unit …"""
    lasting: Any
    """… for so many samples."""
    shift: FloatArray
    """Expected size …"""
    spread: FloatArray
    """… and its standard deviation."""
    mass: FloatArray
    """Prior probability of each onset."""
    whole: Any
    """Whether the number is −1 afterwards, whatever it was."""
    crosses: Any
    """Whether the number follows inputs in proportion, instead of staying as it has changed."""
    follows: FloatArray
    """By how much it follows each of the m inputs, shape (R, m)."""
    relative: Any
    """The first row of the same parameter, if the size is a share of what that was; −1: it is not."""


@compiled(inside=True)
def _cell(off: float, spread: float, step: float) -> tuple[float, float, float]:
    """Probability that a normal value rounds to a reading that is `off` from its mean; by how much the mean
    moves, in spreads, if it does, and how much of the variance goes."""
    if step < 0.5 * spread or abs(off) > 6.0 * spread + step:
        away = off / spread
        return _PEAK * math.exp(-0.5 * away * away) * step / spread, away, 1.0
    low = (off - 0.5 * step) / spread
    high = (off + 0.5 * step) / spread
    inside = 0.5 * (math.erf(high / _ROOT) - math.erf(low / _ROOT))
    if inside < 1e-9:
        return 0.0, off / spread, 1.0
    at_low = _PEAK * math.exp(-0.5 * low * low)
    at_high = _PEAK * math.exp(-0.5 * high * high)
    moved = (at_low - at_high) / inside
    return inside, moved, moved * moved + (high * at_high - low * at_low) / inside


@compiled(inside=True)
def _read(
    fixed: BankConstants, r: Reading, i: int, off: float, expected: float
) -> tuple[float, float, float]:
    """Log-probability of the reading of output i that is `off` from the one expected with a variance; how far
    it moves the belief and how much of the covariance goes, both per unit of reach."""
    noise = r.noise[i]
    step = r.step[i]
    usual = math.sqrt(expected + noise * noise)
    wide = math.sqrt(expected + (WIDENED * noise) ** 2)
    near, moves, goes = _cell(off, usual, step)
    far, moves_far, goes_far = _cell(off, wide, step)
    sound = (1.0 - JUNK) * (1.0 - r.pauses[i])
    near *= (1.0 - WIDE) * sound
    far *= WIDE * sound
    total = near + far + JUNK * min(step / fixed.spans[i], 1.0)
    if r.repeated[i]:
        total += r.pauses[i] * (1.0 - JUNK)
    near = near / total
    far = far / total
    moves = moves / usual
    moves_far = moves_far / wide
    moved = near * moves + far * moves_far
    squares = near * moves * moves + far * moves_far * moves_far
    gone = (
        near * goes / (usual * usual)
        + far * goes_far / (wide * wide)
        - (squares - moved * moved)
    )
    return math.log(total), moved, gone


@compiled(inside=True)
def _correct_traces(  # noqa: PLR0917
    fixed: BankConstants,
    traces: ChangeTraces,
    begin: int,
    end: int,
    r: Reading,
    i: int,
    slope: FloatArray,
    lost: FloatArray,
    off: float,
    expected: float,
    usual: float,
) -> None:
    """Correct the traces of a member as its mean is, by `lost` times what of them shows in output i, and
    learn the sizes of the changes; `usual` is the log-probability without any."""
    least = _SHOWS * (expected + r.noise[i] * r.noise[i])
    for t in range(begin, end):
        if traces.born[t] < 0:
            continue
        trace = traces.trace[t]
        a = 0.0
        for j in range(slope.size):
            a += slope[j] * trace[j]
        mean = traces.mean[t]
        variance = traces.variance[t]
        if a * a * (mean * mean + variance) < least:
            traces.now[t] += usual
            continue
        shift, moves, goes = _read(
            fixed, r, i, off - a * mean, expected + a * a * variance
        )
        traces.now[t] += shift
        shared = traces.covariance[t]
        traces.mean[t] = mean + variance * a * moves
        traces.lasting_mean[t] += shared * a * moves
        traces.variance[t] = max(variance - goes * (variance * a) ** 2, 0.0)
        traces.covariance[t] = shared - goes * variance * shared * a * a
        traces.lasting_variance[t] = max(
            traces.lasting_variance[t] - goes * (shared * a) ** 2, 0.0
        )
        for j in range(slope.size):
            trace[j] -= lost[j] * a


@compiled(inside=True)
def _followed(rows: ChangeRows, r: int, u: FloatArray) -> float:
    """What the inputs u, shape (m,), that the number of row r follows amount to."""
    total = 0.0
    for k in range(u.size):
        total += rows.follows[r, k] * u[k]
    return total


@compiled(inside=True)
def _acting(fixed: BankConstants, at: FloatArray, u: FloatArray) -> FloatArray:
    """The inputs u, shape (m,), as they act in a belief."""
    m = u.size
    share = at.size - 3 * fixed.spans.size - 2 * m
    push = share + m
    inputs = np.empty(m)
    for q in range(m):
        gain = 1.0 + min(max(at[share + q], -1.0), 1.0)
        inputs[q] = fixed.rest[q] + (u[q] - fixed.rest[q]) * gain + at[push + q]
    return inputs


@compiled(inside=True)
def _move_changed(  # noqa: PLR0917
    code: Code,
    fixed: BankConstants,
    traces: ChangeTraces,
    rows: ChangeRows,
    begin: int,
    slots: int,
    at: FloatArray,
    vector: FloatArray,
    work: Work,
    u: FloatArray,
    d: FloatArray,
    changed: FloatArray,
) -> None:
    """For each row whose size is a share, the derivatives of the next states by the present ones in a belief
    whose parameter is twice what it is, into `changed`, shape (R, n, n); only if the member, whose traces start
    at `begin`, has one of it."""
    n = work.after.size - 1
    p = fixed.free.places.size
    moved = np.zeros((n, n + p))
    for r in range(rows.number.size):
        if rows.relative[r] != r:
            continue
        is_followed = False
        for other in range(r, rows.number.size):
            if rows.relative[other] == r:
                for t in range(begin + other * slots, begin + (other + 1) * slots):
                    is_followed = is_followed or traces.born[t] >= 0
        if not is_followed:
            continue
        doubled = at.copy()
        doubled[rows.number[r]] += math.log(2.0)
        inputs = _acting(fixed, at, u)
        states = at[:n].copy()
        _use(code, fixed.free, doubled, vector, work)
        _move(
            code,
            states,
            inputs,
            d,
            work,
            fixed.period,
            fixed.steps,
            fixed.free.which,
            moved,
        )
        for j in range(n):
            for k in range(n):
                changed[r, j, k] = moved[j, k]


@compiled(inside=True)
def _bend(
    changed: FloatArray,
    moved: FloatArray,
    shift: float,
    trace: FloatArray,
    new: FloatArray,
) -> None:
    """Add to the states of a trace after a period what comes of a parameter that has changed by `shift`, as a
    share."""
    n = new.size
    for j in range(n):
        for k in range(n):
            new[j] += shift * (changed[j, k] - moved[j, k]) * trace[k]


@compiled(inside=True)
def _wander(traces: ChangeTraces, rows: ChangeRows, r: int, t: int) -> None:
    """Move the size of a change of row r on to the next sample: it wanders about the size that lasts, and
    returns to it."""
    stays = rows.returns
    comes = 1.0 - stays
    lasting = traces.lasting_mean[t]
    lasting_variance = traces.lasting_variance[t]
    covariance = traces.covariance[t]
    traces.mean[t] = stays * traces.mean[t] + comes * lasting
    traces.variance[t] = (
        stays * stays * traces.variance[t]
        + 2.0 * stays * comes * covariance
        + comes * comes * lasting_variance
        + rows.wanders[r] * lasting**2
    )
    traces.covariance[t] = stays * covariance + comes * lasting_variance


@compiled(inside=True)
def _carry_traces(  # noqa: PLR0917
    fixed: BankConstants,
    traces: ChangeTraces,
    rows: ChangeRows,
    begin: int,
    end: int,
    slots: int,
    moved: FloatArray,
    changed: FloatArray,
    crossing: FloatArray,
    now: int,
) -> None:
    """Move the traces of a member on to the next sample; `changed` as from `_move_changed`."""
    n, size = moved.shape
    new = np.empty(n)
    for t in range(begin, end):
        if traces.born[t] < 0:
            continue
        trace = traces.trace[t]
        r = (t - begin) // slots
        if rows.crosses[r]:
            trace[rows.number[r]] = _followed(rows, r, crossing) - traces.usual[t]
        for j in range(n):
            new[j] = 0.0
            for k in range(size):
                new[j] += moved[j, k] * trace[k]
        if rows.relative[r] >= 0:
            shift = max(traces.mean[t] * traces.bends[t], LEAST_SHARE)
            _bend(changed[rows.relative[r]], moved, shift, trace, new)
        for j in range(n):
            trace[j] = new[j]
        for j in range(n, size):
            trace[j] *= fixed.keeps[j]
        trace[rows.number[r]] += rows.rate[r]
        for a in range(rows.also.shape[1]):
            if rows.also[r, a] >= 0:
                trace[rows.also[r, a]] += rows.rate[r]
        _wander(traces, rows, r, t)
        if now - traces.born[t] < rows.lasting[r]:
            traces.variance[t] += rows.diffusion[r]
            traces.lasting_variance[t] += rows.diffusion[r]
            traces.covariance[t] += rows.diffusion[r]


@compiled(inside=True)
def _shown_by(  # noqa: PLR0917
    code: Code,
    free: TrackedParameters,
    vector: FloatArray,
    work: Work,
    i: int,
    slope: FloatArray,
) -> None:
    """Derivatives of output i by states and parameters."""
    n = work.after.size - 1
    o = work.outputs.size
    for j in range(n):
        slope[j] = work.output_slopes[i * n + j]
    for j in range(free.places.size):
        derivative = work.output_slopes[o * n + i * code[N_UNKNOWN] + free.which[j]]
        slope[n + j] = (
            derivative * vector[free.places[j]] if free.logged[j] else derivative
        )


@compiled(inside=True)
def _move_member(  # noqa: PLR0917
    code: Code,
    fixed: BankConstants,
    at: FloatArray,
    vector: FloatArray,
    work: Work,
    u: FloatArray,
    d: FloatArray,
    error: float,
    moved: FloatArray,
    noises: FloatArray,
) -> None:
    """Move a belief one period on under the inputs u, shape (m,); `moved` gets the derivatives of the states
    by all of its numbers, and `noises` the variances that this adds. A push moves states as far as an output
    shows them."""
    o = work.outputs.size
    m = u.size
    p = fixed.free.places.size
    n = work.after.size - 1
    size = at.size
    share = n + p
    push = n + p + m
    fading = size - o
    moved_states = at[:n].copy()
    was = np.empty(o)
    inputs = _acting(fixed, at, u)
    _use(code, fixed.free, at, vector, work)
    call(code[OUTPUTS], at, inputs, d, work.p, work.b, work.outputs)
    call(code[OUTPUT_SLOPES], at, inputs, d, work.p, work.b, work.output_slopes)
    for i in range(o):
        was[i] = work.outputs[i]
    columns = _move(
        code,
        moved_states,
        inputs,
        d,
        work,
        fixed.period,
        fixed.steps,
        fixed.free.which,
        moved,
    )
    call(code[OUTPUTS], moved_states, inputs, d, work.p, work.b, work.outputs)
    for j in range(size):
        noises[j] = error * error * fixed.drift[j]
    for j in range(n):
        for q in range(p):
            if fixed.free.logged[q]:
                moved[j, n + q] *= vector[fixed.free.places[q]]
        for q in range(m):
            moved[j, share + q] = columns[j, p + n + q] * (u[q] - fixed.rest[q])
            moved[j, push + q] = columns[j, p + n + q]
    for i in range(o):
        shows = 0.0
        for j in range(n):
            shows += work.output_slopes[i * n + j] ** 2
        for j in range(n):
            by_push = work.output_slopes[i * n + j] / max(shows, 1e-300)
            moved[j, fading + i] = by_push * fixed.period
            moved_states[j] += moved[j, fading + i] * at[fading + i]
            noises[j] += (
                error * fixed.swift * (work.outputs[i] - was[i]) * by_push
            ) ** 2
    for j in range(size):
        at[j] = moved_states[j] if j < n else at[j] * fixed.keeps[j]


@compiled(inside=True)
def _correct_member(  # noqa: PLR0917
    code: Code,
    fixed: BankConstants,
    members: BankMembers,
    b: int,
    traces: ChangeTraces,
    begin: int,
    end: int,
    r: Reading,
    vector: FloatArray,
    work: Work,
) -> None:
    """Correct a member by a sample, and its traces, which are those from `begin` to before `end`."""
    belief = members.at[b]
    covariance = members.covariance[b]
    d = r.disturbances
    p = fixed.free.places.size
    o = r.y.size
    size = belief.size
    n = work.after.size - 1
    slope = np.zeros(size)
    reach = np.zeros(size)
    lost = np.zeros(size)
    slopes = work.output_slopes
    for i in range(o):
        offset = size - 3 * o + i
        passing = size - 2 * o + i
        call(code[OUTPUTS], belief, fixed.rest, d, work.p, work.b, work.outputs)
        call(code[OUTPUT_SLOPES], belief, fixed.rest, d, work.p, work.b, slopes)
        _shown_by(code, fixed.free, vector, work, i, slope)
        slope[offset] = slope[passing] = 1.0
        expected = max(_expected(covariance, slope, reach), 0.0)
        level = work.outputs[i] + belief[offset] + belief[passing]
        innovation = r.y[i] - level
        members.expected[b, i] = level
        members.variance[b, i] = expected
        members.gained[b, i] = 0.0
        if r.seen[i] and members.takes[b]:
            gained, moves, goes = _read(fixed, r, i, innovation, expected)
            members.gained[b, i] = gained
            gain = moves / innovation if abs(innovation) > 1e-9 else goes
            for j in range(size):
                lost[j] = gain * reach[j]
            _correct_traces(
                fixed,
                traces,
                begin,
                end,
                r,
                i,
                slope,
                lost,
                innovation,
                expected,
                gained,
            )
            for j in range(size):
                belief[j] += moves * reach[j]
                for k in range(size):
                    covariance[j, k] -= goes * (reach[j] * reach[k])
        slope[offset] = slope[passing] = 0.0
    for j in range(p):
        belief[n + j] = min(max(belief[n + j], fixed.free.least[j]), fixed.free.most[j])


@compiled
def step(  # noqa: PLR0917
    code: Code,
    fixed: BankConstants,
    members: BankMembers,
    traces: ChangeTraces,
    rows: ChangeRows,
    levels: int,
    r: Reading,
    now: int,
) -> None:
    """Correct all members and traces by a sample, and move them on to the next, in place."""
    slots = traces.born.size // (levels * rows.number.size)
    vector = fixed.free.vector.copy()
    size = members.at.shape[1]
    work = work_for(code, vector)
    noises = np.zeros(size)
    moved = np.zeros((work.after.size - 1, size))
    changed = np.zeros((rows.number.size, work.after.size - 1, work.after.size - 1))
    for t in range(traces.now.size):
        traces.now[t] = 0.0
    for b in range(members.alive.size):
        if not members.alive[b]:
            continue
        belief = members.at[b]
        covariance = members.covariance[b]
        u = r.inputs[members.way[b]]
        begin = min(b, levels) * slots * rows.number.size
        end = begin + (slots * rows.number.size if b < levels else 0)
        _use(code, fixed.free, belief, vector, work)
        _correct_member(code, fixed, members, b, traces, begin, end, r, vector, work)
        if end > begin:
            _move_changed(
                code,
                fixed,
                traces,
                rows,
                begin,
                slots,
                belief,
                vector,
                work,
                u,
                r.disturbances,
                changed,
            )
        _move_member(
            code,
            fixed,
            belief,
            vector,
            work,
            u,
            r.disturbances,
            members.error[b],
            moved,
            noises,
        )
        _carry(moved, covariance, fixed.keeps, noises)
        _carry_traces(
            fixed, traces, rows, begin, end, slots, moved, changed, r.crossing, now
        )
        total = 0.0
        for j in range(size):
            total += belief[j] + covariance[j, j]
        if not math.isfinite(total):
            members.alive[b] = False


@compiled(inside=True)
def _place_for(traces: ChangeTraces, begin: int, end: int, now: int) -> int:
    """A place for an onset among those of a row in a level. If all are taken, of the two onsets whose ages
    are most alike the less likely one goes, and its prior goes to the other: ages are geometric, and the
    price of an onset is paid once (Andersson 1985)."""
    for t in range(end - 1, begin - 1, -1):
        if traces.born[t] < 0:
            return t
    born = traces.born
    least = np.inf
    place = -1
    keep = -1
    for new in range(begin, end):
        old = -1  # the next older one
        for t in range(begin, end):
            if born[t] < born[new] and (old < 0 or born[t] > born[old]):
                old = t
        shared_life = (
            (born[new] - born[old]) / (now - born[old]) if old >= 0 else np.inf
        )
        if shared_life < least:
            behind = (
                traces.score[old] + traces.weight[old]
                < traces.score[new] + traces.weight[new]
            )
            least = shared_life
            place = old if behind else new
            keep = new if behind else old
    traces.mass[keep] += traces.mass[place]
    return place


@compiled
def spawn(  # noqa: PLR0917
    traces: ChangeTraces,
    rows: ChangeRows,
    at: FloatArray,
    weights: FloatArray,
    least: float,
    usual: FloatArray,
    reach: int,
    now: int,
) -> None:
    """Have every change begin now in each of the levels, whose means are `at`, if its log-weight is at least
    `least`; onsets older than `reach` samples, and hopeless ones, are dropped. A number that follows inputs
    counts from their `usual` values, shape (m,)."""
    slots = traces.born.size // (weights.size * rows.number.size)
    for t in range(traces.born.size):
        if traces.born[t] >= 0 and (
            now - traces.born[t] > reach or traces.score[t] < _HOPELESS
        ):
            traces.born[t] = -1
    for b in range(weights.size):
        if weights[b] < least:
            continue
        for r in range(rows.number.size):
            begin = (b * rows.number.size + r) * slots
            t = _place_for(traces, begin, begin + slots, now)
            traces.born[t] = now
            for j in range(at.shape[1]):
                traces.trace[t, j] = 0.0
            traces.trace[t, rows.number[r]] = 1.0 if rows.rate[r] == 0.0 else 0.0
            for a in range(rows.also.shape[1]):
                if rows.also[r, a] >= 0:
                    traces.trace[t, rows.also[r, a]] = traces.trace[t, rows.number[r]]
            traces.mean[t] = (
                -1.0 - at[b, rows.number[r]] if rows.whole[r] else rows.shift[r]
            )
            traces.variance[t] = rows.spread[r] ** 2
            traces.lasting_mean[t] = traces.mean[t]
            traces.lasting_variance[t] = traces.variance[t]
            traces.covariance[t] = traces.variance[t]
            traces.now[t] = 0.0
            traces.score[t] = 0.0
            traces.mass[t] = rows.mass[r]
            traces.weight[t] = weights[b]
            traces.usual[t] = _followed(rows, r, usual)
            traces.way[t] = 1.0
            traces.bends[t] = 1.0


@compiled
def weigh(  # noqa: PLR0917
    gained: FloatArray,
    alive: Any,
    log_weights: FloatArray,
    prior: FloatArray,
    switch: float,
    walked: float,
) -> float:
    """Weigh the healthy ones by a sample, of log-probability `walked` for the last of them, which has no
    equations; returns that of all. A share `switch` of the weights is spread by the prior."""
    joint = log_weights.copy()
    highest = -np.inf
    for b in range(joint.size):
        if b == joint.size - 1:
            joint[b] += walked
        elif alive[b]:
            for i in range(gained.shape[1]):
                joint[b] += gained[b, i]
        else:
            joint[b] = -np.inf
        highest = max(highest, joint[b])
    total = 0.0
    for b in range(joint.size):
        total += math.exp(joint[b] - highest)
    total = highest + math.log(total)
    for b in range(joint.size):
        log_weights[b] = math.log(
            (1.0 - switch) * math.exp(joint[b] - total) + switch * prior[b]
        )
    return total


@compiled
def tally(  # noqa: PLR0917
    traces: ChangeTraces,
    rows: ChangeRows,
    levels: int,
    healthy: float,
    doubts: FloatArray,
    now: int,
    totals: FloatArray,
    best: Any,
) -> None:
    """Add this sample, of log-probability `healthy` without a change, to the scores, divided by `doubts` at
    each age; `totals` gets the evidence of each cause, summed over its onsets, and `best` its likeliest."""
    count = rows.number.size
    heights = np.empty(totals.size)
    slots = traces.born.size // (levels * count)
    gains = np.empty(traces.born.size)
    for c in range(totals.size):
        totals[c] = 0.0
        heights[c] = -np.inf
    for t in range(traces.born.size):
        if traces.born[t] < 0:
            continue
        age = now - traces.born[t]
        c = rows.cause[t // slots % count]
        traces.score[t] += (traces.now[t] - healthy) / doubts[min(age, doubts.size - 1)]
        gains[t] = (
            traces.score[t] + traces.weight[t] + math.log(max(traces.mass[t], 1e-300))
        )
        if gains[t] > heights[c]:
            heights[c] = gains[t]
            best[c] = t
    for t in range(traces.born.size):
        if traces.born[t] >= 0:
            c = rows.cause[t // slots % count]
            totals[c] += math.exp(gains[t] - heights[c])
    for c in range(totals.size):
        totals[c] = heights[c] + math.log(totals[c]) if totals[c] > 0.0 else -np.inf
