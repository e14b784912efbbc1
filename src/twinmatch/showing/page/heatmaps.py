"""The two heat maps of the page: ν-gaps between the candidates, and the thermal image."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Any, Final

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    ColorBar,
    Column,
    ColumnDataSource,
    FactorRange,
    HoverTool,
    LinearColorMapper,
)
from bokeh.palettes import Cividis256, Inferno256
from bokeh.plotting import figure
from numpy.typing import NDArray

from twinmatch.comparing import CandidateScore, Verdict
from twinmatch.settings import Rule
from twinmatch.showing.page.style import FONT, panel
from twinmatch.showing.quantities import number, span_text
from twinmatch.showing.style import TEXT

SUM = "Σ"
"""Name of the row with the sum of each column."""


class _MatrixSize(Rule):
    """Sizes of the matrix."""

    line: int = 20
    """Characters per line of a name beside its row; there are two lines."""
    row: int = 34
    """Height of a row, pixels."""
    head: int = 44
    """Height of the space above the first row, pixels."""


_SIZE: Final = _MatrixSize()


_EQUAL_CONTRAST = 0.179
"""Luminance at which black and white text have the same contrast, 4.6."""
_PALETTE = list(reversed(Cividis256))
_COLUMNS = ("column", "row", "gap", "shown", "interval", "ink", "pair")


class GapMatrix:
    """The heat map of one tab."""

    def __init__(self) -> None:
        """Start without candidates."""
        self._cells = ColumnDataSource({name: [] for name in _COLUMNS})
        self._sums = ColumnDataSource({name: [] for name in (*_COLUMNS, "style")})
        self._colours = LinearColorMapper(palette=_PALETTE, low=0.0, high=1.0)
        self.figure = self._draw()

    def update(self, verdict: Verdict | None) -> None:
        """Draw the matrix of a verdict; None, or a verdict without candidates, leaves it empty."""
        candidates = verdict.candidates if verdict else ()
        nominal = verdict.nominal if verdict else None
        # Long names do not fit above the columns: columns have numbers, rows have names and numbers.
        columns = [str(k) for k in range(1, len(candidates) + 1)]
        rows = [
            f"{_short(c.name)}  {k}" for k, c in zip(columns, candidates, strict=True)
        ]
        gaps = np.array(verdict.nu_gap if verdict else (), dtype=np.float64)
        if gaps.shape != (len(rows), len(rows)):
            gaps = np.zeros((len(rows), len(rows)))
        most = max(float(gaps.max()), 1e-12) if gaps.size else 1.0
        self.figure.x_range.factors = columns
        self.figure.y_range.factors = [SUM, *reversed(rows)]
        self.figure.height = _SIZE.head + _SIZE.row * (len(rows) + 1)
        self._colours.high = most
        cells = []
        for (i, j), gap in np.ndenumerate(gaps):
            cell = _cell(candidates[i], candidates[j], j, float(gap), most)
            cells.append({**cell, "row": rows[i], "column": columns[j]})
        self._cells.data = _by_column(cells)
        self._sums.data = _sums(candidates, columns, nominal)

    def _draw(self) -> Any:
        ranges = {
            "x_range": FactorRange(),
            "y_range": FactorRange(),
            "x_axis_location": "above",
        }
        chart = _map("matrix", _SIZE.head + _SIZE.row, min_border_left=56, **ranges)
        chart.axis.axis_line_color = None
        chart.axis.major_tick_line_color = None
        filling = {
            "fill_color": {"field": "gap", "transform": self._colours},
            "line_color": None,
        }
        cells = chart.rect(
            "column", "row", width=0.96, height=0.96, source=self._cells, **filling
        )
        font = {
            "text_align": "center",
            "text_baseline": "middle",
            "text_font": value(FONT),
        }
        font["text_color"] = "ink"
        chart.text(
            "column", "row", "shown", source=self._cells, text_font_size="12px", **font
        )
        font["text_font_style"] = "style"
        chart.text(
            "column", "row", "shown", source=self._sums, text_font_size="13px", **font
        )
        rows = [("between", "@pair"), ("ν-gap", "@gap{0.0000}"), ("90 %", "@interval")]
        chart.add_tools(HoverTool(renderers=[cells], tooltips=rows, visible=False))
        return chart


def _cell(
    candidate: CandidateScore,
    other: CandidateScore,
    place: int,
    gap: float,
    most: float,
) -> dict[str, Any]:
    """The ν-gap from a candidate to another one, which has this place; `most` is the largest of all gaps."""
    return {
        "gap": gap,
        "shown": number(gap, 2),
        "interval": _interval(candidate, place),
        "ink": _ink(gap / most),
        "pair": f"{candidate.name} and {other.name}",
    }


def _by_column(cells: Sequence[dict[str, Any]]) -> dict[str, list[Any]]:
    """The cells as lists, one for each column of the source."""
    data = {}
    for name in _COLUMNS:
        data[name] = [cell[name] for cell in cells]
    return data


def _sums(
    candidates: Sequence[CandidateScore], columns: Sequence[str], nominal: str | None
) -> dict[str, list[Any]]:
    """The sums of all candidates' ν-gaps, by the columns of the row below the matrix."""
    return {
        "column": list(columns),
        "row": [SUM] * len(candidates),
        "gap": [c.nu_gap_sum for c in candidates],
        "shown": [number(c.nu_gap_sum, 2) for c in candidates],
        "interval": [""] * len(candidates),
        "ink": [TEXT] * len(candidates),
        "pair": [c.name for c in candidates],
        "style": ["bold" if c.name == nominal else "normal" for c in candidates],
    }


def _map(name: str, height: int, **options: Any) -> Any:
    """A chart without grid and tools."""
    bare: dict[str, Any] = {
        "tools": "",
        "toolbar_location": None,
        "sizing_mode": "stretch_width",
    }
    chart = figure(name=name, height=height, **bare, **options)
    chart.grid.grid_line_color = None
    return chart


def _short(name: str) -> str:
    """A name on at most two lines; the tooltip shows it in full."""
    lines = wrap(name, _SIZE.line)
    if len(lines) <= 2:
        return "\n".join(lines)
    return f"{lines[0]}\n{lines[1][: _SIZE.line - 1].rstrip(' ,')}…"


def _ink(share: float) -> str:
    """Black or white, whichever has more contrast on the colour of a gap, given as a share of the largest."""
    colour = _PALETTE[min(len(_PALETTE) - 1, int(share * len(_PALETTE)))]
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    r, g, b = (
        p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts
    )
    return (
        "#FFFFFF"
        if 0.2126 * r + 0.7152 * g + 0.0722 * b < _EQUAL_CONTRAST
        else "#000000"
    )


def _interval(candidate: CandidateScore, place: int) -> str:
    """The 90 % interval of its ν-gap to another candidate of the family."""
    if not (place < len(candidate.nu_gap_low) and place < len(candidate.nu_gap_high)):
        return "not computed"
    return span_text(candidate.nu_gap_low[place], candidate.nu_gap_high[place])


MIN_SPAN = 4.0
"""Smallest span of the colours, K: less would show the camera's noise as a picture."""


class ThermalImage:
    """The thermal image of one tab."""

    def __init__(self) -> None:
        """Start without an image; the card is hidden."""
        self._source = ColumnDataSource(
            {"image": [], "x": [], "y": [], "dw": [], "dh": []}
        )
        self._colours = LinearColorMapper(
            palette=Inferno256, low=20.0, high=30.0, nan_color="#8C8C8C"
        )
        self.figure = self._draw()
        heading = panel("thermal_heading", "<h2>Thermal image / °C</h2>")
        place: dict[str, Any] = {
            "css_classes": ["card"],
            "visible": False,
            "sizing_mode": "stretch_width",
        }
        self.root = Column(heading, self.figure, name="thermal_card", **place)
        """The whole card; hidden for a plant without a camera."""

    def update(self, image: NDArray[np.float32]) -> None:
        """Show an image in °C, first row on top."""
        rows, columns = image.shape
        low = float(np.nanmin(image))
        high = float(np.nanmax(image))
        widening = max(0.0, MIN_SPAN - (high - low)) / 2
        self._colours.low = round(low - widening, 1)
        self._colours.high = round(high + widening, 1)
        self._source.data = {
            "image": [image[::-1]],
            "x": [0],
            "y": [0],
            "dw": [columns],
            "dh": [rows],
        }
        # last, as each change is a message of its own: an empty card would be seen
        self.root.visible = True

    def _draw(self) -> Any:
        axes = {"match_aspect": True, "x_axis_type": None, "y_axis_type": None}
        # room for labels such as 22.5
        borders = {"min_border_left": 4, "min_border_right": 56}
        chart = _map("thermal", 260, **axes, **borders)
        chart.x_range.range_padding = chart.y_range.range_padding = 0
        chart.image(
            "image",
            "x",
            "y",
            "dw",
            "dh",
            source=self._source,
            color_mapper=self._colours,
        )
        chart.add_layout(
            ColorBar(color_mapper=self._colours, width=10, padding=6), "right"
        )
        return chart
