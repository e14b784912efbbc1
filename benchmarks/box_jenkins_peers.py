"""The peers of the Box–Jenkins benchmark, each used as well as it allows, with one signature."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable
from typing import NamedTuple

import control
import numpy as np
import scipy.linalg

from benchmarks.common import peer
from twinmatch.fitting import BoxJenkins, parse_order
from twinmatch.fitting.data import Order
from twinmatch.signals import FloatArray

__all__ = ["Fit", "missing", "own", "peers"]

MODULES = {
    "sippy_unipi": "sippy_unipi",
    "timeseries-toolbox": "TimeSeriesSRC",
    "pysid": "pysid",
    "statsmodels": "statsmodels.api",
}

DELAYED = 12
"""Number of delayed inputs in place of B/F, for programs without a denominator."""


class Fit(NamedTuple):
    """The result of a program."""

    loss: float
    """Mean squared one-step prediction error, as reported by the program or computed from rest."""
    model: BoxJenkins | None
    """Its coefficients; None if it has no B/F."""


Program = Callable[[FloatArray, FloatArray, str], Fit]


def own(u: FloatArray, y: FloatArray, order: str) -> Fit:
    from twinmatch.fitting import estimate  # noqa: PLC0415

    model = estimate(u, y, order)
    return Fit(model.variance, model)


def peers() -> dict[str, Program]:
    """The installed peers by name. SIPPY is LGPL: used here for comparison, never imported by the package."""
    programs = (_sippy, _toolbox, _pysid, _statsmodels)
    known = zip(MODULES.items(), programs, strict=True)
    return {
        name: program for (name, module), program in known if peer(module) is not None
    }


def missing() -> list[str]:
    """Names of those that are not installed."""
    return [name for name, module in MODULES.items() if peer(module) is None]


def _fit(
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    F: FloatArray,
    *,
    u: FloatArray,
    y: FloatArray,
) -> Fit:
    """The coefficients as a model, and its loss from rest, which these programs assume."""
    delay = int(np.argmax(B != 0.0))
    order = Order(B.size - delay, C.size - 1, D.size - 1, F.size - 1, delay)
    start = np.zeros(order.predictor_state)
    model = BoxJenkins(order, B / F[0], C, D, F / F[0], math.nan, start, n_samples=0)
    with np.errstate(all="ignore"):
        loss = model.loss(u, y, "zero")
    return Fit(loss if math.isfinite(loss) else math.inf, model)


def _sippy(u: FloatArray, y: FloatArray, order: str) -> Fit:
    from sippy_unipi import system_identification  # noqa: PLC0415

    nb, nc, nd, nf, nk = parse_order(order)
    with contextlib.redirect_stdout(io.StringIO()):
        found = system_identification(
            y, u, "BJ", BJ_orders=[nb, nc, nd, nf, nk - 1], max_iterations=300
        )
    G = found.G
    H = found.H
    B, F = _delay_form(G)
    C, D = _delay_form(H)
    return _fit(B, C, D, F, u=u, y=y)


def _delay_form(system: control.TransferFunction) -> tuple[FloatArray, FloatArray]:
    """Numerator and denominator in q⁻¹ of a transfer function in z."""
    numerator = np.trim_zeros(np.asarray(system.num[0][0], dtype=np.float64), "f")
    denominator = np.trim_zeros(np.asarray(system.den[0][0], dtype=np.float64), "f")
    lead = np.zeros(max(denominator.size - numerator.size, 0))
    return np.concatenate((lead, numerator)) / denominator[
        0
    ], denominator / denominator[0]


def _toolbox(u: FloatArray, y: FloatArray, order: str) -> Fit:
    from TimeSeriesSRC.Model.estimate import estimate  # noqa: PLC0415
    from TimeSeriesSRC.Model.model import pmodel  # noqa: PLC0415

    nb, nc, nd, nf, nk = parse_order(order)
    np.random.seed(1)
    with contextlib.redirect_stdout(io.StringIO()):
        program = pmodel(
            "bjtf", nb=[nb - 1], nf=[nf], nc=[nc], nd=[nd], delay=[nk], diff=[0], per=[]
        )
        program.estimParams.epochs = 100
        program, *_ = estimate(program, y, u, show_plot=False, show_output=False)
    parts = [
        np.ravel(np.asarray(part[0], dtype=np.float64))
        for part in (program.b, program.c, program.d, program.f)
    ]
    B = np.concatenate((np.zeros(nk), parts[0]))
    return _fit(
        B,
        *(_monic(part, n) for part, n in zip(parts[1:], (nc, nd, nf), strict=True)),
        u=u,
        y=y,
    )


def _pysid(u: FloatArray, y: FloatArray, order: str) -> Fit:
    from pysid.identification import solvers  # noqa: PLC0415
    from pysid.identification.pemethod import bj  # noqa: PLC0415

    # It passes columns to scipy's toeplitz, which flattened them before scipy 1.17.
    solvers.toeplitz = lambda c, r: scipy.linalg.toeplitz(np.ravel(c), np.ravel(r))
    nb, nc, nd, nf, nk = parse_order(order)
    with np.errstate(all="ignore"):
        found = bj(nb - 1, nc, nd, nf, nk, u.reshape(-1, 1), y.reshape(-1, 1))
    B, C, D, F = (_polynomial(getattr(found, name)) for name in "BCDF")
    if B.size == nb:
        B = np.concatenate((np.zeros(nk), B))
    return _fit(B, C, D, F, u=u, y=y)


def _polynomial(value: object) -> FloatArray:
    while (
        isinstance(value, (list, np.ndarray))
        and np.asarray(value, dtype=object).ndim > 0
    ):
        flat = np.asarray(value, dtype=object).ravel()
        if all(np.ndim(v) == 0 for v in flat):
            return np.asarray(flat, dtype=np.float64)
        value = flat[0]
    return np.atleast_1d(np.asarray(value, dtype=np.float64))


def _monic(part: FloatArray, degree: int) -> FloatArray:
    return part if part.size == degree + 1 else np.concatenate((np.ones(1), part))


def _statsmodels(u: FloatArray, y: FloatArray, order: str) -> Fit:
    """Regression on delayed inputs with ARMA errors: it has no B/F."""
    import warnings  # noqa: PLC0415

    import statsmodels.api as sm  # noqa: PLC0415

    _, nc, nd, _, nk = parse_order(order)
    delayed = np.column_stack(
        [
            np.concatenate((np.zeros(k), u[: u.size - k]))
            for k in range(nk, nk + DELAYED)
        ]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = sm.tsa.SARIMAX(y, exog=delayed, order=(nd, 0, nc)).fit(
            disp=False, maxiter=50
        )
    return Fit(float(np.mean(np.asarray(found.resid) ** 2)), None)
