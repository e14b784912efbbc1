"""The ν-gap between the candidates as a heat map, with each candidate's sum below it."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import ColumnDataSource, FactorRange, HoverTool, LinearColorMapper
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from twinmatch.dashboard.look import FONT
from twinmatch.discrimination import CandidateScore, Verdict
from twinmatch.views.quantities import number
from twinmatch.views.style import TEXT

__all__ = ["Matrix"]

SUM = "Σ"
_SHORT = 8
"""Letters of a name that has room above its column."""
_HEIGHT, _ROOM = 300, 80
"""Of the chart, and for longer names, in pixels."""
_NAMES = ("column", "row", "gap", "shown", "interval", "ink")


class Matrix:
    """The heat map of one tab."""

    def __init__(self) -> None:
        """Begin without candidates."""
        self._cells = ColumnDataSource({name: [] for name in _NAMES})
        self._sums = ColumnDataSource({name: [] for name in (*_NAMES, "style")})
        self._colours = LinearColorMapper(palette=list(reversed(Cividis256)), low=0.0, high=1.0)
        self.figure = self._draw()

    def update(self, verdict: Verdict | None) -> None:
        """Draw the matrix of a verdict; none, or one without candidates, leaves it empty."""
        candidates = verdict.candidates if verdict is not None else ()
        # A structure's name has parts; each has a line of its own beside and above the matrix.
        names = [c.name.replace(", ", ",\n") for c in candidates]
        gaps = np.array(verdict.nu_gap if verdict is not None else (), dtype=np.float64)
        if gaps.shape != (len(names), len(names)):
            gaps = np.zeros((len(names), len(names)))
        most = max(float(gaps.max()), 1e-12) if gaps.size else 1.0
        self.figure.x_range.factors = names
        self.figure.y_range.factors = [SUM, *reversed(names)]
        long = any(len(name) > _SHORT for name in names)
        self.figure.xaxis.major_label_orientation = "vertical" if long else "horizontal"
        self.figure.height = _HEIGHT + (_ROOM if long else 0)
        self._colours.high = most
        places = list(np.ndindex(*gaps.shape))
        self._cells.data = {
            "column": [names[j] for _, j in places],
            "row": [names[i] for i, _ in places],
            "gap": [float(gaps[i, j]) for i, j in places],
            "shown": [number(float(gaps[i, j]), 2) for i, j in places],
            "interval": [_interval(candidates[i], j) for i, j in places],
            "ink": ["#FFFFFF" if gaps[i, j] > 0.5 * most else TEXT for i, j in places],
        }
        nominal = verdict.nominal if verdict is not None else None
        self._sums.data = {
            "column": names,
            "row": [SUM] * len(names),
            "gap": [c.nu_gap_sum for c in candidates],
            "shown": [number(c.nu_gap_sum, 2) for c in candidates],
            "interval": [""] * len(names),
            "ink": [TEXT] * len(names),
            "style": ["bold" if c.name == nominal else "normal" for c in candidates],
        }

    def _draw(self) -> Any:
        chart = figure(
            name="matrix",
            height=_HEIGHT,
            sizing_mode="stretch_width",
            x_range=FactorRange(),
            y_range=FactorRange(),
            x_axis_location="above",
            tools="",
            toolbar_location=None,
            min_border_left=56,
        )
        chart.grid.grid_line_color = None
        chart.axis.axis_line_color = None
        chart.axis.major_tick_line_color = None
        cells = chart.rect(
            "column",
            "row",
            width=0.96,
            height=0.96,
            source=self._cells,
            fill_color={"field": "gap", "transform": self._colours},
            line_color=None,
        )
        lettering = {"text_align": "center", "text_baseline": "middle", "text_font": value(FONT)}
        chart.text(
            "column", "row", "shown", source=self._cells, text_color="ink", text_font_size="12px", **lettering
        )
        chart.text(
            "column",
            "row",
            "shown",
            source=self._sums,
            text_color="ink",
            text_font_size="13px",
            text_font_style="style",
            **lettering,
        )
        rows = [("between", "@row and @column"), ("ν-gap", "@gap{0.0000}"), ("90 %", "@interval")]
        chart.add_tools(HoverTool(renderers=[cells], tooltips=rows, visible=False))
        return chart


def _interval(candidate: CandidateScore, other: int) -> str:
    """Where 90 % of the probability is, of its ν-gap to another of the family."""
    if not (other < len(candidate.nu_gap_low) and other < len(candidate.nu_gap_high)):
        return "not computed"
    return f"{number(candidate.nu_gap_low[other], 3)} to {number(candidate.nu_gap_high[other], 3)}"
