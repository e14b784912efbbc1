"""Some forecasts of the leader, each against what came: for a picture and its table."""

from __future__ import annotations

import numpy as np

from twinmatch.backtest import Backtest
from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast
from twinmatch.judging.judgement import Judgement
from twinmatch.reporting.table import Cell, Table, head, words
from twinmatch.signals import FloatArray
from twinmatch.views.fan import Fan, fan
from twinmatch.views.quantities import number
from twinmatch.views.words import with_unit, words_of

__all__ = ["fans_of", "foretold_table"]

_SHOWN = 6
"""So many fit into one picture."""


def fans_of(tested: Backtest, judgement: Judgement) -> tuple[Fan, ...]:
    """Of the leader's forecasts those over whose time the set-point (or the input) moved most, in the order
    of time."""
    harder = sorted(tested.shown, key=_moved, reverse=True)[:_SHOWN]
    return tuple(
        fan(forecast, judgement.samples, judgement.settings.period)
        for forecast in sorted(harder, key=lambda f: f.sample)
    )


def foretold_table(fans: tuple[Fan, ...], plant: type[Plant]) -> Table | None:
    """The same in figures; None without any."""
    if not fans:
        return None
    called, y, closed = words_of(plant), words_of(plant).output_unit, fans[0].forecast.closed
    columns = (
        "made at / s",
        "by",
        with_unit("set-points", y) if closed else with_unit("inputs", called.input_unit),
        with_unit("foretold for its end", y),
        with_unit("came", y),
        with_unit("off, RMS", y),
        f"{called.output} held",
        *([f"{called.input} held"] if closed else []),
    )
    return Table(
        "What it foretold, and what came", columns, tuple(_row(one, plant.output.decimals) for one in fans)
    )


def _moved(forecast: Forecast) -> float:
    """How far what it is made for moves while the forecast lasts, or just as it begins."""
    asked = _asked(forecast)
    return float(np.ptp(asked)) if asked.size else 0.0


def _asked(forecast: Forecast) -> FloatArray:
    """The set-points it is made for, or the inputs."""
    return forecast.reference if forecast.closed else forecast.input.mean


def _row(one: Fan, decimals: int) -> tuple[Cell, ...]:
    forecast, band = one.forecast, one.forecast.output
    shown = one.held if forecast.closed else one.held[:1]
    held = [f"{100 * float(np.mean(part)):.0f} %" if part.size else "–" for part in shown]
    came = "–" if one.came is None else number(float(one.came.output[-1]), decimals)
    off = float(np.sqrt(np.mean(np.square(one.error)))) if one.judged else float("nan")
    ends = f"{number(float(band.low[-1]), decimals)} to {number(float(band.high[-1]), decimals)}"
    return (
        head(number(forecast.sample * one.past.period, 0)),
        words(forecast.candidate),
        words(_levels(forecast)),
        Cell(ends),
        Cell(came),
        Cell(number(off, decimals + 1)),
        *(Cell(share) for share in held),
    )


def _levels(forecast: Forecast) -> str:
    """The set-points or inputs in their order; of many the first and the last."""
    reference = _asked(forecast)
    levels = [reference[0], *reference[1:][np.diff(reference) != 0]]
    shown = levels if len(levels) <= 4 else [levels[0], levels[-1]]
    return (" → " if shown is levels else " … ").join(f"{level:g}" for level in shown)
