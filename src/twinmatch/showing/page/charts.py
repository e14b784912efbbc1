"""The charts that share the time axis, and what feeds them: signals, forecasts, residuals and events."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from bokeh.models import (
    ColumnDataSource,
    CustomJS,
    DataRange1d,
    FactorRange,
    HoverTool,
    Legend,
    LegendItem,
)
from bokeh.plotting import figure

from twinmatch.description import Description, Loop, Quantity, nth
from twinmatch.forecasting import Forecast
from twinmatch.offline.summary import LevelStretch
from twinmatch.settings import Rule
from twinmatch.showing.page.state import RollingTable
from twinmatch.showing.page.style import MARKS, SHAPES
from twinmatch.showing.quantities import with_unit
from twinmatch.showing.style import CLOSED, DRIVEN, LEVELS, MODEL, PLANT, SET_POINT
from twinmatch.showing.verdicts import Event, EventKind
from twinmatch.signals import FloatArray

POINTS = 2400
"""Most points of a line, whatever time it spans."""
BAND = 2.0
"""Half width of the residual band, in RMS of the newest samples."""


class _Ahead(Rule):
    """How much of a forecast is drawn."""

    most: float = 300.0
    """Most time drawn ahead of the newest sample, s."""
    share: float = 4.0
    """The time drawn ahead is at most the span of the charts divided by this."""


_AHEAD: Final = _Ahead()


TOOLS = "xpan,xwheel_zoom,box_zoom,reset,save"
TRUST = "trust"
"""The row of the time line with the trust level."""
LANES = {
    **dict.fromkeys((EventKind.LEADER, EventKind.NOMINAL, EventKind.LEVEL), TRUST),
    **dict.fromkeys(
        (EventKind.ADMITTED, EventKind.REFUSED, EventKind.DISMISSED), "matches"
    ),
    EventKind.FAULT: "faults",
    EventKind.NODE: "nodes",
}
"""The row of the time line of each kind of event."""
FORECAST_COLUMNS = (
    "t",
    "reference",
    *(
        f"{signal}{edge}"
        for signal in ("output", "input")
        for edge in ("", "_low", "_high")
    ),
)
"""Columns of a forecast of one loop."""

Derive = Callable[[Mapping[str, FloatArray]], dict[str, FloatArray]]
"""Computes further columns from those of a table."""


def stride_for(samples: int) -> int:
    """How many samples are drawn as one, see `envelope`, so that a line has at most `POINTS` points."""
    return 1 if samples <= POINTS else math.ceil(2 * samples / POINTS)


class ChartFeed:
    """Keeps one `ColumnDataSource` up to date with one table."""

    def __init__(self, table: RollingTable, derive: Derive | None = None) -> None:
        """Start empty; `derive` computes more columns from those of the table."""
        self._table = table
        self._derive = derive
        names = list(self._columns(table.since(0)[0], 1.0))
        self.source = ColumnDataSource({"t": [], **{name: [] for name in names}})
        self._row = 0  # of the table, from which on nothing has been sent
        # epoch, period and span of what was sent
        self._shown: tuple[int, float, int] | None = None

    def update(self, period: float, span: int) -> None:
        """Send the samples that are new since the last call.

        If the table was cleared, or `period` (s) or `span` changed, all of the newest `span` samples are
        sent.
        """
        stride = stride_for(span)
        shown = (self._table.epoch, period, span)
        points = span if stride == 1 else 2 * math.ceil(span / stride)
        redraw = shown != self._shown
        if redraw:
            full_groups = self._table.count // stride
            self._row = max(0, full_groups * stride - math.ceil(span / stride) * stride)
        drawn, self._row = self._table.since(self._row, stride)
        columns = self._columns(drawn, period)
        if redraw:
            self.source.data = columns
            self._shown = shown
        elif columns["t"].size:
            self.source.stream(columns, rollover=points)

    def _columns(
        self, drawn: dict[str, FloatArray], period: float
    ) -> dict[str, FloatArray]:
        columns = {"t": drawn.pop("index") * period, **drawn}
        if self._derive is not None:
            columns |= self._derive(columns)
        return columns


def seconds_ahead(span: float) -> float:
    """How much time ahead to draw on charts that show `span` seconds of the past, s."""
    return min(_AHEAD.most, span / _AHEAD.share)


class ForecastBands:
    """Forecast mean and band ahead of the newest sample, on the charts of one output and one input."""

    def __init__(self, output: Any, control: Any, *, asks: bool) -> None:
        """Draw on these two charts; `asks`: whether there can be an answer to a what-if question, which has a
        line in the legend."""
        self._forecast = ColumnDataSource({name: [] for name in FORECAST_COLUMNS})
        self._what_if = ColumnDataSource({name: [] for name in FORECAST_COLUMNS})
        self.lines = []
        """The mean line of each forecast; the time axis covers them."""
        for source, colour, name in (
            (self._forecast, CLOSED, "forecast"),
            (self._what_if, MODEL, "what if"),
        ):
            of_output = _draw_band(output, "output", source, colour)
            of_input = _draw_band(control, "input", source, colour)
            set_point = _step(output, "reference", source, colour, width=1, dash=[2, 3])
            if source is self._forecast or asks:
                for chart, parts in (
                    (output, [*of_output, set_point]),
                    (control, of_input),
                ):
                    chart.legend[0].items.append(
                        LegendItem(label=name, renderers=parts)
                    )
            self.lines.append(of_output[-1])

    def update(
        self,
        forecast: Forecast | None,
        what_if: Forecast | None,
        period: float,
        most: float,
    ) -> None:
        """Draw both, at most `most` seconds ahead; `period` is the sampling period, s."""
        self._forecast.data = _columns(forecast, period, most)
        self._what_if.data = _columns(what_if, period, most)


def _draw_band(
    chart: Any, signal: str, source: ColumnDataSource, colour: str
) -> list[Any]:
    """Band and mean of one signal."""
    band = chart.varea(
        "t",
        f"{signal}_low",
        f"{signal}_high",
        source=source,
        fill_color=colour,
        fill_alpha=0.18,
    )
    mean = chart.line("t", signal, source=source, color=colour, line_width=1.6)
    mean.glyph.line_dash = [5, 2]
    return [band, mean]


def _columns(forecast: Forecast | None, period: float, most: float) -> dict[str, Any]:
    """The columns of a forecast of one loop up to `most` seconds ahead; empty ones without a forecast."""
    if forecast is None:
        return {name: [] for name in FORECAST_COLUMNS}
    is_drawn = forecast.time <= most * (1 + 1e-9)
    bands = [
        b
        for band in (forecast.output, forecast.input)
        for b in (band.mean, band.low, band.high)
    ]
    columns = (forecast.sample * period + forecast.time, forecast.reference, *bands)
    return {
        name: values[is_drawn]
        for name, values in zip(FORECAST_COLUMNS, columns, strict=True)
    }


_FEWER_TICKS = """
if (window.innerWidth < 600) {
    for (const axis of axes) axis.ticker.desired_num_ticks = 3
}
"""
_DRAW_IN_VIEW = """
const watch = new IntersectionObserver((entries) => {
    for (const {target, isIntersecting} of entries) {
        chart_at.get(target).setv({hold_render: !isIntersecting}, {sync: false})
    }
}, {rootMargin: "50px"})
const chart_at = new Map(charts.map((chart) => [Bokeh.index.get_one(chart).el, chart]))
for (const element of chart_at.keys()) watch.observe(element)
window.addEventListener("beforeprint", () => {
    for (const chart of charts) chart.setv({hold_render: false}, {sync: false})
})
"""
"""In the browser: a chart is drawn only while it is on the screen or close to it, and for printing."""
_WRAP_LEGEND = """
const pen = document.createElement("canvas").getContext("2d")
pen.font = `${legend.label_text_font_size} ${legend.label_text_font}`
const beside = legend.glyph_width + legend.label_standoff
const widths = legend.items.map((item) => Math.ceil(pen.measureText(item.label.value).width) + beside)
const width_of = (columns) => {
    const widest = Array(columns).fill(0)
    widths.forEach((width, k) => { widest[k % columns] = Math.max(widest[k % columns], width) })
    return widest.reduce((sum, width) => sum + width, 0) + legend.spacing * (columns - 1)
}
let columns = widths.length
while (columns > 1 && width_of(columns) > chart.inner_width) columns -= 1
if (legend.ncols != columns) legend.ncols = columns
"""
"""In the browser, when the width of a chart has changed: as many entries of its legend in a line as there is
room for."""


def bands(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The edges of the residual bands, from the RMS columns."""
    edges = {}
    for name in columns:
        if name.startswith(("driven_rms_y", "closed_rms_u")):
            edges[f"{name}_high"] = BAND * columns[name]
            edges[f"{name}_low"] = -BAND * columns[name]
    return edges


def draw_in_view(charts: Sequence[Any]) -> CustomJS:
    """In the browser: draw these charts only where somebody can see them."""
    return CustomJS(args={"charts": charts}, code=_DRAW_IN_VIEW)


class LoopCharts:
    """The figures of one output and one input, the k-th of each, counted from 0."""

    def __init__(
        self,
        time: DataRange1d,
        sources: tuple[ColumnDataSource, ColumnDataSource],
        loop: Loop,
        k: int,
        *,
        beside: bool,
    ) -> None:
        """Draw plant and twins over a time axis; `loop` names set-point, output and input.

        If the charts of several loops are `beside` one another, each has the times below it.
        """
        self._time = time
        self._beside = beside
        self._plant, self._twin = sources
        _, self._output_signal, self._input_signal = loop
        self._k = k
        self.output = self._draw_output()
        self.control = self._draw_control()
        self.forecasts = ForecastBands(self.output, self.control, asks=not beside)
        self.residual = self._draw_residual()
        self.control_residual = self._draw_control_residual()
        self.figures = [self.output, self.control, self.residual, self.control_residual]
        for chart in self.figures:
            wrap = CustomJS(
                args={"chart": chart, "legend": chart.legend[0]}, code=_WRAP_LEGEND
            )
            chart.js_on_change("inner_width", wrap)

    def _of(self, column: str) -> str:
        """The name of a column of this loop."""
        return nth(column, self._k)

    def _figure(self, name: str, height: int, label: str) -> Any:
        chart = _figure(nth(name, self._k), height, label, self._time)
        if self._beside:
            _show_times(chart)
        return chart

    def _draw_output(self) -> Any:
        chart = self._figure("output", 320, self._output_signal.label)
        column = self._of
        self.line = chart.line(
            "t", column("output"), source=self._plant, color=PLANT, line_width=2
        )
        closed = chart.line(
            "t",
            column("closed_output"),
            source=self._twin,
            color=CLOSED,
            line_width=1.6,
        )
        set_point = _step(
            chart, column("reference"), self._plant, SET_POINT, width=1.4, dash=[6, 4]
        )
        _legend(
            chart,
            {"plant": self.line, "closed-loop twin": closed, "set-point": set_point},
        )
        _hover_value(chart, self.line, "plant", column("output"), self._output_signal)
        return chart

    def _draw_control(self) -> Any:
        chart = self._figure("control", 210, self._input_signal.label)
        column = self._of
        plant = _step(chart, column("input"), self._plant, PLANT, width=1.6)
        closed = _step(chart, column("closed_input"), self._twin, CLOSED, width=1.2)
        _legend(chart, {"plant": plant, "closed-loop twin": closed})
        _hover_value(chart, plant, "plant", column("input"), self._input_signal)
        return chart

    def _draw_residual(self) -> Any:
        chart, band = self._banded(
            "residual", self._output_signal, "driven_rms_y", DRIVEN, 0.18
        )
        column = self._of("driven_residual_y")
        driven = chart.line(
            "t", column, source=self._twin, color=DRIVEN, line_width=1.4
        )
        of_closed = self._of("closed_residual_y")
        closed = chart.line(
            "t", of_closed, source=self._twin, color=CLOSED, line_width=1.1
        )
        _legend(
            chart,
            {
                "driven twin": driven,
                f"± {BAND:g} RMS": band,
                "closed-loop twin": closed,
            },
        )
        _hover_value(chart, driven, "plant − driven twin", column, self._output_signal)
        return chart

    def _draw_control_residual(self) -> Any:
        chart, band = self._banded(
            "control_residual", self._input_signal, "closed_rms_u", CLOSED, 0.15
        )
        column = self._of("closed_residual_u")
        line = chart.line("t", column, source=self._twin, color=CLOSED, line_width=1.2)
        _legend(chart, {"closed-loop twin": line, f"± {BAND:g} RMS": band})
        _hover_value(chart, line, "residual", column, self._input_signal)
        return chart

    def _banded(
        self, name: str, signal: Quantity, rms: str, colour: str, alpha: float
    ) -> tuple[Any, Any]:
        """A chart of residuals with their band."""
        chart = self._figure(name, 180, with_unit("plant − twin", signal.unit))
        rms = self._of(rms)
        filling: dict[str, Any] = {"fill_color": colour, "fill_alpha": alpha}
        return chart, chart.varea(
            "t", f"{rms}_low", f"{rms}_high", source=self._twin, **filling
        )


class TimeCharts:
    """The figures of one tab; they pan and zoom together in time."""

    def __init__(
        self, plant: ColumnDataSource, twin: ColumnDataSource, described: Description
    ) -> None:
        """Draw these two sources; `described` names their signals."""
        self.time = DataRange1d(follow="end", range_padding=0, min_interval=2.0)
        self._loops = [
            LoopCharts(
                self.time, (plant, twin), loop, k, beside=len(described.loops) > 1
            )
            for k, loop in enumerate(described.loops)
        ]
        self.time.renderers = [
            line
            for loop_charts in self._loops
            for line in (loop_charts.line, *loop_charts.forecasts.lines)
        ]
        self._stretches = ColumnDataSource(
            {"left": [], "right": [], "lane": [], "colour": [], "level": []}
        )
        names = ("t", "lane", "colour", "shape", "title", "text")
        self._events = ColumnDataSource({name: [] for name in names})
        self.happened = self._draw_happened()

    @property
    def rows(self) -> list[list[str]]:
        """Names of the figures of the loops: a row of each kind, top to bottom."""
        kinds = zip(*(loop_charts.figures for loop_charts in self._loops), strict=True)
        return [[chart.name for chart in charts] for charts in kinds]

    @property
    def figures(self) -> list[Any]:
        """All of them, top to bottom."""
        return [
            *(chart for loop_charts in self._loops for chart in loop_charts.figures),
            self.happened,
        ]

    def show(self, *, measured: bool, mirrored: bool) -> None:
        """Show the charts that have data; Bokeh computes no range for an empty chart."""
        for chart in self.figures:
            wanted = mirrored if "residual" in chart.name else measured
            if chart.visible != wanted:
                chart.visible = wanted

    def draw_forecasts(
        self,
        forecast: Forecast | None,
        what_if: Forecast | None,
        period: float,
        most: float,
    ) -> None:
        """Draw both, at most `most` seconds ahead; `period` is the sampling period, s."""
        for k, loop_charts in enumerate(self._loops):
            forecast_of_loop = forecast and forecast.alone(k)
            what_if_of_loop = what_if and what_if.alone(k)
            loop_charts.forecasts.update(
                forecast_of_loop, what_if_of_loop, period, most
            )

    @property
    def fit_to_narrow(self) -> CustomJS:
        """In the browser: on a narrow screen the time axes have fewer ticks."""
        axes = [chart.xaxis[0] for chart in self.figures]
        return CustomJS(args={"axes": axes}, code=_FEWER_TICKS)

    @property
    def outside_time(self) -> list[Any]:
        """The figures that are not needed to know what time the axis shows: all but those of the outputs."""
        outputs = [loop_charts.output for loop_charts in self._loops]
        return [chart for chart in self.figures if chart not in outputs]

    def span(self, seconds: float) -> None:
        """Show the newest `seconds`."""
        self.time.follow_interval = seconds

    def draw_events(
        self, stretches: Iterable[LevelStretch], events: Iterable[Event], period: float
    ) -> None:
        """Draw the trust level over time, and the events of this session."""
        shown = list(stretches)
        self._stretches.data = {
            "left": [s.first * period for s in shown],
            "right": [s.last * period for s in shown],
            "lane": [TRUST] * len(shown),
            "colour": [LEVELS[s.level] for s in shown],
            "level": [s.level.value for s in shown],
        }
        dated = [event for event in events if event.time(period) is not None]
        self._events.data = {
            "t": [event.time(period) for event in dated],
            "lane": [LANES[event.kind] for event in dated],
            "colour": [MARKS[event.mark] for event in dated],
            "shape": [SHAPES[event.mark] for event in dated],
            "title": [event.title for event in dated],
            "text": [event.why for event in dated],
        }

    def _draw_happened(self) -> Any:
        """The time line: strips of trust levels, and a mark for each event."""
        lanes = FactorRange(factors=list(reversed(dict.fromkeys(LANES.values()))))
        chart = _figure("happened", 185, "", self.time, y_range=lanes)
        chart.xaxis.axis_label = "time since the session began / s"
        _show_times(chart)
        chart.ygrid.grid_line_color = None
        strip: dict[str, Any] = {"left": "left", "right": "right", "line_color": None}
        strips = chart.hbar(
            "lane", 0.6, source=self._stretches, fill_color="colour", **strip
        )
        mark: dict[str, Any] = {
            "marker": "shape",
            "size": 12,
            "line_width": 2.5,
            "fill_alpha": 0.85,
        }
        marks = chart.scatter("t", "lane", source=self._events, color="colour", **mark)
        _hover(
            chart,
            strips,
            [("trust", "@level"), ("from", "@left{0} s"), ("to", "@right{0} s")],
        )
        _hover(chart, marks, [("at", "@t{0} s"), ("what", "@title"), ("why", "@text")])
        return chart


def _figure(
    name: str, height: int, label: str, time: DataRange1d, **options: Any
) -> Any:
    options |= {
        "x_range": time,
        "y_axis_label": label,
        "tools": TOOLS,
        "lod_threshold": None,
    }
    options |= {
        "active_drag": None,
        "active_scroll": None,
        "sizing_mode": "stretch_width",
    }
    chart = figure(name=name, height=height, **options)
    chart.toolbar.logo = None
    chart.toolbar.autohide = True
    # of a column only the lowest shows the times
    chart.xaxis.major_label_text_font_size = "0px"
    return chart


def _show_times(chart: Any) -> None:
    """Show the times below a chart."""
    chart.xaxis.major_label_text_font_size = "12px"


def _step(
    chart: Any,
    column: str,
    source: ColumnDataSource,
    colour: str,
    *,
    width: float,
    dash: Sequence[int] = (),
) -> Any:
    """A line that holds each value until the next."""
    line = chart.step(
        "t", column, source=source, mode="after", color=colour, line_width=width
    )
    line.glyph.line_dash = list(dash)
    return line


def _legend(chart: Any, names: Mapping[str, Any]) -> None:
    items = [(name, [renderer]) for name, renderer in names.items()]
    chart.add_layout(
        Legend(items=items, orientation="horizontal", click_policy="hide"), "above"
    )


def _hover(chart: Any, renderer: Any, rows: list[tuple[str, str]]) -> None:
    chart.add_tools(HoverTool(renderers=[renderer], tooltips=rows, visible=False))


def _hover_value(
    chart: Any, renderer: Any, name: str, column: str, quantity: Quantity
) -> None:
    """A tooltip with time and value of a line."""
    value = f"@{column}{{0.{'0' * quantity.decimals}}} {quantity.unit}".rstrip()
    _hover(chart, renderer, [("time", "@t{0.0} s"), (name, value)])
