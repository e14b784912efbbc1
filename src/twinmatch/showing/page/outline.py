"""What the state comes down to, for programs: trust, the forecast at its horizons, coverage, faults."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twinmatch.comparing import TrustLevel
from twinmatch.description import Quantity
from twinmatch.showing.page.state import DashboardState, drive_fault


class PointAhead(NamedTuple):
    """The leader's forecast of one signal at a horizon (s), in the signal's unit."""

    signal: Quantity
    horizon: float
    mean: float
    low: float
    high: float


def level(state: DashboardState) -> TrustLevel:
    """The level of the newest verdict."""
    return TrustLevel.UNKNOWN if state.verdict is None else state.verdict.level


def trusted_ahead(state: DashboardState) -> float:
    """The longest horizon at which the leader's forecasts are trusted now, s; 0: at none."""
    trusted = state.verdict and level(state) is TrustLevel.TRUSTED and state.verdict.trusted
    return max(trusted or (0.0,))


def ahead(state: DashboardState) -> list[PointAhead]:
    """The newest forecast at the horizons of the verdict, or, before the first verdict, at its end.

    At each horizon, the outputs are followed by the inputs.
    """
    forecast = state.current_forecast
    described = state.described
    points = []
    if forecast is None or not forecast.time.size:
        return []
    for horizon in (state.verdict and state.verdict.horizons) or (float(forecast.time[-1]),):
        k = int(np.argmin(np.abs(forecast.time - horizon)))
        for kind, bands in ((described.outputs, forecast.outputs), (described.inputs, forecast.inputs)):
            for signal, band in zip(kind, bands, strict=False):
                edges = (float(edge[k]) for edge in (band.mean, band.low, band.high))
                points.append(PointAhead(signal, horizon, *edges))
    return points


def coverage(state: DashboardState) -> dict[float, float]:
    """Share of the readings that the leader's bands have held, by horizon (s), where it is known."""
    leading = state.verdict and state.verdict.leading
    shares = zip(state.verdict.horizons, leading.coverage, strict=False) if state.verdict and leading else ()
    return {horizon: share for horizon, share in shares if not math.isnan(share)}


def faults(state: DashboardState) -> list[tuple[str, str]]:
    """The faults that are on, each with the name of the signal that it concerns, or an empty one: that of the
    newest verdict, and what holds or limits the output."""
    verdict = state.verdict
    faults_on = [(verdict.fault, verdict.fault_signal)] if verdict is not None and verdict.fault else []
    return [*faults_on, (drive_fault(state.fault)[0], "")] if state.fault else faults_on
