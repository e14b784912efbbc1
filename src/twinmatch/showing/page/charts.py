"""The charts that share the time axis: output, input, residuals, and events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bokeh.models import ColumnDataSource, CustomJS, DataRange1d, FactorRange, HoverTool, Legend
from bokeh.plotting import figure

from twinmatch.description import Description, Quantity
from twinmatch.showing.events import Stretch
from twinmatch.showing.page.ahead import Fans
from twinmatch.showing.page.events import Event, Lane
from twinmatch.showing.page.look import MARKS, SHAPES
from twinmatch.showing.style import CLOSED, DRIVEN, LEVELS, PLANT, SET_POINT
from twinmatch.showing.words import with_unit
from twinmatch.signals import FloatArray

__all__ = ["TimeCharts", "bands"]

BAND = 2.0
"""Half width of the residual band, in RMS of the newest samples."""
TOOLS = "xpan,xwheel_zoom,box_zoom,reset,save"
LANES = {Lane.TRUST: "trust", Lane.MATCH: "matches", Lane.FAULT: "faults", Lane.NODES: "nodes"}


_NARROW = """
if (window.innerWidth < 600) {
    for (const legend of legends) legend.ncols = 2
    axes.ticker.desired_num_ticks = 3
}
"""


def bands(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The edges of the residual bands, from the RMS columns."""
    edges = {}
    for name in ("driven_rms_y", "closed_rms_u"):
        edges[f"{name}_high"] = BAND * columns[name]
        edges[f"{name}_low"] = -BAND * columns[name]
    return edges


class TimeCharts:
    """The figures of one tab; they pan and zoom together in time."""

    def __init__(self, plant: ColumnDataSource, twin: ColumnDataSource, described: Description) -> None:
        """Draw these two sources; `described` names their signals."""
        self._plant, self._twin, self._described = plant, twin, described
        self.time = DataRange1d(follow="end", range_padding=0, min_interval=2.0)
        self.output = self._output()
        self.control = self._control()
        self.fans = Fans(self.output, self.control)
        self.time.renderers = [*self.time.renderers, *self.fans.lines]
        self.residual = self._residual()
        self.control_residual = self._control_residual()
        self._stretches = ColumnDataSource({"left": [], "right": [], "lane": [], "colour": [], "level": []})
        names = ("t", "lane", "colour", "shape", "title", "text")
        self._events = ColumnDataSource({name: [] for name in names})
        self.happened = self._happened()

    @property
    def figures(self) -> list[Any]:
        """All of them, top to bottom."""
        return [self.output, self.control, self.residual, self.control_residual, self.happened]

    def show(self, *, measured: bool, mirrored: bool) -> None:
        """Show the charts that have data; Bokeh computes no range for an empty chart."""
        for chart in (self.output, self.control, self.happened):
            if chart.visible != measured:
                chart.visible = measured
        for chart in (self.residual, self.control_residual):
            if chart.visible != mirrored:
                chart.visible = mirrored

    @property
    def fit_to_narrow(self) -> CustomJS:
        """In the browser: on a narrow screen legends use more lines, and the time axis fewer ticks."""
        legends = [chart.legend[0] for chart in self.figures if chart.legend]
        return CustomJS(args={"legends": legends, "axes": self.happened.xaxis[0]}, code=_NARROW)

    def span(self, seconds: float) -> None:
        """Show the newest `seconds`."""
        self.time.follow_interval = seconds

    def draw_events(self, stretches: list[Stretch], events: list[Event], period: float) -> None:
        """Draw the trust level over time, and the events of this session."""
        self._stretches.data = {
            "left": [s.first * period for s in stretches],
            "right": [s.last * period for s in stretches],
            "lane": [LANES[Lane.TRUST]] * len(stretches),
            "colour": [LEVELS[s.level] for s in stretches],
            "level": [s.level.value for s in stretches],
        }
        placed = [e for e in events if e.sample is not None]
        self._events.data = {
            "t": [(e.sample or 0) * period for e in placed],
            "lane": [LANES[e.lane] for e in placed],
            "colour": [MARKS[e.mark] for e in placed],
            "shape": [SHAPES[e.mark] for e in placed],
            "title": [e.title for e in placed],
            "text": [e.text for e in placed],
        }

    def _figure(self, name: str, height: int, label: str, **options: Any) -> Any:
        chart = figure(
            name=name,
            height=height,
            sizing_mode="stretch_width",
            x_range=self.time,
            tools=TOOLS,
            active_drag=None,
            active_scroll=None,
            y_axis_label=label,
            lod_threshold=None,
            **options,
        )
        chart.toolbar.logo = None
        chart.toolbar.autohide = True
        chart.xaxis.major_label_text_font_size = "0px"  # only the lowest chart has tick labels
        return chart

    def _output(self) -> Any:
        chart = self._figure("output", 320, self._described.output.label)
        plant = chart.line("t", "output", source=self._plant, color=PLANT, line_width=2)
        closed = chart.line("t", "closed_output", source=self._twin, color=CLOSED, line_width=1.6)
        asked = chart.step(
            "t", "reference", source=self._plant, mode="after", color=SET_POINT, line_width=1.4
        )
        asked.glyph.line_dash = [6, 4]
        self.time.renderers = [plant]
        _legend(chart, {"plant": plant, "closed-loop twin": closed, "set-point": asked})
        _hover(chart, plant, [("time", "@t{0.0} s"), ("plant", _shown("output", self._described.output))])
        return chart

    def _control(self) -> Any:
        chart = self._figure("control", 210, self._described.input.label)
        plant = chart.step("t", "input", source=self._plant, mode="after", color=PLANT, line_width=1.6)
        closed = chart.step(
            "t", "closed_input", source=self._twin, mode="after", color=CLOSED, line_width=1.2
        )
        _legend(chart, {"plant": plant, "closed-loop twin": closed})
        _hover(chart, plant, [("time", "@t{0.0} s"), ("plant", _shown("input", self._described.input))])
        return chart

    def _residual(self) -> Any:
        chart = self._figure("residual", 180, with_unit("plant − twin", self._described.output.unit))
        band = chart.varea(
            "t",
            "driven_rms_y_low",
            "driven_rms_y_high",
            source=self._twin,
            fill_color=DRIVEN,
            fill_alpha=0.18,
        )
        driven = chart.line("t", "driven_residual_y", source=self._twin, color=DRIVEN, line_width=1.4)
        closed = chart.line("t", "closed_residual_y", source=self._twin, color=CLOSED, line_width=1.1)
        names = {"driven twin": driven, f"± {BAND:g} RMS": band, "closed-loop twin": closed}
        _legend(chart, names)
        _hover(
            chart,
            driven,
            [
                ("time", "@t{0.0} s"),
                ("plant − driven twin", _shown("driven_residual_y", self._described.output)),
            ],
        )
        return chart

    def _control_residual(self) -> Any:
        chart = self._figure("control_residual", 180, with_unit("plant − twin", self._described.input.unit))
        band = chart.varea(
            "t",
            "closed_rms_u_low",
            "closed_rms_u_high",
            source=self._twin,
            fill_color=CLOSED,
            fill_alpha=0.15,
        )
        line = chart.line("t", "closed_residual_u", source=self._twin, color=CLOSED, line_width=1.2)
        _legend(chart, {"closed-loop twin": line, f"± {BAND:g} RMS": band})
        _hover(
            chart,
            line,
            [("time", "@t{0.0} s"), ("residual", _shown("closed_residual_u", self._described.input))],
        )
        return chart

    def _happened(self) -> Any:
        lanes = FactorRange(factors=list(reversed(LANES.values())))
        chart = self._figure("happened", 185, "", y_range=lanes)
        chart.xaxis.axis_label = "time since the session began / s"
        chart.xaxis.major_label_text_font_size = "12px"
        chart.ygrid.grid_line_color = None
        strips = chart.hbar(
            y="lane",
            left="left",
            right="right",
            height=0.6,
            source=self._stretches,
            fill_color="colour",
            line_color=None,
        )
        marks = chart.scatter(
            "t",
            "lane",
            source=self._events,
            marker="shape",
            size=12,
            fill_color="colour",
            line_color="colour",
            line_width=2.5,
            fill_alpha=0.85,
        )
        _hover(chart, strips, [("trust", "@level"), ("from", "@left{0} s"), ("to", "@right{0} s")])
        _hover(chart, marks, [("at", "@t{0} s"), ("what", "@title"), ("why", "@text")])
        return chart


def _shown(column: str, quantity: Quantity) -> str:
    """Tooltip format of a column's value."""
    places = "0" * quantity.decimals
    return f"@{column}{{0.{places}}} {quantity.unit}".rstrip()


def _legend(chart: Any, names: Mapping[str, Any]) -> None:
    items = [(name, [renderer]) for name, renderer in names.items()]
    chart.add_layout(Legend(items=items, orientation="horizontal", click_policy="hide"), "above")


def _hover(chart: Any, renderer: Any, rows: list[tuple[str, str]]) -> None:
    chart.add_tools(HoverTool(renderers=[renderer], tooltips=rows, visible=False))
