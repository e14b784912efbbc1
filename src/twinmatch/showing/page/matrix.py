"""The ν-gap between the candidates as a heat map, with each candidate's sum below it."""

from __future__ import annotations

from textwrap import wrap
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import ColumnDataSource, FactorRange, HoverTool, LinearColorMapper
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from twinmatch.comparing import CandidateScore, Verdict
from twinmatch.showing.page.look import FONT
from twinmatch.showing.quantities import number
from twinmatch.showing.style import TEXT

__all__ = ["Matrix"]

SUM = "Σ"
_LINE = 20
"""Characters per line of a name beside its row; there are two lines."""
_ROW, _HEAD = 34, 44
"""Height of a row, and of the space above the first one, in pixels."""
_EVEN = 0.179
"""Luminance at which black and white text have the same contrast, 4.6."""
_PALETTE = list(reversed(Cividis256))
_NAMES = ("column", "row", "gap", "shown", "interval", "ink", "pair")


class Matrix:
    """The heat map of one tab."""

    def __init__(self) -> None:
        """Start without candidates."""
        self._cells = ColumnDataSource({name: [] for name in _NAMES})
        self._sums = ColumnDataSource({name: [] for name in (*_NAMES, "style")})
        self._colours = LinearColorMapper(palette=_PALETTE, low=0.0, high=1.0)
        self.figure = self._draw()

    def update(self, verdict: Verdict | None) -> None:
        """Draw the matrix of a verdict; None, or a verdict without candidates, leaves it empty."""
        candidates = verdict.candidates if verdict is not None else ()
        # Long names do not fit above the columns: columns have numbers, rows have names and numbers.
        columns = [str(k) for k in range(1, len(candidates) + 1)]
        names = [f"{_short(c.name)}  {k}" for k, c in zip(columns, candidates, strict=True)]
        gaps = np.array(verdict.nu_gap if verdict is not None else (), dtype=np.float64)
        if gaps.shape != (len(names), len(names)):
            gaps = np.zeros((len(names), len(names)))
        most = max(float(gaps.max()), 1e-12) if gaps.size else 1.0
        self.figure.x_range.factors = columns
        self.figure.y_range.factors = [SUM, *reversed(names)]
        self.figure.height = _HEAD + _ROW * (len(names) + 1)
        self._colours.high = most
        places = list(np.ndindex(*gaps.shape))
        self._cells.data = {
            "column": [columns[j] for _, j in places],
            "row": [names[i] for i, _ in places],
            "gap": [float(gaps[i, j]) for i, j in places],
            "shown": [number(float(gaps[i, j]), 2) for i, j in places],
            "interval": [_interval(candidates[i], j) for i, j in places],
            "ink": [_ink(float(gaps[i, j]) / most) for i, j in places],
            "pair": [f"{candidates[i].name} and {candidates[j].name}" for i, j in places],
        }
        nominal = verdict.nominal if verdict is not None else None
        self._sums.data = {
            "column": columns,
            "row": [SUM] * len(names),
            "gap": [c.nu_gap_sum for c in candidates],
            "shown": [number(c.nu_gap_sum, 2) for c in candidates],
            "interval": [""] * len(names),
            "ink": [TEXT] * len(names),
            "pair": [c.name for c in candidates],
            "style": ["bold" if c.name == nominal else "normal" for c in candidates],
        }

    def _draw(self) -> Any:
        chart = figure(
            name="matrix",
            height=_HEAD + _ROW,
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
        rows = [("between", "@pair"), ("ν-gap", "@gap{0.0000}"), ("90 %", "@interval")]
        chart.add_tools(HoverTool(renderers=[cells], tooltips=rows, visible=False))
        return chart


def _short(name: str) -> str:
    """A name on at most two lines; the tooltip shows it in full."""
    lines = wrap(name, _LINE)
    if len(lines) <= 2:
        return "\n".join(lines)
    return f"{lines[0]}\n{lines[1][: _LINE - 1].rstrip(' ,')}…"


def _ink(share: float) -> str:
    """Black or white, whichever has more contrast on the colour of a gap, given as a share of the largest."""
    colour = _PALETTE[min(len(_PALETTE) - 1, int(share * len(_PALETTE)))]
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    r, g, b = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return "#FFFFFF" if 0.2126 * r + 0.7152 * g + 0.0722 * b < _EVEN else "#000000"


def _interval(candidate: CandidateScore, other: int) -> str:
    """The 90 % interval of its ν-gap to another candidate of the family."""
    if not (other < len(candidate.nu_gap_low) and other < len(candidate.nu_gap_high)):
        return "not computed"
    return f"{number(candidate.nu_gap_low[other], 3)} to {number(candidate.nu_gap_high[other], 3)}"
