"""The functions generated from a plant's equations, written by hand for a first-order lag.

    dx/dt = (gain·u − x)/lag,  y = x

The kernels are written against this module. For any other plant `code.py` generates the same functions from
that plant's equations, and they replace this module. States x, disturbances d and switches b (1 or 0) are
tuples, so that they stay in registers; so are the parameters p and the constants c that `prepare` computes
from them. Arrays are filled in place; the caller sets the entries that are always zero.
"""

# ruff: noqa: ARG001, D103, PLR0917 (the form of the code that is written)
# mypy: ignore-errors

from __future__ import annotations

from typing import Any

from twinmatch.compiled import compiled

N_STATES = 1
N_UNKNOWN = 2
N_QUANTITIES = 0
N_SWITCHES = 0


@compiled(innermost=True)
def row(disturbances: Any, k: Any) -> Any:
    return ()


@compiled(innermost=True)
def parameters(vector: Any) -> Any:
    return (vector[0], vector[1])


@compiled(innermost=True)
def prepare(p: Any) -> Any:
    return (1 / p[1],)


@compiled(innermost=True)
def switches(x: Any, u: Any, d: Any, p: Any, c: Any) -> Any:
    return ()


@compiled(innermost=True)
def rates(x: Any, u: Any, d: Any, p: Any, c: Any, b: Any) -> Any:
    return (c[0] * (p[0] * u - x[0]),)


@compiled(innermost=True)
def rates_and_slopes(x: Any, u: Any, d: Any, p: Any, c: Any, b: Any, fp: Any, stage: Any) -> Any:
    """Rates, their derivatives by states (row by row) and by the drive; those by parameters go to
    fp[stage]."""
    rate = c[0] * (p[0] * u - x[0])
    fp[stage, 0, 0] = c[0] * u
    fp[stage, 0, 1] = -c[0] * rate
    return (rate,), (-c[0],), (c[0] * p[0],)


@compiled(innermost=True)
def output(x: Any, d: Any, p: Any, c: Any) -> Any:
    return x[0]


@compiled(innermost=True)
def output_slopes(x: Any, d: Any, p: Any, c: Any, hx: Any, hp: Any) -> Any:
    hx[0] = 1.0


@compiled(innermost=True)
def start(y: Any, u: Any, d: Any, p: Any, c: Any, x: Any) -> Any:
    x[0] = y


@compiled(innermost=True)
def start_slopes(y: Any, u: Any, d: Any, p: Any, c: Any, xy: Any, xp: Any) -> Any:
    xy[0] = 1.0


@compiled(innermost=True)
def quantities(x: Any, u: Any, d: Any, p: Any, c: Any, b: Any, q: Any) -> Any:
    pass


@compiled(innermost=True)
def branch(code: Any) -> Any:
    """The switches as the bits of a number."""
    return ()


@compiled(innermost=True)
def packed(array: Any) -> Any:
    return (array[0],)


@compiled(innermost=True)
def unpack(x: Any, array: Any) -> Any:
    array[0] = x[0]


@compiled(innermost=True)
def shifted(x: Any, k: Any, h: Any) -> Any:
    return (x[0] + h * k[0],)


@compiled(innermost=True)
def combined(x: Any, k1: Any, k2: Any, k3: Any, k4: Any, h: Any) -> Any:
    return (x[0] + h / 6.0 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0]),)


@compiled(innermost=True)
def tangents(
    columns: Any,
    du: Any,
    fp: Any,
    which: Any,
    h: Any,
    fx1: Any,
    fu1: Any,
    fx2: Any,
    fu2: Any,
    fx3: Any,
    fu3: Any,
    fx4: Any,
    fu4: Any,
) -> Any:
    """Move the derivatives of the states, shape (N_STATES, m), through one Runge–Kutta step.

    Column j is by the parameter which[j] as long as there is one; du holds the drive's derivatives.
    """
    for j in range(du.size):
        own = which[j] if j < which.size else -1
        t = columns[0, j]
        r1 = fx1[0] * t + fu1[0] * du[j] + (fp[0, 0, own] if own >= 0 else 0.0)
        r2 = fx2[0] * (t + 0.5 * h * r1) + fu2[0] * du[j] + (fp[1, 0, own] if own >= 0 else 0.0)
        r3 = fx3[0] * (t + 0.5 * h * r2) + fu3[0] * du[j] + (fp[2, 0, own] if own >= 0 else 0.0)
        r4 = fx4[0] * (t + h * r3) + fu4[0] * du[j] + (fp[3, 0, own] if own >= 0 else 0.0)
        columns[0, j] = t + h / 6.0 * (r1 + 2.0 * r2 + 2.0 * r3 + r4)
