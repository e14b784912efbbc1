"""Uncertainty around the loop: variances of a forecast, and the effect of the sensors' noise on a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.filters import predict
from twinmatch.dynamics.kernels import Code, advance, copy_into
from twinmatch.dynamics.laws import LawCode
from twinmatch.dynamics.runs import RunData, Start, Tangents, run, run_with_tangents
from twinmatch.signals import FloatArray

MEAN = 1
BANDED = 2
"""What is wanted of a plant's forecast."""


@compiled
def foresee_each(  # noqa: PLR0917
    codes: NDArray[np.int64],
    sizes: NDArray[np.int64],
    vectors: FloatArray,
    which: NDArray[np.int64],
    x: FloatArray,
    joints: FloatArray,
    process_noise: FloatArray,
    steps: NDArray[np.int64],
    wanted: NDArray[np.int64],
    u: FloatArray,
    law: LawCode,
    memory: FloatArray,
    references: FloatArray,
    disturbances: FloatArray,
    period: float,
    noise: FloatArray,
    swift: float,
) -> tuple[FloatArray, FloatArray]:
    """`foresee` for several plants, one row of each array per plant: means and variances of outputs, then
    inputs, shape (C, o + m, N); NaN where they are not `wanted`.

    `sizes`, shape (C, 3), are the numbers of states, parameters and unsure parameters.
    """
    o = noise.size
    shape = (len(sizes), o + u.size, len(references))
    means = np.full(shape, np.nan)
    variances = np.full(shape, np.nan)
    for i in range(len(sizes)):
        if wanted[i] == 0:
            continue
        n, p, q = sizes[i]
        joint = joints[i, : (n + q) ** 2].copy().reshape((n + q, n + q))
        outputs, inputs, of_outputs, of_inputs = foresee(
            codes[i],
            vectors[i, :p],
            which[i, : 2 * q].reshape((2, q)),
            x[i, :n].copy(),
            joint,
            process_noise[i, : n + q],
            u,
            law,
            memory,
            references,
            disturbances,
            period,
            steps[i],
            noise,
            swift,
            wanted[i] == BANDED,
        )
        for k in range(len(references)):
            copy_into(outputs[k], means[i, :, k])
            copy_into(inputs[k], means[i, o:, k])
            if wanted[i] == BANDED:
                copy_into(of_outputs[k], variances[i, :, k])
                copy_into(of_inputs[k], variances[i, o:, k])
    return means, variances


@compiled(inside=True)
def foresee(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    which: NDArray[np.int64],
    x: FloatArray,
    joint: FloatArray,
    process_noise: FloatArray,
    u: FloatArray,
    law: LawCode,
    memory: FloatArray,
    references: FloatArray,
    disturbances: FloatArray,
    period: float,
    steps: int,
    noise: FloatArray,
    swift: float,
    banded: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Outputs, inputs and their variances; `x` and `joint` are those at the newest sample, and are changed;
    `noise` holds variances, shape (o,). Each sample's movement of a state is wrong by a share of it, with
    the standard deviation `swift`."""
    size = len(references)
    n = x.size
    k = which.shape[1]
    m = u.size
    d = disturbances[1:]
    begun = advance(code, vector, x, u, disturbances[0], period, steps)
    still = np.zeros((size, noise.size))
    never = np.zeros(size, dtype=np.bool_)
    # The mean is simulated without derivatives, like every simulation: derivatives share subexpressions with
    # the rates, which then round differently.
    outputs, inputs, states = run(
        code,
        vector,
        begun,
        law,
        memory,
        references,
        d,
        still,
        never,
        0.0,
        period,
        steps,
    )
    if not banded:
        return outputs, inputs, np.zeros((0, noise.size)), np.zeros((0, m))
    compared = np.zeros((noise.size + m, size))
    strays = np.empty((size + 1, n + k))
    for j in range(size + 1):
        copy_into(process_noise, strays[j])
    for i in range(n):  # a parameter does not move
        strays[0, i] += (swift * (begun[i] - x[i])) ** 2
        for j in range(size):
            strays[j + 1, i] += (swift * (states[j + 1, i] - states[j, i])) ** 2
    predict(code, vector, x, joint, strays[0], u, disturbances[0], period, steps, which)
    data = RunData(
        which[0],
        np.zeros(0, dtype=np.int64),
        memory,
        references,
        d,
        compared,
        compared,
        False,
        period,
    )
    columns = np.zeros((n, k + n))
    for i in range(n):
        columns[i, k + i] = 1.0
    start = Start(vector, law, begun, columns, steps)
    loop, _ = run_with_tangents(code, start, data, True, np.inf)
    of_outputs, of_inputs = _variances(joint, loop, noise, strays[1:])
    return outputs, inputs, of_outputs, of_inputs


@compiled
def _variances(  # noqa: PLR0912
    joint: FloatArray, loop: Tangents, noise: FloatArray, strays: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variances of outputs, shape (N, o), and inputs, shape (N, m).

    `loop` has the derivatives by k parameters and n states at the first sample, `joint` is the covariance of
    states and parameters there, `noise` are the variances of the readings, and `strays`, shape (N, n + k),
    those that each tick adds. Later noise and drift enter the covariance of the loop's own state: those of
    the plant, then the law's.
    """
    _, _, by_unknown, by_state, by_input, around, output_slopes = loop
    size, outputs, nx = output_slopes.shape
    inputs = by_input.shape[2]
    both = joint.shape[0]
    m = nx + around.shape[1] - inputs
    of_outputs = np.zeros((size, outputs))
    of_inputs = np.zeros((size, inputs))
    a = np.zeros((m, m))
    b = np.zeros((m, outputs))
    of_u = np.zeros((inputs, m))
    later = np.zeros((m, m))
    way = np.zeros((m, m))
    of_y = np.zeros(m)
    first = np.zeros((both, both))  # in the order of `by`
    for i in range(both):
        for j in range(both):
            first[i, j] = joint[(i + nx) % both, (j + nx) % both]
    for k in range(size):
        _around_loop(around, output_slopes, by_state, by_input, k, a, b, of_u)
        for o in range(outputs):
            for i in range(nx):
                of_y[i] = output_slopes[k, o, i]
            of_outputs[k, o] = max(
                noise[o] + _form(first, by_unknown[o, k]) + _form(later, of_y), 0.0
            )
        for i in range(inputs):
            total = _form(first, by_unknown[outputs + i, k]) + _form(later, of_u[i])
            for o in range(outputs):
                total += around[k, i, m - nx + o] ** 2 * noise[o]
            of_inputs[k, i] = max(total, 0.0)
        for i in range(m):
            for j in range(m):
                total = 0.0
                for q in range(m):
                    total += a[i, q] * later[q, j]
                way[i, j] = total
        for i in range(m):
            for j in range(i + 1):
                total = strays[k, i] if i == j and i < nx else 0.0
                for o in range(outputs):
                    total += noise[o] * b[i, o] * b[j, o]
                for q in range(m):
                    total += way[i, q] * a[j, q]
                later[i, j] = total
                later[j, i] = total
    return of_outputs, of_inputs


@compiled(innermost=True)
def _form(of: FloatArray, b: FloatArray) -> float:
    """bᵀ·of·b for a symmetric matrix `of`."""
    total = 0.0
    for i in range(b.size):
        side = 0.0
        for j in range(i):
            side += of[i, j] * b[j]
        total += b[i] * (2.0 * side + of[i, i] * b[i])
    return total


@compiled
def noise_effects(  # noqa: PLR0912
    loop: Tangents,
    started: FloatArray,
    weighed: FloatArray,
    weights: FloatArray,
    closed: bool,
) -> tuple[FloatArray, float]:
    """Backwards through the linearised loop, whose state holds those of the plant and the law.

    For the readings of each output apart, `ahead` holds the gradients of the sums by the state one sample
    later, `power` the quadratic form of a disturbed state that gives the sum of the squared residuals from
    then on.
    """
    _, _, _, by_state, by_input, around, output_slopes = loop
    size, outputs, nx = output_slopes.shape
    n = weighed.shape[2]
    inputs = by_input.shape[2]
    m = nx + around.shape[1] - inputs
    scores = np.empty((size * outputs, n))
    squares = 0.0
    a = np.zeros((m, m))
    all_b = np.zeros((m, outputs))
    of_u = np.zeros((inputs, m))
    b = np.zeros(m)
    compared = inputs if closed else 0
    for reading in range(outputs):
        ahead = np.zeros((m, n))
        power = np.zeros((m, m))
        w = weights[reading]
        for k in range(size - 1, -1, -1):
            _around_loop(around, output_slopes, by_state, by_input, k, a, all_b, of_u)
            out_y = w[reading]
            for i in range(m):
                b[i] = all_b[i, reading]
            if k == 0:
                # The twin starts at the first readings, so their noise shifts both, and only the plant's own
                # movement afterwards differs.
                out_y = 0.0
                for i in range(m):
                    b[i] = 0.0
                    if i < nx:
                        for j in range(nx):
                            b[i] -= by_state[k, i, j] * started[j, reading]
            for p in range(n):
                score = out_y * weighed[reading, k, p]
                for i in range(compared if k > 0 else 0):
                    score += (
                        w[outputs + i]
                        * around[k, i, m - nx + reading]
                        * weighed[outputs + i, k, p]
                    )
                for i in range(m):
                    score += b[i] * ahead[i, p]
                scores[k * outputs + reading, p] = score
            squares += out_y * out_y + _power_form(power, b)
            for i in range(compared if k > 0 else 0):
                squares += (w[outputs + i] * around[k, i, m - nx + reading]) ** 2
            ahead = _earlier(ahead, a, of_u, output_slopes, weighed, w, k, compared)
            power = _congruent(power, a)
            for i in range(m):
                for j in range(m):
                    for q in range(compared):
                        power[i, j] += w[outputs + q] ** 2 * of_u[q, i] * of_u[q, j]
                    if i < nx and j < nx:
                        for o in range(outputs):
                            power[i, j] += (
                                w[o] ** 2
                                * output_slopes[k, o, i]
                                * output_slopes[k, o, j]
                            )
    return scores, squares / ((outputs + compared) * size)


@compiled(inside=True)
def _earlier(  # noqa: PLR0917
    ahead: FloatArray,
    a: FloatArray,
    of_u: FloatArray,
    seen: FloatArray,
    weighed: FloatArray,
    w: FloatArray,
    k: int,
    compared: int,
) -> FloatArray:
    """The gradients of the sums by the state at sample k, from those one sample later."""
    m, n = ahead.shape
    outputs, nx = seen.shape[1:]
    sums = np.zeros((m, n))
    for p in range(n):
        for j in range(m):
            total = 0.0
            for i in range(compared):
                total += w[outputs + i] * weighed[outputs + i, k, p] * of_u[i, j]
            if j < nx:
                for o in range(outputs):
                    total += w[o] * weighed[o, k, p] * seen[k, o, j]
            for i in range(m):
                total += a[i, j] * ahead[i, p]
            sums[j, p] = total
    return sums


@compiled(innermost=True)
def _around_loop(  # noqa: PLR0912, PLR0917
    around: FloatArray,
    seen: FloatArray,
    by_state: FloatArray,
    by_input: FloatArray,
    k: int,
    a: FloatArray,
    b: FloatArray,
    of_u: FloatArray,
) -> None:
    """Sample k of the linear loop; its state z holds those of the plant and of the law.

    With v, the noise of the readings: u = of_u·z + around·v, next z = a·z + b·v.
    """
    outputs = seen.shape[1]
    nx = seen.shape[2]
    inputs = by_input.shape[2]
    q = around.shape[1] - inputs
    for i in range(inputs + q):
        for j in range(nx + q):
            total = 0.0
            if j < nx:
                for o in range(outputs):
                    total += around[k, i, q + o] * seen[k, o, j]
            else:
                total = around[k, i, j - nx]
            if i < inputs:
                of_u[i, j] = total
            else:
                a[nx + i - inputs, j] = total
        for o in range(outputs if i >= inputs else 0):
            b[nx + i - inputs, o] = around[k, i, q + o]
    for i in range(nx):
        for j in range(nx + q):
            total = by_state[k, i, j] if j < nx else 0.0
            for input_number in range(inputs):
                total += by_input[k, i, input_number] * of_u[input_number, j]
            a[i, j] = total
        for o in range(outputs):
            total = 0.0
            for input_number in range(inputs):
                total += by_input[k, i, input_number] * around[k, input_number, q + o]
            b[i, o] = total


@compiled
def _power_form(power: FloatArray, b: FloatArray) -> float:
    """bᵀ·power·b."""
    total = 0.0
    for i in range(b.size):
        for j in range(b.size):
            total += power[i, j] * b[i] * b[j]
    return total


@compiled
def _congruent(power: FloatArray, a: FloatArray) -> FloatArray:
    """aᵀ·power·a."""
    m = power.shape[0]
    way = np.zeros((m, m))
    product = np.zeros((m, m))
    for i in range(m):
        for j in range(m):
            for q in range(m):
                way[i, j] += power[i, q] * a[q, j]
    for i in range(m):
        for j in range(m):
            for q in range(m):
                product[i, j] += a[q, i] * way[q, j]
    return product
