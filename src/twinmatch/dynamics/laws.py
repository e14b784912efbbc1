"""Laws of the loop: what computes the commands from set-points and readings, with exact derivatives.

A law has a state z of q numbers, takes r and y at every sample, and gives the m commands u and its next
state. There are three: the PID, two levels with hysteresis, and a linear law in state space with limits, such
as an observer with state feedback. A plant driven by a given input is the case of a law that returns its
set-points.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import copy_into
from twinmatch.signals import FloatArray

GIVEN, PID, TWO_LEVEL, LINEAR = range(4)
NOTHING, BY_TIME, BY_READING = range(3)

LawCode = FloatArray
"""A law for compiled code: its kind, its period (s), the number m of its commands, their least values, their
greatest values, and its gains: those of PID and two levels as named below, or the matrix of a linear law,
whose rows give u and then the next state from z, y, r, 1 and u. Behind the matrix may be the least and the
greatest values that the drives take; the law's own u is then limited once more, without its knowledge."""
KIND, PERIOD, N_COMMANDS, LOW = range(4)
HIGH, PROPORTIONAL, INTEGRAL, DERIVATIVE, BACK, ON_MEASUREMENT = range(4, 10)
BELOW, ABOVE, MIN_ON, MIN_OFF, MAX_ON = range(5, 10)
NO_LAW: Final = np.array([GIVEN, 1.0, 0.0])
"""The set-points are the commands: a plant under a given input."""


@compiled(innermost=True)
def pid_step(
    law: LawCode, reference: float, y: float, integral: float, previous: float
) -> tuple[float, float, float]:
    """Command of one sample, and the PID's state after it: integral and differentiated signal."""
    error = reference - y
    moved = -y if law[ON_MEASUREMENT] != 0.0 else error
    unlimited = (
        law[PROPORTIONAL] * error
        + integral
        + law[DERIVATIVE] * (moved - previous) / law[PERIOD]
    )
    u = min(max(unlimited, law[LOW]), law[HIGH])
    return (
        u,
        integral + law[PERIOD] * (law[INTEGRAL] * error + law[BACK] * (u - unlimited)),
        moved,
    )


@compiled(inside=True)
def law_step(  # noqa: PLR0912, PLR0917
    law: LawCode,
    z: FloatArray,
    references: FloatArray,
    k: int,
    y: FloatArray,
    u: FloatArray,
    after: FloatArray,
) -> None:
    """Write the commands u, shape (m,), of sample k, and the law's state after it, shape (q,).

    `references` has a row for each sample. A call with arrays takes several times as long as a PID does,
    since each is counted; loops over samples treat PID and GIVEN themselves.
    """
    q = z.size
    m = u.size
    if law[KIND] == PID:
        u[0], after[0], after[1] = pid_step(law, references[k, 0], y[0], z[0], z[1])
    elif law[KIND] == GIVEN:
        for i in range(m):
            u[i] = references[k, i]
    elif law[KIND] == TWO_LEVEL:
        on = z[0] > 0.0
        since = z[1] + law[PERIOD]
        wanted = (
            (y[0] <= references[k, 0] + law[ABOVE])
            if on
            else (y[0] < references[k, 0] - law[BELOW])
        )
        due = since >= (law[MIN_ON] if on else law[MIN_OFF])
        switched = (due and wanted != on) or (on and since >= law[MAX_ON])
        after[0] = 1.0 if on != switched else 0.0
        after[1] = 0.0 if switched else since
        after[2] = y[0]
        u[0] = law[HIGH] if after[0] > 0.0 else law[LOW]
    else:
        p = y.size
        r = references.shape[1]
        width = q + p + r + 1 + m
        for i in range(m + q):
            row = LOW + 2 * m + i * width
            total = law[row + q + p + r]
            for j in range(q):
                total += law[row + j] * z[j]
            for j in range(p):
                total += law[row + q + j] * y[j]
            for j in range(r):
                total += law[row + q + p + j] * references[k, j]
            if i < m:
                u[i] = min(max(total, law[LOW + i]), law[LOW + m + i])
            else:
                for j in range(m):
                    total += law[row + q + p + r + 1 + j] * u[j]
                after[i - m] = total
        limits_at = LOW + 2 * m + (m + q) * width
        for i in range(m if law.size > limits_at else 0):
            u[i] = min(max(u[i], law[limits_at + i]), law[limits_at + m + i])


@compiled(inside=True)
def law_tangents(  # noqa: PLR0917
    slopes: FloatArray,
    dy: FloatArray,
    dz: FloatArray,
    du: FloatArray,
    moved: FloatArray,
    n: int,
) -> None:
    """Derivatives of the commands, and of the law's state after a sample, in place, by n unknowns: `dy` are
    those of the readings, `slopes` the result of `law_slopes`, and `moved` is room of the size of dz."""
    q = dz.shape[0]
    m = du.shape[0]
    p = dy.shape[0]
    for i in range(m + q):
        for j in range(n):
            total = 0.0
            for k in range(q):
                total += slopes[i, k] * dz[k, j]
            for k in range(p):
                total += slopes[i, q + k] * dy[k, j]
            if i < m:
                du[i, j] = total
            else:
                moved[i - m, j] = total
    for i in range(q):
        for j in range(n):
            dz[i, j] = moved[i, j]


@compiled(innermost=True)
def _cause(law: LawCode, z: FloatArray, reference: float) -> int:
    """What decides the moment at which two levels switch: BY_READING, BY_TIME, or NOTHING: the set-point."""
    on = z[0] > 0.0
    if on and z[1] + law[PERIOD] >= law[MAX_ON]:
        return BY_TIME
    if z[2] > reference + law[ABOVE] if on else z[2] < reference - law[BELOW]:
        return BY_TIME if z[1] < law[MIN_ON if on else MIN_OFF] else NOTHING
    return BY_READING


@compiled(inside=True)
def law_slopes(  # noqa: PLR0917
    law: LawCode,
    z: FloatArray,
    references: FloatArray,
    k: int,
    y: FloatArray,
    u: FloatArray,
    slopes: FloatArray,
) -> None:
    """Derivatives of the commands u of a sample, and then of the law's state after it, by its state z before
    it, and then by the readings: shape (m + q, q + p). A limited command does not depend on anything.

    Two levels switch at the moment when the reading crosses its limit, as if the command were in force from
    then on: a reading that is higher by dy crosses earlier by dy/ẏ.
    """
    q = z.size
    m = u.size
    p = y.size
    for i in range(m + q):
        for j in range(q + p):
            slopes[i, j] = 0.0
    if law[KIND] == PID:
        free = 1.0 if law[LOW] < u[0] < law[HIGH] else 0.0
        per_second = law[DERIVATIVE] / law[PERIOD]
        wind = law[PERIOD] * law[BACK] * (free - 1.0)
        by_reading = -law[PROPORTIONAL] - per_second
        slopes[0, 0] = free
        slopes[0, 1] = -free * per_second
        slopes[0, 2] = free * by_reading
        slopes[1, 0] = 1.0 + wind
        slopes[1, 1] = -wind * per_second
        slopes[1, 2] = wind * by_reading - law[PERIOD] * law[INTEGRAL]
        slopes[2, 2] = -1.0
    elif law[KIND] == TWO_LEVEL:
        before = law[HIGH] if z[0] > 0.0 else law[LOW]
        cause = _cause(law, z, references[k, 0]) if u[0] != before else BY_TIME
        slopes[3, 3] = 1.0
        if cause == BY_TIME:
            slopes[0, 1] = (u[0] - before) / law[PERIOD]
            slopes[2, 1] = 1.0
        elif cause == BY_READING:
            moved = y[0] - z[2]
            slopes[0, 3] = (u[0] - before) / moved
            slopes[2, 3] = law[PERIOD] / moved
    elif law[KIND] == LINEAR:
        width = q + p + references.shape[1] + 1 + m
        for i in range(m + q):
            row = LOW + 2 * m + i * width
            free = 1.0 if i >= m or law[LOW + i] < u[i] < law[LOW + m + i] else 0.0
            for j in range(q + p):
                slopes[i, j] = free * law[row + j]
            for command in range(m if i >= m else 0):
                for j in range(q + p):
                    slopes[i, j] += law[row + width - m + command] * slopes[command, j]


@compiled(inside=True)
def gain_slopes(  # noqa: PLR0912, PLR0917
    law: LawCode,
    z: FloatArray,
    references: FloatArray,
    k: int,
    y: FloatArray,
    u: FloatArray,
    tuned: NDArray[np.int64],
    slopes: FloatArray,
) -> None:
    """Derivatives of commands and next state, shape (m + q, t), by the gains at the places `tuned` of the
    law, shape (t,)."""
    # One function with a case for each kind of law: a kernel cannot hold functions as values.
    q = z.size
    m = u.size
    p = y.size
    r = references.shape[1]
    slopes[:] = 0.0
    for t in range(tuned.size):
        place = tuned[t]
        if law[KIND] == PID:
            error = references[k, 0] - y[0]
            moving = -y[0] if law[ON_MEASUREMENT] != 0.0 else error
            change = (moving - z[1]) / law[PERIOD]
            free = 1.0 if law[LOW] < u[0] < law[HIGH] else 0.0
            unlimited = law[PROPORTIONAL] * error + z[0] + law[DERIVATIVE] * change
            derivative = 0.0
            if place == PROPORTIONAL:
                derivative = error
            elif place == DERIVATIVE:
                derivative = change
            slopes[0, t] = free * derivative
            slopes[1, t] = law[PERIOD] * law[BACK] * (free - 1.0) * derivative
            if place == INTEGRAL:
                slopes[1, t] += law[PERIOD] * error
            elif place == BACK:
                slopes[1, t] += law[PERIOD] * (u[0] - unlimited)
        elif law[KIND] == TWO_LEVEL:
            on = z[0] > 0.0
            before = law[HIGH] if on else law[LOW]
            cause = _cause(law, z, references[k, 0]) if u[0] != before else NOTHING
            longest = on and z[1] + law[PERIOD] >= law[MAX_ON]
            if cause == BY_TIME and place == (
                MAX_ON if longest else MIN_ON if on else MIN_OFF
            ):
                slopes[0, t] = -(u[0] - before) / law[PERIOD]
                slopes[2, t] = -1.0
            elif cause == BY_READING and place == (ABOVE if on else BELOW):
                moved = (z[2] - y[0]) if on else (y[0] - z[2])
                slopes[0, t] = (u[0] - before) / moved
                slopes[2, t] = law[PERIOD] / moved
        elif law[KIND] == LINEAR:
            width = q + p + r + 1 + m
            row = (place - LOW - 2 * m) // width
            column = (place - LOW - 2 * m) % width
            value = 1.0
            if column < q:
                value = z[column]
            elif column < q + p:
                value = y[column - q]
            elif column < q + p + r:
                value = references[k, column - q - p]
            elif column > q + p + r:
                value = u[column - q - p - r - 1]
            if row < m:
                value *= 1.0 if law[LOW + row] < u[row] < law[LOW + m + row] else 0.0
                for i in range(m, m + q):
                    slopes[i, t] = (
                        law[LOW + 2 * m + i * width + width - m + row] * value
                    )
            slopes[row, t] = value


@compiled
def commands_of(
    law: LawCode, z: FloatArray, references: FloatArray, readings: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Commands, shape (N, m), of a law for set-points, shape (N, r), and readings, shape (N, p), from a state
    on; and its state after them, shape (q,)."""
    u = np.zeros((len(references), int(law[N_COMMANDS])))
    state = z.copy()
    after = z.copy()
    for k in range(len(references)):
        law_step(law, state, references, k, readings[k], u[k], after)
        copy_into(after, state)
    return u, state
