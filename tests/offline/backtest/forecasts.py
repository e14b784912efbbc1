"""Forecasts and loops that tests of the report card are made from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinmatch.forecasting import CONFIDENCE, Band, Forecast
from twinmatch.signals import FloatArray, Window


def forecast_of(
    sample: int,
    output: Sequence[float] | FloatArray,
    entry: Sequence[float] | FloatArray,
    half: tuple[float, float] = (1.0, 1.0),
    forecaster: str = "somebody",
) -> Forecast:
    """A forecast with these means and bands of constant half width."""
    y = np.asarray(output, dtype=float)
    u = np.asarray(entry, dtype=float)
    return Forecast(
        sample=sample,
        candidate=forecaster,
        structure="",
        confidence=CONFIDENCE,
        time=np.arange(1.0, y.size + 1.0),
        references=np.zeros(y.size),
        outputs=(Band(y, y - half[0], y + half[0]),),
        inputs=(Band(u, u - half[1], u + half[1]),),
    )


def set_points(
    samples: int, seed: int, levels: tuple[int, int] = (30, 80)
) -> FloatArray:
    """Set-points between two levels in °C; each lasts 50 to 150 samples."""
    random = np.random.default_rng(seed)
    references: list[float] = []
    while len(references) < samples:
        references += [float(random.integers(*levels))] * int(random.integers(50, 150))
    return np.array(references[:samples])


def linear_loop(
    reference: FloatArray, random: np.random.Generator, past: Window | None = None
) -> Window:
    """A first-order plant under a PI controller, with noise inside the loop; it continues from a past.

    y[k] = 0.95 y[k−1] + 0.02 u[k−1] + 1 + 0.1 e[k]; u[k] = u[k−1] + 8 (ε[k] − 0.9 ε[k−1]) + 2 v[k] with
    ε = r − y, which is an ARX loop of order 1, limits aside.
    """
    y, u, r = (
        (past.output[-1], past.input[-1], past.reference[-1])
        if past
        else (reference[0], 0.0, reference[0])
    )
    outputs = []
    entries = []
    for wanted in reference:
        new = 0.95 * y + 0.02 * u + 1.0 + 0.1 * random.standard_normal()
        u += 8.0 * ((wanted - new) - 0.9 * (r - y)) + 2.0 * random.standard_normal()
        u = float(np.clip(u, -255.0, 255.0))
        y = new
        r = wanted
        outputs.append(y)
        entries.append(u)
    return Window(
        reference,
        np.array(outputs),
        np.array(entries),
        first=past.last + 1 if past else 0,
    )
