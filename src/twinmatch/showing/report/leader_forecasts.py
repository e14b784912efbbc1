"""Some forecasts of the leader, each compared with the measurements: for a figure and its table."""

from __future__ import annotations

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast
from twinmatch.offline.backtest import Backtest
from twinmatch.offline.judgement import Judgement
from twinmatch.showing.fan import Fan, fan
from twinmatch.showing.quantities import number
from twinmatch.showing.report.table import Cell, Table, head, words
from twinmatch.showing.words import with_unit, words_of
from twinmatch.signals import FloatArray

__all__ = ["fans_of", "leader_forecast_table"]

_SHOWN = 6
"""So many fit into one figure."""


def fans_of(tested: Backtest, judgement: Judgement) -> tuple[Fan, ...]:
    """The leader's forecasts during which the set-point (or the input) moved most, in order of time."""
    hardest = sorted(tested.shown, key=_moved, reverse=True)[:_SHOWN]
    return tuple(
        fan(forecast, judgement.samples, judgement.settings.period)
        for forecast in sorted(hardest, key=lambda f: f.sample)
    )


def leader_forecast_table(fans: tuple[Fan, ...], plant: type[Plant]) -> Table | None:
    """The same in numbers; None without forecasts."""
    if not fans:
        return None
    called, y, closed = words_of(plant), words_of(plant).output_unit, fans[0].forecast.closed
    columns = (
        "made at / s",
        "by",
        with_unit("set-points", y) if closed else with_unit("inputs", called.input_unit),
        with_unit("forecast at its end", y),
        with_unit("measured", y),
        with_unit("RMS error", y),
        f"{called.output} within band",
        *([f"{called.input} within band"] if closed else []),
    )
    return Table(
        "Forecasts of the leader, and the measurements",
        columns,
        tuple(_row(one, plant.output.decimals) for one in fans),
    )


def _moved(forecast: Forecast) -> float:
    """Range of the set-points (or inputs) that the forecast is made for."""
    asked = _asked(forecast)
    return float(np.ptp(asked)) if asked.size else 0.0


def _asked(forecast: Forecast) -> FloatArray:
    """The set-points (or inputs) that the forecast is made for."""
    return forecast.reference if forecast.closed else forecast.input.mean


def _row(one: Fan, decimals: int) -> tuple[Cell, ...]:
    forecast, band = one.forecast, one.forecast.output
    shown = one.held if forecast.closed else one.held[:1]
    held = [f"{100 * float(np.mean(part)):.0f} %" if part.size else "–" for part in shown]
    measured = "–" if one.came is None else number(float(one.came.output[-1]), decimals)
    error = float(np.sqrt(np.mean(np.square(one.error)))) if one.judged else float("nan")
    ends = f"{number(float(band.low[-1]), decimals)} to {number(float(band.high[-1]), decimals)}"
    return (
        head(number(forecast.sample * one.past.period, 0)),
        words(forecast.candidate),
        words(_levels(forecast)),
        Cell(ends),
        Cell(measured),
        Cell(number(error, decimals + 1)),
        *(Cell(share) for share in held),
    )


def _levels(forecast: Forecast) -> str:
    """The set-points or inputs in order; of more than four, the first and the last."""
    reference = _asked(forecast)
    levels = [reference[0], *reference[1:][np.diff(reference) != 0]]
    shown = levels if len(levels) <= 4 else [levels[0], levels[-1]]
    return (" → " if shown is levels else " … ").join(f"{level:g}" for level in shown)
