"""Box–Jenkins: the ladder of orders beside the peers, growth with N, error on a known truth.

    python -m benchmarks.box_jenkins [--quick] [--recording FILE] [--json OUT]

Without a recording the rig is simulated. The peers assume that the data begin at rest; the notes give their
loss on that assumption, and the loss of the same coefficients with the best initial conditions. A ladder that
takes longer than its limit is stopped between two orders: its ratio is then a lower bound. statsmodels has no
B/F and uses delayed inputs and ARMA errors instead. SIPPY (LGPL) and the others are used here only; the
package imports none of them.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from benchmarks.box_jenkins_peers import Fit, missing, own, peers
from benchmarks.common import Row, document, measure_side_by_side, print_rows, rows_of
from benchmarks.rig import recorded
from twinmatch.fitting import ORDERS, BoxJenkins, estimate, estimate_ladder
from twinmatch.importing import open_any
from twinmatch.signals import FloatArray, Sample

NAME = "box_jenkins"
SHORT = 500
LONG = 3600
LIMIT = 4.0
"""Time after which a peer's ladder stops at its present order, s."""
NO_HOPS = "twinmatch, no hops"
"""The minimum next to the start values, as used in a verdict."""
MODEL_TARGETS = {SHORT: 0.010, LONG: 0.040}
SIPPY_TARGET = 50.0
MAX_COUNT = {"sippy_unipi": 300, "timeseries-toolbox": 1000}
"""Longest record on which a slow peer is compared with the truth."""
GROWTH = (600, 1200, 3600, 12000, 36000)

B = np.array([0.0, 1.0, 0.5])
C = np.array([1.0, 0.7, 0.2])
D = np.array([1.0, -1.2, 0.5])
F = np.array([1.0, -1.5, 0.7])


class Ladder(NamedTuple):
    """Result of a program's ladder: losses by order, and those of its coefficients with the best start."""

    losses: dict[str, float]
    best: dict[str, float]
    stopped: bool


def run(quick: bool) -> list[Row]:
    """Every part, on the simulated rig."""
    return run_on(recorded(GROWTH[-1] if not quick else GROWTH[2]), quick)


def run_on(samples: Sequence[Sample], quick: bool) -> list[Row]:
    """Every part, the ladder and the growth on these samples."""
    rows: list[Row] = []
    for count in (SHORT,) if quick else (SHORT, LONG):
        for name, u, y in _pairs(samples[:count]):
            rows += _single(name, u, y, quick)
            rows += _ladder(name, u, y, quick)
    return rows + _growth(samples, quick) + _truth(quick)


def _pairs(samples: Sequence[Sample]) -> list[tuple[str, FloatArray, FloatArray]]:
    """Set-point to temperature and, one tick early, to control, as deviations from the start."""
    r, y, u = np.array([(s.reference, s.output, s.input) for s in samples]).T
    ahead = np.append(r[1:], r[-1]) - r[0]
    return [
        (f"r → y, N = {r.size}", r - r[0], y - r[0]),
        (f"r → u, N = {r.size}", ahead, u - u[0]),
    ]


def _single(name: str, u: FloatArray, y: FloatArray, quick: bool) -> list[Row]:
    rows = []
    for order in (ORDERS[0], ORDERS[-1]):
        cases = {
            "twinmatch": lambda o=order: estimate(u, y, o),
            NO_HOPS: lambda o=order: estimate(u, y, o, hops=0),
        }
        timings = measure_side_by_side(cases, 3 if quick else 9)
        notes = {
            name: f"V {timing.result.variance:.4g}" for name, timing in timings.items()
        }
        targets = (
            {"twinmatch": MODEL_TARGETS.get(u.size, math.nan)}
            if u.size in MODEL_TARGETS
            else {}
        )
        case = f"one model {order}, {name}"
        rows += rows_of(NAME, case, timings, targets=targets, notes=notes)
    return rows


def _ladder(name: str, u: FloatArray, y: FloatArray, quick: bool) -> list[Row]:
    programs = {} if quick else peers()
    cases: dict[str, Callable[[], object]] = {
        "twinmatch": lambda: _own_ladder(u, y),
        NO_HOPS: lambda: _own_ladder(u, y, hops=0),
    }
    for peer, program in programs.items():
        cases[peer] = partial(_peer_ladder, program, u, y)
    timings = measure_side_by_side(cases, 3 if quick else 5, patience=2.0)
    notes = {
        peer: _note(t.result)
        for peer, t in timings.items()
        if isinstance(t.result, Ladder)
    }
    case = f"ladder, {name}"
    rows = rows_of(
        NAME, case, timings, targets={"sippy_unipi": SIPPY_TARGET}, notes=notes
    )
    return rows + [
        Row(NAME, case, peer, math.nan, note="not installed") for peer in missing()
    ]


def _own_ladder(u: FloatArray, y: FloatArray, hops: int | None = None) -> Ladder:
    losses = {
        order: model.variance
        for order, model in estimate_ladder(u, y, hops=hops).items()
    }
    return Ladder(losses, losses, False)


def _peer_ladder(
    program: Callable[[FloatArray, FloatArray, str], Fit], u: FloatArray, y: FloatArray
) -> Ladder:
    begin = time.perf_counter()
    losses: dict[str, float] = {}
    best: dict[str, float] = {}
    for order in ORDERS:
        if time.perf_counter() - begin > LIMIT:
            return Ladder(losses, best, True)
        try:
            fit = program(u, y, order)
        except Exception:
            losses[order] = best[order] = math.inf
            continue
        losses[order] = fit.loss
        best[order] = (
            math.nan if fit.model is None else _with_best_start(fit.model, u, y)
        )
    return Ladder(losses, best, False)


def _with_best_start(model: BoxJenkins, u: FloatArray, y: FloatArray) -> float:
    with np.errstate(all="ignore"):
        loss = model.loss(u, y)
    return loss if math.isfinite(loss) else math.inf


def _note(ladder: Ladder) -> str:
    text = "V " + " ".join(f"{loss:.4g}" for loss in ladder.losses.values())
    if ladder.best is not ladder.losses and not all(
        math.isnan(v) for v in ladder.best.values()
    ):
        text += "; best start " + " ".join(
            f"{loss:.4g}" for loss in ladder.best.values()
        )
    return text + ("; stopped by the limit" if ladder.stopped else "")


def _growth(samples: Sequence[Sample], quick: bool) -> list[Row]:
    counts = [n for n in GROWTH if n <= len(samples)]
    pairs = {n: _pairs(samples[:n])[0] for n in counts}
    cases = {
        f"N = {n}": lambda p=p: estimate(p[1], p[2], "33331") for n, p in pairs.items()
    }
    timings = measure_side_by_side(cases, 2 if quick else 5)
    per_sample = {f"N = {n}": timings[f"N = {n}"].median / n for n in counts}
    notes = {
        case: f"{value * 1e6:.3g} µs a sample" for case, value in per_sample.items()
    }
    return rows_of(
        NAME, "growth, one model 33331", timings, own=f"N = {counts[0]}", notes=notes
    )


def _truth(quick: bool) -> list[Row]:
    """Median error of B/F over seeds: ‖Ĝ − G‖ / ‖G‖ on the unit circle."""
    programs = {"twinmatch": own} | ({} if quick else peers())
    programs.pop("statsmodels", None)  # no B/F to compare
    rows = []
    for kind in ("white noise", "coloured noise", "closed loop"):
        for count in (300,) if quick else (300, 1000, 10000):
            taking = {
                n: p for n, p in programs.items() if count <= MAX_COUNT.get(n, count)
            }
            seeds = range(3 if quick or count > 1000 else 5)
            for name, program in taking.items():
                begin = time.perf_counter()
                errors = [_error(program, *_data(kind, count, seed)) for seed in seeds]
                seconds = (time.perf_counter() - begin) / len(errors)
                note = f"error of B/F {100.0 * float(np.median(errors)):.3g} %"
                rows.append(
                    Row(
                        NAME,
                        f"truth, {kind}, N = {count}",
                        name,
                        seconds,
                        None,
                        len(errors),
                        None,
                        note,
                    )
                )
    return rows


def _error(
    program: Callable[[FloatArray, FloatArray, str], Fit], u: FloatArray, y: FloatArray
) -> float:
    try:
        model = program(u, y, "22221").model
    except Exception:
        return 1.0
    if model is None:
        return 1.0
    z = np.exp(-1j * np.linspace(0.01, np.pi, 400))
    true = np.polyval(B[::-1], z) / np.polyval(F[::-1], z)
    found = np.polyval(model.B[::-1], z) / np.polyval(model.F[::-1], z)
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def _data(kind: str, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """A record that begins in the middle of a run, like every window of a running loop."""
    rng = np.random.default_rng(seed)
    total = count + 200
    drive = np.repeat(rng.choice([-1.0, 1.0], size=total // 4 + 1), 4)[:total]
    e = 0.5 * rng.standard_normal(total)
    if kind != "closed loop":
        noise = e if kind == "white noise" else lfilter(C, D, e)
        return drive[200:], (lfilter(B, F, drive) + noise)[200:]
    noise = lfilter(C, D, 0.4 * e)
    u = np.zeros(total)
    w = np.zeros(total)
    y = np.zeros(total)
    for t in range(2, total):
        w[t] = B[1] * u[t - 1] + B[2] * u[t - 2] - F[1] * w[t - 1] - F[2] * w[t - 2]
        y[t] = w[t] + noise[t]
        u[t] = 0.15 * (drive[t] - y[t])
    return u[200:], y[200:]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="small cases, no peers: does it run?"
    )
    parser.add_argument(
        "--recording", type=Path, metavar="FILE", help="your own session or recording"
    )
    parser.add_argument(
        "--json",
        type=Path,
        metavar="OUT",
        help="write environment and rows to this file",
    )
    options = parser.parse_args()
    if options.recording is None:
        rows = run(options.quick)
    else:
        rows = run_on(open_any(options.recording).samples, options.quick)
    print_rows((__doc__ or "").splitlines()[0], rows)
    if options.json is not None:
        text = json.dumps(document(rows), indent=1, allow_nan=False, ensure_ascii=False)
        options.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
