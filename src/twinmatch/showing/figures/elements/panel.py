"""Panels of figures: axes that draw and measure what is around them as a whole."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, Literal

from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from twinmatch.showing.figures.elements.rulers import (
    BottomRuler,
    LeftRuler,
    Line,
    align,
    draw_lines,
)

if TYPE_CHECKING:
    from matplotlib.backend_bases import RendererBase
    from matplotlib.figure import Figure

_GRID_ORDER: Final = 0.5
"""Place of the grid in the order of drawing: below lines and areas."""
_TITLE_LINE: Final = 14.0
"""Estimated height of a line of a title, with its distance, points."""


class Panel(Axes):
    """Axes with a grid, and a ruler below and at the left, each drawn at once.

    The axis objects of matplotlib keep locators, formatters, limits and labels, but are not drawn: they make
    five artists for every tick.

    matplotlib lays a figure out twice and measures what surrounds the axes each time, since ticks may change with
    the size of the axes. The first round only has to bring the axes near their final size: panels estimate there.
    """

    _gridded: frozenset[str] = frozenset()
    """Names of the axes at whose ticks there are lines; set while matplotlib makes the axes."""
    _is_estimated = False

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        for axis in (self.xaxis, self.yaxis):
            axis.set_visible(False)
            # a program that asks for ticks gets them
            vars(axis).pop("majorTicks", None)
            vars(axis).pop("minorTicks", None)
        self.spines[:].set_visible(False)
        self.below = BottomRuler(self, self.xaxis)
        """The ruler below the panel."""
        self.left = LeftRuler(self, self.yaxis)
        """The ruler at the left of the panel."""
        for artist in (_Grid(self), self.below, self.left):
            self.add_artist(artist)
            # rulers lie outside
            artist.set_clip_on(False)

    def set_axis_on(self) -> None:
        """Show the grid and the rulers."""
        super().set_axis_on()
        # called while the axes are made, before matplotlib changes its first ticks, which would be made for that
        for axis in (self.xaxis, self.yaxis):
            axis.majorTicks = []
            axis.minorTicks = []

    def grid(
        self,
        visible: bool | None = None,
        which: Literal["major", "minor", "both"] = "major",
        axis: Literal["both", "x", "y"] = "both",
        **_: Any,
    ) -> None:
        """Show or hide the lines at the ticks of an axis, or of both."""
        del which
        names = {"x", "y"} if axis == "both" else {axis}
        if visible is False:
            self._gridded -= names
        else:
            self._gridded |= names

    def grid_lines(self) -> list[Line]:
        """The lines of the grid, pixels."""
        box = self.bbox
        lines: list[Line] = []
        if "x" in self._gridded:
            lines += [((x, box.y0), (x, box.y1)) for x in self.below.places]
        if "y" in self._gridded:
            lines += [((box.x0, y), (box.x1, y)) for y in self.left.places]
        return lines

    def draw(self, renderer: RendererBase) -> None:
        """Draw the panel and what surrounds it."""
        self.below.update_ticks()
        self.left.update_ticks()
        super().draw(renderer)

    def estimate_once(self) -> None:
        """Estimate in the next round of a layout instead of measuring."""
        self._is_estimated = True

    def get_tightbbox(self, *args: Any, **options: Any) -> Any:
        """The box of the axes with what surrounds them, in pixels."""
        if self._is_estimated:
            self._is_estimated = False
            return self._estimated_box()
        return super().get_tightbbox(*args, **options)

    def _estimated_box(self) -> Bbox:
        inner = self.bbox
        if not self.axison:
            return Bbox(inner.get_points())
        title = self.get_title(rcParams["axes.titlelocation"])
        above = _TITLE_LINE * (title.count("\n") + 1) if title else 0.0
        per_point = self.figure.dpi / 72.0
        return Bbox.from_extents(
            inner.x0 - self.left.estimated_depth() * per_point,
            inner.y0 - self.below.estimated_depth() * per_point,
            inner.x1,
            inner.y1 + above * per_point,
        )


class _Grid(Artist):
    """The grid of a panel, as one path."""

    def __init__(self, panel: Panel) -> None:
        super().__init__()
        self._panel = panel
        self.set_zorder(_GRID_ORDER)
        self.set_in_layout(False)

    def draw(self, renderer: RendererBase) -> None:
        if self._panel.axison:
            lines = self._panel.grid_lines()
            draw_lines(renderer, lines, "grid.color", "grid.linewidth")


def estimate_panels_once(figure: Figure) -> None:
    """In the next round of a layout, have panels estimate what surrounds them.

    Not those that keep their shape, which are placed by what surrounds them.
    """
    for axes in figure.axes:
        if isinstance(axes, Panel) and axes.get_aspect() == "auto":
            axes.estimate_once()


def align_labels(panels: Iterable[Panel]) -> None:
    """Put the labels at the left of panels below one another on one line."""
    align([panel.left for panel in panels])
