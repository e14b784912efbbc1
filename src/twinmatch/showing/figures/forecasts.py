"""Forecasts with their bands, compared with the measurements."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE
from twinmatch.showing.figures.drawing import draw_set_point, empty, new_figure, styled
from twinmatch.showing.quantities import signal_names, with_unit
from twinmatch.showing.series import Fan
from twinmatch.showing.style import CLOSED, PLANT, SET_POINT

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_forecasts"]

_COLUMNS = 3
"""Most panels side by side."""
_LETTERS = 36
"""Characters per line of a name above a panel."""
_BAND = f"{100 * CONFIDENCE:.0f} % band"


@styled
def draw_forecasts(fans: Sequence[Fan], plant: type[Plant]) -> Figure:
    """One panel per forecast: output, forecast error, and input, around its sample."""
    columns = min(max(len(fans), 1), _COLUMNS)
    rows = max(-(-len(fans) // columns), 1)
    figure = new_figure(10 if columns > 1 else 7.5, 4.2 * rows + 0.4)
    if not fans:
        empty(figure.add_subplot(), "no forecast was made")
        return figure
    grids = figure.add_gridspec(rows, columns, wspace=0.04, hspace=0.06)
    for k, fan in enumerate(fans):
        inner = grids[k // columns, k % columns].subgridspec(3, 1, height_ratios=(3, 1.6, 2))
        output = figure.add_subplot(inner[0])
        error, control = (figure.add_subplot(inner[row], sharex=output) for row in (1, 2))
        _draw(output, control, fan)
        _draw_error(error, fan)
        if k % columns == 0:
            _label(output, error, control, plant)
        if k + columns >= len(fans):
            control.set_xlabel("time after that sample / s")
        for axes in (output, error):
            axes.tick_params(labelbottom=False)
    _add_legend(figure)
    return figure


def _label(output: Axes, error: Axes, control: Axes, plant: type[Plant]) -> None:
    signals = signal_names(plant)
    output.set_ylabel(signals.output_label)
    error.set_ylabel(with_unit("measured −\nforecast", signals.output_unit))
    control.set_ylabel(signals.input_label)


def _add_legend(figure: Figure) -> None:
    """One legend for all panels, with each label once."""
    known: dict[str, Artist] = {}
    for axes in figure.axes:
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True):
            known.setdefault(str(label), line)
    figure.legend(list(known.values()), list(known), loc="outside upper right", ncols=len(known))


def _draw(output: Axes, control: Axes, fan: Fan) -> None:
    forecast, past, measured = fan.forecast, fan.past, fan.measured
    known = (np.arange(past.first, past.last + 1) - forecast.sample) * past.period
    if forecast.closed:
        set_points = np.concatenate([past.reference, forecast.reference])
        around = np.concatenate([known, forecast.time])
        draw_set_point(output, around, set_points, 0.9, named=True)
    for axes, band, before, after in (
        (output, forecast.output, past.output, None if measured is None else measured.output),
        (control, forecast.input, past.input, None if measured is None else measured.input),
    ):
        axes.fill_between(forecast.time, band.low, band.high, color=CLOSED, alpha=0.25, lw=0, label=_BAND)
        axes.plot(known, before, color=PLANT, lw=1.1, label="measured before")
        if after is not None:
            time, dotted = forecast.time[: after.size], (0, (1, 1))
            axes.plot(time, after, color=PLANT, lw=1.1, ls=dotted, label="measured afterwards")
        axes.plot(forecast.time, band.mean, color=CLOSED, lw=1.1, label="forecast")
        axes.axvline(0, color=SET_POINT, lw=0.8)
        axes.margins(x=0.01)
    name = "\n".join(wrap(forecast.candidate, _LETTERS))
    output.set_title(f"sample {forecast.sample}:\n{name}", size=9)


def _draw_error(axes: Axes, fan: Fan) -> None:
    """Measured output minus forecast, within the band."""
    band, time = fan.forecast.output, fan.forecast.time
    axes.fill_between(time, band.low - band.mean, band.high - band.mean, color=CLOSED, alpha=0.25, lw=0)
    axes.plot(time[: fan.judged], fan.error, color=PLANT, lw=0.9)
    axes.axhline(0, color=CLOSED, lw=1.0)
    axes.axvline(0, color=SET_POINT, lw=0.8)
