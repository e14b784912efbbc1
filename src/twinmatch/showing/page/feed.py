"""From a history to the columns a browser draws; only new rows are sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from bokeh.models import ColumnDataSource

from twinmatch.showing.page.history import History
from twinmatch.signals import FloatArray

__all__ = ["POINTS", "Feed", "stride_for"]

POINTS = 2400
"""Most points of a line, whatever time it spans."""

Derive = Callable[[Mapping[str, FloatArray]], dict[str, FloatArray]]


def stride_for(samples: int) -> int:
    """How many samples are drawn as one, see `envelope`, so that a line has at most `POINTS` points."""
    return 1 if samples <= POINTS else math.ceil(2 * samples / POINTS)


class Feed:
    """Keeps one `ColumnDataSource` up to date with one history."""

    def __init__(self, history: History, derive: Derive | None = None) -> None:
        """Start empty; `derive` computes more columns from those of the history."""
        self._history = history
        self._derive = derive
        names = list(self._columns(history.since(0)[0], 1.0))
        self.source = ColumnDataSource({"t": [], **{name: [] for name in names}})
        self._row = 0
        self._shown: tuple[int, float, int] | None = None

    def update(self, period: float, span: int) -> None:
        """Send the new ones of the newest `span` samples, or all of them if epoch, period or span changed."""
        stride = stride_for(span)
        shown = (self._history.epoch, period, span)
        points = span if stride == 1 else 2 * math.ceil(span / stride)
        redraw = shown != self._shown
        if redraw:
            self._row = max(0, self._history.count // stride * stride - math.ceil(span / stride) * stride)
        drawn, self._row = self._history.since(self._row, stride)
        columns = self._columns(drawn, period)
        if redraw:
            self.source.data = columns
            self._shown = shown
        elif columns["t"].size:
            self.source.stream(columns, rollover=points)

    def _columns(self, drawn: dict[str, FloatArray], period: float) -> dict[str, FloatArray]:
        columns = {"t": drawn.pop("index") * period, **drawn}
        if self._derive is not None:
            columns |= self._derive(columns)
        return columns
