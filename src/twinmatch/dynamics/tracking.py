"""The compiled arithmetic of a `Tracker`: states, parameters and what else is unknown, sample by sample.

The store puts this file behind `kernels`, so that all is written against one plant's functions.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 (kernels are long and take arrays in a row)

from __future__ import annotations

import math

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics.derived import (
    N_STATES,
    N_UNKNOWN,
    held,
    output,
    output_slopes,
    packed,
    prepare,
    row,
    unpack,
)
from twinmatch.dynamics.kernels import tick_with_tangents
from twinmatch.dynamics.tracked import Tracked
from twinmatch.signals import FloatArray

__all__ = ["track"]

CLIPPED = 3.0
"""Surprises count as no larger than so many of their standard deviations."""
STANDING = 2.0
"""A surprise larger than this may be the sensor's own, if its reading stood still."""
STALE = 1e6
"""Variance of a reading that is not to be believed."""


@compiled(inside=True)
def _values(fixed: Tracked, at: FloatArray, vector: FloatArray) -> None:
    """Write the parameters that a belief stands for."""
    for j in range(fixed.places.size):
        q = at[N_STATES + j]
        start = fixed.vector[fixed.places[j]]
        vector[fixed.places[j]] = start * math.exp(q) if fixed.logged[j] else start + q


@compiled
def track(
    fixed: Tracked, at: FloatArray, covariance: FloatArray, drift: FloatArray, swift: float,
    y: FloatArray, u: FloatArray, disturbances: FloatArray, noise: FloatArray,
    opened: FloatArray, lasting: int, rising: int, effects: FloatArray, hits: FloatArray, weights: FloatArray,
) -> float:  # fmt: skip
    """Follow some samples; belief and traces move in place. Return what the readings cost, in nats.

    Args:
        fixed: what stays.
        at: what is believed, shape (n,): states, parameters, share of the drive, offset of the reading, its
            passing part, push that fades, push that stays, and the rate at which one of the others rises.
        covariance: of it, shape (n, n).
        drift: standard deviations by which it strays in a second, shape (n,).
        swift: error of a movement of the output as a share of it.
        y: readings, shape (N + 2,), the first two being those before.
        u: input, shape (N,).
        disturbances: shape (N, m).
        noise: standard deviation of each reading, shape (N,).
        opened: more straying, per second, in the first `lasting` samples, shape (n,).
        lasting: number of those samples.
        rising: which of the numbers rises at the rate, by its index; negative: none.
        effects: what jumps in the past would have done to what is believed now, shape (n, kinds, starts).
        hits: sums of surprise times effect over variance, shape (kinds, starts).
        weights: sums of squared effect over variance, shape (kinds, starts).
    """
    n, m, size = N_STATES, fixed.places.size, at.size
    share, offset, passing, fading, lasting_push = n + m, n + m + 1, n + m + 2, n + m + 3, n + m + 4
    period = fixed.period
    vector = fixed.vector.copy()
    columns, du = np.zeros((n, m + n + 1)), np.zeros(m + n + 1)
    fp, hx, hp = np.zeros((4, n, N_UNKNOWN)), np.zeros(n), np.zeros(N_UNKNOWN)
    slope, gain, reach = np.zeros(size), np.zeros(size), np.zeros(size)
    moved, wide = np.zeros((n, size)), np.zeros((n, size))
    there = np.zeros(n)
    cost = 0.0
    for k in range(u.size):
        given = row(disturbances, k)
        _values(fixed, at, vector)
        p = held(vector)
        c = prepare(p)
        x = packed(at)
        output_slopes(x, given, p, c, hx, hp)
        slope[:n] = hx
        for j in range(m):
            by = hp[fixed.which[j]]
            slope[n + j] = by * vector[fixed.places[j]] if fixed.logged[j] else by
        slope[offset] = slope[passing] = 1.0

        # Correct.
        surprise = y[k + 2] - output(x, given, p, c) - at[offset] - at[passing]
        reading = noise[k] ** 2
        seen = 0.0
        for i in range(size):
            reach[i] = 0.0
            for j in range(size):
                reach[i] += covariance[i, j] * slope[j]
            seen += slope[i] * reach[i]
        variance = seen + reading
        stale = False
        if surprise**2 > STANDING**2 * variance:
            if y[k + 2] == y[k + 1]:
                stale = True
                variance = STALE
            elif y[k + 1] == y[k]:  # it stood still, and comes back from elsewhere
                covariance[passing, passing] += surprise**2
                reach[passing] += surprise**2
                variance += surprise**2
        if not stale:
            variance = max(variance, (surprise / CLIPPED) ** 2)
            cost += 0.5 * math.log(variance) + 0.5 * surprise**2 / variance
        for i in range(size):
            gain[i] = reach[i] / variance
            at[i] += gain[i] * surprise
        for i in range(size):
            for j in range(size):
                covariance[i, j] -= gain[i] * reach[j]
        for kind in range(effects.shape[1]):
            for start in range(effects.shape[2]):
                shown = 0.0
                for i in range(size):
                    shown += slope[i] * effects[i, kind, start]
                hits[kind, start] += shown * surprise / variance
                weights[kind, start] += shown * shown / variance
                for i in range(size):
                    effects[i, kind, start] -= gain[i] * shown
        for j in range(m):
            at[n + j] = min(max(at[n + j], fixed.least[j]), fixed.most[j])
        at[share] = min(max(at[share], -1.0), 1.0)

        # Predict.
        _values(fixed, at, vector)
        p = held(vector)
        c = prepare(p)
        columns[:] = 0.0
        for i in range(n):
            columns[i, m + i] = 1.0
        du[m + n] = u[k] - fixed.rest
        x = packed(at)
        before = output(x, given, p, c)
        after = tick_with_tangents(
            x, fixed.rest + (u[k] - fixed.rest) * (1.0 + at[share]), given, p, c, period, fixed.steps,
            fixed.which, columns, du, fp,
        )  # fmt: skip
        moving = output(after, given, p, c) - before
        unpack(after, there)
        shows = 0.0
        for i in range(n):
            shows += hx[i] * hx[i]
        for i in range(n):
            for j in range(n):
                moved[i, j] = columns[i, m + j]
            for j in range(m):
                by = columns[i, j]
                moved[i, n + j] = by * vector[fixed.places[j]] if fixed.logged[j] else by
            moved[i, share] = columns[i, m + n]
            push = hx[i] / shows * period
            moved[i, fading] = moved[i, lasting_push] = push
            at[i] = there[i] + push * (at[fading] + at[lasting_push])
        for i in range(n, size):
            at[i] *= fixed.keeps[i]
        _carry(moved, wide, covariance, fixed.keeps)
        for i in range(size):
            covariance[i, i] += drift[i] ** 2 * period
            if k < lasting:
                covariance[i, i] += opened[i] ** 2 * period
        for i in range(n):
            covariance[i, i] += (swift * moving * hx[i] / shows) ** 2
        if rising >= 0:
            rate = size - 1
            at[rising] += at[rate] * period
            for i in range(size):
                covariance[rising, i] += covariance[rate, i] * period
            for i in range(size):
                covariance[i, rising] += covariance[i, rate] * period
        _carry_effects(moved, there, effects, fixed.keeps)
    return cost


@compiled(inside=True)
def _carry(moved: FloatArray, wide: FloatArray, covariance: FloatArray, keeps: FloatArray) -> None:
    """The covariance one period later: `moved` are the rows of the states, the rest fades by `keeps`."""
    n, size = moved.shape
    for i in range(n):
        for j in range(size):
            wide[i, j] = 0.0
            for q in range(size):
                wide[i, j] += moved[i, q] * covariance[q, j]
    for i in range(n, size):
        for j in range(n, size):
            covariance[i, j] *= keeps[i] * keeps[j]
    for i in range(n):
        for j in range(n, size):
            covariance[i, j] = covariance[j, i] = wide[i, j] * keeps[j]
        for j in range(i + 1):
            value = 0.0
            for q in range(size):
                value += wide[i, q] * moved[j, q]
            covariance[i, j] = covariance[j, i] = value


@compiled(inside=True)
def _carry_effects(moved: FloatArray, there: FloatArray, effects: FloatArray, keeps: FloatArray) -> None:
    """What jumps would have done, one period later."""
    n, size = moved.shape
    for kind in range(effects.shape[1]):
        for start in range(effects.shape[2]):
            for i in range(n):
                there[i] = 0.0
                for q in range(size):
                    there[i] += moved[i, q] * effects[q, kind, start]
            for i in range(n):
                effects[i, kind, start] = there[i]
            for i in range(n, size):
                effects[i, kind, start] *= keeps[i]
