"""The newest forecast in figures, for programs: at its horizons, and how often its bands have held."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twinmatch.description import Quantity
from twinmatch.showing.page.state import DashboardState


class PointAhead(NamedTuple):
    """The leader's forecast of one signal at a horizon (s), in the signal's unit."""

    signal: Quantity
    horizon: float
    mean: float
    low: float
    high: float


def ahead(state: DashboardState) -> list[PointAhead]:
    """The newest forecast at the horizons of the verdict, or, before the first verdict, at its end.

    At each horizon, the outputs are followed by the inputs.
    """
    forecast = state.current_forecast
    described = state.described
    points = []
    if forecast is None or not forecast.time.size:
        return []
    for horizon in (state.verdict and state.verdict.horizons) or (
        float(forecast.time[-1]),
    ):
        k = int(np.argmin(np.abs(forecast.time - horizon)))
        for kind, bands in (
            (described.outputs, forecast.outputs),
            (described.inputs, forecast.inputs),
        ):
            for signal, band in zip(kind, bands, strict=False):
                edges = (float(edge[k]) for edge in (band.mean, band.low, band.high))
                points.append(PointAhead(signal, horizon, *edges))
    return points


def coverage(state: DashboardState) -> dict[float, float]:
    """Share of the readings that the leader's bands have held, by horizon (s), where it is known."""
    leading = state.verdict and state.verdict.leading
    shares = (
        zip(state.verdict.horizons, leading.coverage, strict=False)
        if state.verdict and leading
        else ()
    )
    return {horizon: share for horizon, share in shares if not math.isnan(share)}
