"""The compiled arithmetic of every plant: steps, loops and their exact tangents.

Written against `derived`, whose functions are those of one plant; the store replaces them by the functions
generated for another plant and keeps the result, with `runs`, as a separate module.

A sample takes `steps` Runge–Kutta steps of order 4, none of which crosses a kink: if a condition changes sign
within a step, the moment is found by bisection and the step ends just after it. Tangents pass through the
same stages. They need no correction at a kink: the rates are continuous there, so its moment has no
first-order effect.
"""

# ruff: noqa: PLR0917 (kernels are long and take arrays in a row)

from __future__ import annotations

from typing import Any

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics.derived import (
    N_QUANTITIES,
    N_STATES,
    N_SWITCHES,
    N_UNKNOWN,
    branch,
    combined,
    output,
    output_slopes,
    packed,
    parameters,
    prepare,
    quantities,
    rates,
    rates_and_slopes,
    row,
    shifted,
    start,
    start_slopes,
    switches,
    tangents,
    unpack,
)
from twinmatch.signals import FloatArray

__all__ = [
    "MOST_STEPS",
    "RATE_LIMIT",
    "advance",
    "begin",
    "outputs_at",
    "parts",
    "slopes_at",
    "step_count",
    "tick",
    "tick_with_tangents",
]

RATE_LIMIT = 0.06
"""Runge–Kutta step in units of the fastest time constant: its error is below 1e-7 of the step."""
MOST_STEPS = 2000
MOST_EVENTS = 24
"""Kinks located within one step; further ones are stepped over."""
BISECTIONS = 48
MOST_SWITCHES = 6
"""Kinks whose combinations are all checked for the fastest rate."""


@compiled(innermost=True)
def _crossed(a: Any, u: float, d: Any, p: Any, c: Any, b: Any) -> bool:
    """Whether states lie beyond a kink."""
    return N_SWITCHES > 0 and switches(a, u, d, p, c) != b


@compiled(innermost=True)
def _runge_kutta(x: Any, u: float, d: Any, p: Any, c: Any, b: Any, h: float) -> Any:
    """States after one step with constant switches, and whether it crosses a kink.

    The stages are checked, too: beyond a kink the equations of this branch may be invalid.
    """
    k1 = rates(x, u, d, p, c, b)
    x2 = shifted(x, k1, 0.5 * h)
    k2 = rates(x2, u, d, p, c, b)
    x3 = shifted(x, k2, 0.5 * h)
    k3 = rates(x3, u, d, p, c, b)
    x4 = shifted(x, k3, h)
    k4 = rates(x4, u, d, p, c, b)
    there = combined(x, k1, k2, k3, k4, h)
    crossed = _crossed(there, u, d, p, c, b) or _crossed(x4, u, d, p, c, b)
    return there, crossed or _crossed(x3, u, d, p, c, b) or _crossed(x2, u, d, p, c, b)


@compiled(inside=True)
def _reach(x: Any, u: float, d: Any, p: Any, c: Any, b: Any, h: float) -> float:
    """Length of the step that ends just beyond the first kink within a step of h."""
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _runge_kutta(x, u, d, p, c, b, middle)[1]:
            high = middle
        else:
            low = middle
    return high


@compiled(innermost=True)
def tick(x: Any, u: float, d: Any, p: Any, c: Any, period: float, steps: int) -> Any:
    """States one period later."""
    for _ in range(steps):
        left = period / steps
        for event in range(MOST_EVENTS):
            b = switches(x, u, d, p, c)
            taken = left
            there, crossed = _runge_kutta(x, u, d, p, c, b, left)
            if crossed and event < MOST_EVENTS - 1:
                taken = _reach(x, u, d, p, c, b, left)
                there, _ = _runge_kutta(x, u, d, p, c, b, taken)
            x = there
            left -= taken
            if not left > 0.0:
                break
    return x


@compiled(innermost=True)
def tick_with_tangents(
    x: Any, u: float, d: Any, p: Any, c: Any, period: float, steps: int,
    which: Any, columns: FloatArray, du: FloatArray, fp: FloatArray,
) -> Any:  # fmt: skip
    """States one period later, in the same steps as `tick`.

    Their derivatives `columns`, shape (N_STATES, m), are updated in place.
    """
    for _ in range(steps):
        left = period / steps
        for event in range(MOST_EVENTS):
            b = switches(x, u, d, p, c)
            h = left
            while True:
                k1, fx1, fu1 = rates_and_slopes(x, u, d, p, c, b, fp, 0)
                x2 = shifted(x, k1, 0.5 * h)
                k2, fx2, fu2 = rates_and_slopes(x2, u, d, p, c, b, fp, 1)
                x3 = shifted(x, k2, 0.5 * h)
                k3, fx3, fu3 = rates_and_slopes(x3, u, d, p, c, b, fp, 2)
                x4 = shifted(x, k3, h)
                k4, fx4, fu4 = rates_and_slopes(x4, u, d, p, c, b, fp, 3)
                there = combined(x, k1, k2, k3, k4, h)
                if N_SWITCHES == 0 or h < left or event == MOST_EVENTS - 1:
                    break
                crossed = _crossed(there, u, d, p, c, b) or _crossed(x4, u, d, p, c, b)
                if not (crossed or _crossed(x3, u, d, p, c, b) or _crossed(x2, u, d, p, c, b)):
                    break
                reach = _reach(x, u, d, p, c, b, left)
                if not reach < h:
                    break
                h = reach
            tangents(columns, du, fp, which, h, fx1, fu1, fx2, fu2, fx3, fu3, fx4, fu4)
            x = there
            left -= h
            if not left > 0.0:
                break
    return x


@compiled
def advance(
    vector: FloatArray, x: FloatArray, u: float, d: FloatArray, period: float, steps: int
) -> FloatArray:
    """The states one period later under constant drive and disturbances, shape (N_STATES,)."""
    after = np.zeros(N_STATES)
    p = parameters(vector)
    c = prepare(p)
    unpack(tick(packed(x), u, row(d.reshape((1, d.size)), 0), p, c, period, steps), after)
    return after


@compiled
def begin(vector: FloatArray, y: float, u: float, d: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Initial states after a drive u, and their derivatives by y, (N_STATES,), and p, (N_STATES, n)."""
    x = np.zeros(N_STATES)
    xy, xp = np.zeros(N_STATES), np.zeros((N_STATES, N_UNKNOWN))
    p = parameters(vector)
    c = prepare(p)
    given = row(d.reshape((1, d.size)), 0)
    start(y, u, given, p, c, x)
    start_slopes(y, u, given, p, c, xy, xp)
    return x, xy, xp


@compiled
def outputs_at(vector: FloatArray, x: FloatArray, u: float, d: FloatArray) -> tuple[float, FloatArray]:
    """The output, and the plant's other quantities, shape (N_QUANTITIES,)."""
    q = np.zeros(N_QUANTITIES)
    p = parameters(vector)
    c = prepare(p)
    at, given = packed(x), row(d.reshape((1, d.size)), 0)
    quantities(at, u, given, p, c, switches(at, u, given, p, c), q)
    return output(at, given, p, c), q


@compiled
def parts(
    vector: FloatArray,
    y: float,
    before: FloatArray,
    u: float,
    rest: float,
    d: FloatArray,
    period: float,
    steps: int,
) -> tuple[float, float, FloatArray]:
    """Movement of a measured output in one period due to the drive and to all else, and the states after it.

    States that the output does not show start from `before`, unless that is NaN. Those whose initial value
    depends on the output, such as a heater that starts at the temperature of what it heats, are shifted by
    the output's error: their distance from the output is kept, so that errors of the plant do not accumulate.
    """
    x, after = np.zeros(N_STATES), np.zeros(N_STATES)
    shown, shown_by = np.zeros(N_STATES), np.zeros(N_UNKNOWN)
    xy, xp = np.zeros(N_STATES), np.zeros((N_STATES, N_UNKNOWN))
    p = parameters(vector)
    c = prepare(p)
    given = row(d.reshape((1, d.size)), 0)
    start(y, u, given, p, c, x)
    start_slopes(y, u, given, p, c, xy, xp)
    output_slopes(packed(x), given, p, c, shown, shown_by)
    if not np.isnan(before[0]):
        off = y - output(packed(before), given, p, c)
        for i in range(N_STATES):
            if shown[i] == 0.0:
                x[i] = before[i] + (xy[i] * off if xy[i] != 0.0 else 0.0)
    at = packed(x)
    driven = tick(at, u, given, p, c, period, steps)
    idle = output(tick(at, rest, given, p, c, period, steps), given, p, c)
    unpack(driven, after)
    return output(driven, given, p, c) - idle, idle - output(at, given, p, c), after


@compiled
def slopes_at(
    vector: FloatArray, x: FloatArray, u: float, d: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Rates, their derivatives by states, drive and parameters, and the output's by states, parameters."""
    fp = np.zeros((1, N_STATES, N_UNKNOWN))
    hx, hp = np.zeros(N_STATES), np.zeros(N_UNKNOWN)
    p = parameters(vector)
    c = prepare(p)
    at, given = packed(x), row(d.reshape((1, d.size)), 0)
    f, fx, fu = rates_and_slopes(at, u, given, p, c, switches(at, u, given, p, c), fp, 0)
    output_slopes(at, given, p, c, hx, hp)
    return np.array(f), np.array(fx).reshape((N_STATES, N_STATES)), np.array(fu), fp[0], hx, hp


@compiled
def step_count(
    vector: FloatArray, corners: FloatArray, drives: FloatArray, d: FloatArray, period: float, limit: float
) -> int:
    """Runge–Kutta steps per sample, none longer than `limit` times the fastest time constant; more than
    MOST_STEPS where the plant is too fast.

    The fastest rate decides: the largest over the states `corners`, shape (m, N_STATES), the drives, and all
    branches of the kinks, of the least of three norms of df/dx (rows, columns, Frobenius), each of which
    bounds the eigenvalues.
    """
    fp = np.zeros((1, N_STATES, N_UNKNOWN))
    p = parameters(vector)
    c = prepare(p)
    given, fastest = row(d.reshape((1, d.size)), 0), 0.0
    for k in range(corners.shape[0]):
        at = packed(corners[k])
        for u in drives:
            for code in range(2 ** min(N_SWITCHES, MOST_SWITCHES)):
                fx = rates_and_slopes(at, u, given, p, c, branch(code), fp, 0)[1]
                rows, columns, squares = 0.0, 0.0, 0.0
                for i in range(N_STATES):
                    in_row, in_column = 0.0, 0.0
                    for m in range(N_STATES):
                        in_row += abs(fx[i * N_STATES + m])
                        in_column += abs(fx[m * N_STATES + i])
                        squares += fx[i * N_STATES + m] ** 2
                    rows, columns = max(rows, in_row), max(columns, in_column)
                fastest = max(fastest, min(rows, columns, np.sqrt(squares)))
    count = np.ceil(period * fastest / limit)
    return int(max(count, 1.0)) if count <= MOST_STEPS else MOST_STEPS + 1
