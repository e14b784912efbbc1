"""Forecasts in words, also beside what was measured, and as dictionaries for JSON."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import (
    NEAR,
    Band,
    Forecast,
    Moment,
    horizons_for,
    largest_input,
    settling_time,
    time_to_reach,
)
from twinmatch.showing.quantities import number, signal_names
from twinmatch.showing.series import Fan, root_mean_square
from twinmatch.signals import FloatArray

__all__ = ["asked", "comparison_words", "forecast_document", "forecast_words", "levels_words"]

_MOST_LEVELS: Final = 4
"""With more set-points in a row, only the last is described."""


def forecast_document(forecast: Forecast) -> dict[str, Any]:
    """A forecast with its bands, sample by sample; every value is a string, number, list or dictionary."""
    return {
        "sample": forecast.sample,
        "candidate": forecast.candidate,
        "structure": forecast.structure,
        "confidence": forecast.confidence,
        "t": forecast.time.tolist(),
        "y": _band(forecast.output),
        "u": _band(forecast.input),
        "reference": forecast.reference.tolist() if forecast.closed else None,
        "notes": list(forecast.notes),
    }


def forecast_words(forecast: Forecast, plant: type[Plant]) -> list[str]:
    """The forecast in lines: final output, arrival at each set-point, largest input, widths of the band;
    for prescribed inputs only final output and widths."""
    if not forecast.closed:
        return [_end(forecast, plant), _widths(forecast, plant)]
    parts = _parts(forecast)
    if len(parts) > _MOST_LEVELS:
        parts = parts[-1:]
    arrivals = [_arrival(part, plant, only=len(parts) == 1) for part in parts]
    return [_end(forecast, plant), *arrivals, _largest(forecast, plant), _widths(forecast, plant)]


def asked(forecast: Forecast) -> FloatArray:
    """The set-points (or inputs) that the forecast is made for."""
    return forecast.reference if forecast.closed else forecast.input.mean


def levels_words(forecast: Forecast) -> str:
    """The set-points or inputs in order; of more than four, the first and the last."""
    values = asked(forecast)
    levels = [values[0], *values[1:][np.diff(values) != 0]]
    if len(levels) > _MOST_LEVELS:
        return f"{levels[0]:g} … {levels[-1]:g}"
    return " → ".join(f"{level:g}" for level in levels)


def comparison_words(fan: Fan, plant: type[Plant]) -> list[str]:
    """How it compares with the measurements, in one line; empty where there are none to compare with."""
    if not fan.judged:
        return []
    signals = signal_names(plant)
    shares = [f"{100 * np.mean(inside):.0f} % of the" for inside in fan.in_band if inside.size]
    inside = " and ".join(f"{s} {w}" for s, w in zip(shares, (signals.output, signals.input), strict=False))
    moves = "set-points" if fan.forecast.closed else "inputs"
    same = "" if fan.judged == fan.forecast.time.size else f", under the same {moves}"
    return [
        f"compared with the next {fan.judged * fan.past.period:g} s of measurements{same}: error "
        f"{signals.y(root_mean_square([fan.error]), finer=1)} RMS; the band contained {inside}"
    ]


def _band(band: Band) -> dict[str, list[float]]:
    return {"mean": band.mean.tolist(), "low": band.low.tolist(), "high": band.high.tolist()}


def _end(forecast: Forecast, plant: type[Plant]) -> str:
    signals, band = signal_names(plant), forecast.output
    low, mean, high = (float(edge[-1]) for edge in (band.low, band.mean, band.high))
    return (
        f"{signals.output} after {forecast.time[-1]:g} s: {signals.y(mean)}, within {signals.y(low, high)} "
        f"in {100 * forecast.confidence:.0f} % of such cases"
    )


def _parts(forecast: Forecast) -> list[Forecast]:
    """The forecast in parts with a constant set-point."""
    steps = np.flatnonzero(np.diff(forecast.reference)) + 1
    ends = [*steps.tolist(), forecast.time.size]
    return [_part(forecast, first, end) for first, end in zip([0, *ends], ends, strict=False)]


def _part(forecast: Forecast, first: int, end: int) -> Forecast:
    of = slice(first, end)
    output, entry = (Band(b.mean[of], b.low[of], b.high[of]) for b in (forecast.output, forecast.input))
    return replace(
        forecast, time=forecast.time[of], reference=forecast.reference[of], output=output, input=entry
    )


def _arrival(part: Forecast, plant: type[Plant], *, only: bool) -> str:
    """When the output reaches one set-point, and whether it stays there."""
    unit, level = plant.output.unit, float(part.reference[0])
    near = NEAR * plant.output.noise
    goal = f"within {_with(f'{near:g}', unit)} of {_with(f'{level:g}', unit)}"
    if not only:
        goal += f" (set-point from {part.time[0]:g} to {part.time[-1]:g} s)"
    reached, held = time_to_reach(part, level, near), settling_time(part, level, near)
    if reached.expected is None:
        return f"{goal}: not in that time{_at_best(reached)}"
    if reached.expected == held.expected == part.time[0]:
        return f"{goal}: all the time{_surely(held)}"
    first = f"{goal}: first after {reached.expected:g} s{_range(reached)}"
    if held.expected is None:
        return f"{first}, but it does not stay there"
    if held.expected == reached.expected:
        return f"{first}, and it stays there"
    return f"{first}, permanently after {held.expected:g} s{_range(held)}"


def _largest(forecast: Forecast, plant: type[Plant]) -> str:
    signals, peak = signal_names(plant), largest_input(forecast)
    least, most = (number(edge, signals.input_decimals) for edge in (peak.least, peak.most))
    return f"largest {signals.input}: {signals.u(peak.expected)} after {peak.time:g} s ({least} to {most})"


def _widths(forecast: Forecast, plant: type[Plant]) -> str:
    signals, widths = signal_names(plant), []

    def width(k: int) -> str:
        y, u = (float(band.high[k] - band.low[k]) for band in (forecast.output, forecast.input))
        return f"{signals.y(y)} and {signals.u(u)}" if forecast.closed else signals.y(y)

    for horizon in horizons_for(float(forecast.time[0])):
        if horizon > forecast.time[-1] + 1e-9 * horizon or horizon < forecast.time[0]:
            continue
        k = int((forecast.time <= horizon * (1 + 1e-9)).sum()) - 1
        widths.append(f"{width(k)} at {horizon:g} s")
    if not widths:
        y = float(forecast.output.high[-1] - forecast.output.low[-1])
        widths.append(f"{signals.y(y)} at the end")
    return f"width of the band: {'; '.join(widths)}"


def _at_best(moment: Moment) -> str:
    return "" if moment.earliest is None else f"; at the edge of the band after {moment.earliest:g} s"


def _surely(moment: Moment) -> str:
    return "" if moment.latest == moment.expected else ", though the band reaches further"


def _range(moment: Moment) -> str:
    """The earliest and latest time in brackets."""
    first = "0" if moment.earliest is None else f"{moment.earliest:g}"
    return f" ({first} to {moment.latest:g})" if moment.latest is not None else f" ({first} or later)"


def _with(text: str, unit: str) -> str:
    return f"{text} {unit}".rstrip()
