"""Forecasts on the charts: the leader's from the newest sample, and the answer to a what-if question."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, LegendItem

from twinmatch.forecasting import Forecast
from twinmatch.showing.style import CLOSED, MODEL

__all__ = ["LONGEST", "Fans", "seconds_ahead"]

LONGEST = 300.0
"""Most time drawn ahead of the newest sample, s."""
SHARE = 4.0
"""The time drawn ahead is at most the span of the charts divided by this."""
COLUMNS = ("t", "reference", *(f"{s}{edge}" for s in ("output", "input") for edge in ("", "_low", "_high")))


def seconds_ahead(span: float) -> float:
    """How much time ahead to draw on charts that show `span` seconds of the past, s."""
    return min(LONGEST, span / SHARE)


class Fans:
    """Forecast mean and band ahead of the newest sample, on the charts of output and input."""

    def __init__(self, output: Any, control: Any) -> None:
        """Draw on these two charts."""
        self.forecast, self.answer = (ColumnDataSource({name: [] for name in COLUMNS}) for _ in range(2))
        self.lines = []
        """The mean line of each forecast; the time axis covers them."""
        for source, colour, named in ((self.forecast, CLOSED, "forecast"), (self.answer, MODEL, "what if")):
            drawn = [
                _fan(chart, of, source, colour) for chart, of in ((output, "output"), (control, "input"))
            ]
            asked = output.step("t", "reference", source=source, mode="after", color=colour, line_width=1)
            asked.glyph.line_dash = [2, 3]
            for chart, parts in ((output, [*drawn[0], asked]), (control, drawn[1])):
                chart.legend[0].items.append(LegendItem(label=named, renderers=parts))
            self.lines.append(drawn[0][-1])

    def update(self, forecast: Forecast | None, answer: Forecast | None, period: float, most: float) -> None:
        """Draw both, at most `most` seconds ahead; `period` is the sampling period, s."""
        self.forecast.data = _columns(forecast, period, most)
        self.answer.data = _columns(answer, period, most)


def _fan(chart: Any, of: str, source: ColumnDataSource, colour: str) -> list[Any]:
    """Band and mean of one signal."""
    band = chart.varea("t", f"{of}_low", f"{of}_high", source=source, fill_color=colour, fill_alpha=0.18)
    mean = chart.line("t", of, source=source, color=colour, line_width=1.6)
    mean.glyph.line_dash = [5, 2]
    return [band, mean]


def _columns(forecast: Forecast | None, period: float, most: float) -> dict[str, Any]:
    if forecast is None:
        return {name: [] for name in COLUMNS}
    near = forecast.time <= most * (1 + 1e-9)
    columns = {"t": forecast.sample * period + forecast.time[near], "reference": forecast.reference[near]}
    for name, band in (("output", forecast.output), ("input", forecast.input)):
        columns[name] = band.mean[near]
        columns[f"{name}_low"], columns[f"{name}_high"] = band.low[near], band.high[near]
    return {name: np.asarray(columns[name]) for name in COLUMNS}
