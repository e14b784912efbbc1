"""ν-gap between two models: exact and certified here, sampled on a grid by `nugap`.

Models are such as the twin compares: discrete, slow poles near 1, orders 2 to 5. `nugap` takes one output
only, so the comparison is on one; the twin's own two-output pairs, and stability margins of a loop, are timed
beside it. The note gives the largest relative error against 50 digits (golden section on the definition).
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import control
import mpmath as mp
import numpy as np

from benchmarks.common import Row, main, measure_side_by_side, peer, rows_of
from twinmatch.comparing import (
    GraphSymbol,
    StateSpace,
    matrix_margin,
    matrix_nu_gap,
    nu_gap,
    nu_gap_matrix,
    stability_margin,
)
from twinmatch.comparing.matrix_gap import closed_loop

Fraction = tuple[np.ndarray, np.ndarray]

PAIRS = 5


def run(quick: bool) -> list[Row]:
    rows = []
    repeats = 3 if quick else 15
    for order in (2, 5) if quick else (2, 3, 4, 5):
        rows += _one_output(order, repeats, accurate=not quick)
        rows += _two_outputs(order, repeats)
    return rows + _loop(repeats) + _matrices(repeats)


def _one_output(order: int, repeats: int, *, accurate: bool) -> list[Row]:
    """All pairs of five models, from prepared symbols and from the coefficients."""
    rng = np.random.default_rng(order)
    models = [_model(rng, order, 1.0) for _ in range(PAIRS)]
    pairs = list(combinations(range(PAIRS), 2))
    symbols = [GraphSymbol.of_transfer_functions([m], 1.0) for m in models]
    prepared = {"twinmatch": lambda: [nu_gap(symbols[i], symbols[j]) for i, j in pairs]}
    whole: dict[str, Any] = {
        "twinmatch": lambda: nu_gap_matrix(
            [GraphSymbol.of_transfer_functions([m], 1.0) for m in models]
        )
    }
    if (nugap := peer("nugap")) is not None:
        systems = [nugap.tf(n, d, 1.0) for n, d in models]
        prepared["nugap"] = lambda: [
            nugap.nu_gap(systems[i], systems[j]) for i, j in pairs
        ]

        def peers_whole() -> list[float]:
            again = [nugap.tf(n, d, 1.0) for n, d in models]
            return [nugap.nu_gap(again[i], again[j]) for i, j in pairs]

        whole["nugap"] = peers_whole
    timings = measure_side_by_side(prepared, repeats)
    notes = {}
    if accurate:
        exact = [_reference(models[i], models[j]) for i, j in pairs]
        for name, timing in timings.items():
            errors = [
                abs(v - e) / e
                for v, e in zip(timing.result or [], exact, strict=False)
                if e != 1
            ]
            notes[name] = (
                f"largest relative error {max(map(float, errors), default=float('nan')):.1e}"
            )
    count = len(pairs)
    case = f"{count} pairs, one output, order {order}"
    rows = rows_of(
        "nu_gap",
        case,
        timings,
        targets={"twinmatch": count * 200e-6, "nugap": 5},
        notes=notes,
    )
    case = f"{PAIRS} models from coefficients to all gaps, one output, order {order}"
    return rows + rows_of("nu_gap", case, measure_side_by_side(whole, repeats))


def _two_outputs(order: int, repeats: int) -> list[Row]:
    """The work of a verdict: eight candidates, set-point to temperature and control."""
    rng = np.random.default_rng(order)
    symbols = [
        GraphSymbol.of_transfer_functions(
            [_model(rng, order, 1.0), _model(rng, order, 45.0)], 1.0
        )
        for _ in range(8)
    ]
    timings = measure_side_by_side(
        {"twinmatch": lambda: nu_gap_matrix(symbols)}, repeats
    )
    case = f"28 pairs of a family of eight, two outputs, order {order}"
    return rows_of("nu_gap", case, timings, targets={"twinmatch": 28 * 200e-6})


def _loop(repeats: int) -> list[Row]:
    """b(P, C), against 1/‖·‖∞ of the closed loop in python-control."""
    z = control.tf([1, 0], [1], 1.0)
    plant = 0.4 / (z - 0.97)
    pid = 1 + 0.038 / (z - 1) + 0.17 * (z - 1) / z
    symbols = [
        GraphSymbol.of_polynomials(t.den_array[0, 0], [t.num_array[0, 0]], 1.0)
        for t in (plant, pid)
    ]
    p = control.ss(plant)
    c = control.ss(pid)
    a = np.block([[p.A - p.B @ c.D @ p.C, -p.B @ c.C], [c.B @ p.C, c.A]])
    b = np.block([[p.B, -p.B @ c.D], [np.zeros_like(c.B), c.B]])
    seen = np.block([[p.C, np.zeros_like(c.C)], [-c.D @ p.C, -c.C]])
    loop = control.ss(a, b, seen, np.array([[0.0, 0.0], [1.0, -c.D.item()]]), 1.0)
    timings = measure_side_by_side(
        {
            "twinmatch": lambda: stability_margin(*symbols),
            "control": lambda: 1 / control.system_norm(loop, "inf", tol=1e-9),
        },
        repeats,
    )
    notes = {
        name: f"b = {timing.result:.9f}"
        for name, timing in timings.items()
        if timing.result is not None
    }
    return rows_of("nu_gap", "stability margin of a PID loop", timings, notes=notes)


def _matrices(repeats: int) -> list[Row]:
    """Two inputs and two outputs, four states: the gap of a pair, beside the largest of its two halves by the
    exact way; and the margin, beside 1/‖·‖∞ in python-control."""
    rng = np.random.default_rng(7)
    halves = [[_model(rng, 2, 1.0) for _ in range(2)] for _ in range(2)]
    symbols = [
        [GraphSymbol.of_transfer_functions([m], 1.0) for m in pair] for pair in halves
    ]
    plants = [
        StateSpace.of(
            control.append(*(control.ss(control.tf(*model, 1.0)) for model in pair))
        )
        for pair in halves
    ]
    gaps = measure_side_by_side(
        {
            "twinmatch": lambda: matrix_nu_gap(*plants),
            "twinmatch, exact": lambda: max(
                nu_gap(a, b) for a, b in zip(*symbols, strict=True)
            ),
        },
        repeats,
    )
    controller = StateSpace(
        np.eye(2), np.eye(2), 0.01 * np.eye(2), 0.3 * np.eye(2), 1.0
    )
    loop = closed_loop(plants[0], controller)
    whole = control.ss(loop.A, loop.B, loop.C, loop.D, 1.0) if loop else None
    margins = measure_side_by_side(
        {
            "twinmatch": lambda: matrix_margin(plants[0], controller),
            "control": lambda: 1 / control.system_norm(whole, "inf", tol=1e-9),
        },
        repeats,
    )
    rows = []
    for case, timings in (("ν-gap", gaps), ("margin", margins)):
        notes = {
            name: f"{timing.result:.10f}"
            for name, timing in timings.items()
            if timing.result is not None
        }
        rows += rows_of(
            "nu_gap",
            f"{case} of two inputs and outputs, four states",
            timings,
            notes=notes,
        )
    return rows


def _model(rng: np.random.Generator, order: int, gain: float) -> Fraction:
    """Slow and fast real poles, some pairs; numerator and denominator in z, highest power first."""
    poles: list[complex] = [1 - 10 ** rng.uniform(-3, -1.5)]
    while len(poles) < order:
        if order - len(poles) > 1 and rng.random() < 0.5:
            pole = rng.uniform(0.8, 0.99) * np.exp(1j * rng.uniform(0, 0.3))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(rng.uniform(0.2, 0.99))
    f = np.poly(poles).real
    b = np.poly(rng.uniform(0, 0.995, order - 1)).real
    return b * gain * rng.uniform(0.5, 1) * f.sum() / b.sum(), f


def _reference(p1: Fraction, p2: Fraction) -> Any:
    """With 50 digits: |P1 − P2|/√(1 + |P1|²)√(1 + |P2|²) sampled and refined; 1 if the winding fails."""
    with mp.workdps(50):
        exact = [[[mp.mpf(float(c)) for c in poly] for poly in p] for p in (p1, p2)]

        def distance(t: Any) -> Any:
            s = mp.mpc(0, mp.exp(t))
            at = (1 + s) / (1 - s)
            a, b = (mp.polyval(n, at) / mp.polyval(d, at) for n, d in exact)
            return abs(a - b) / mp.sqrt((1 + abs(a) ** 2) * (1 + abs(b) ** 2))

        nodes = [mp.mpf(k) / 10 for k in range(-110, 50)]
        values = [distance(t) for t in nodes]
        best = max(*values, distance(mp.mpf(-60)), distance(mp.mpf(60)))
        golden = (mp.sqrt(5) - 1) / 2
        for k in sorted(range(1, len(nodes) - 1), key=lambda k: -values[k])[:2]:
            low = nodes[k - 1]
            high = nodes[k + 1]
            for _ in range(60):
                left = high - golden * (high - low)
                right = low + golden * (high - low)
                if distance(left) > distance(right):
                    high = right
                else:
                    low = left
            best = max(best, distance((low + high) / 2))
        return best if _winding_holds(exact) else mp.mpf(1)


def _winding_holds(exact: list[list[list[Any]]]) -> bool:
    """Whether d2~ d1 + n2~ n1 has as many zeros inside the circle as the first model has poles."""
    (n1, d1), (n2, d2) = exact
    n1 = [mp.mpf(0)] * (len(d1) - len(n1)) + n1
    n2 = [mp.mpf(0)] * (len(d2) - len(n2)) + n2
    total = [mp.mpf(0)] * (len(d1) + len(d2) - 1)
    for first, second in ((d1, d2[::-1]), (n1, n2[::-1])):
        for i, x in enumerate(first):
            for j, y in enumerate(second):
                total[i + j] += x * y
    return bool(
        sum(abs(r) < 1 for r in mp.polyroots(total, maxsteps=500, extraprec=300))
        == len(d1) - 1
    )


if __name__ == "__main__":
    main(run, __doc__)
