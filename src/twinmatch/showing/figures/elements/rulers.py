"""Rulers beside a panel: its side, the ticks with their numbers, and the label, drawn as a whole."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import compress
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FixedLocator
from matplotlib.transforms import Bbox, IdentityTransform

from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.backend_bases import RendererBase

Line: TypeAlias = tuple[tuple[float, float], tuple[float, float]]
"""Both ends of a line, pixels."""

_ORDER: Final = 2.5
"""Place of a ruler in the order of drawing: above lines and areas."""
_ROUNDING: Final = 1e-9
"""How far outside the panel a tick is still drawn, as a share of the panel's size: limits are rounded."""
_LINE: Final = 14.0
"""Estimated height of a line of a label, with its distance, points."""
_FACTOR_DISTANCE: Final = 3.0
"""How far a factor of all numbers is from the panel or the numbers, points."""


class Ruler(Artist):
    """A side of a panel with ticks, their numbers or names, and a label.

    Locator, formatter, limits and label are those of the axis.
    """

    ticks = ""
    """Prefix of the settings of the ticks: `xtick` or `ytick`."""
    estimated_numbers = 0.0
    """Estimated space of the ticks and their numbers, with distances, points."""

    def __init__(self, panel: Axes, axis: Axis) -> None:
        super().__init__()
        self.set_zorder(_ORDER)
        self.panel = panel
        self.axis = axis
        self.places: FloatArray = np.empty(0)
        """Places of the ticks along the panel's side, pixels, when they were last updated."""
        self.numbers: list[str] = []
        """What is written at the ticks; nothing if there are no numbers."""
        self.shows_numbers = True
        """Whether there are numbers at the ticks; not where another panel shows them."""
        self._is_named = False
        """Whether there are names at the ticks, whose letters differ more in width than digits do."""
        self._number = Text(
            fontsize=_setting(f"{self.ticks}.labelsize"),
            color=_setting(f"{self.ticks}.color"),
        )
        """Draws and measures the numbers, one after another."""
        self._number.set_figure(panel.figure)

    def update_ticks(self) -> None:
        """Find the ticks for the limits and the size that the panel has now."""
        values = np.asarray(self.axis.get_majorticklocs(), dtype=np.float64)
        places = self._places_of(values)
        begin, end = self._ends()
        rounding = _ROUNDING * (end - begin)
        is_within = (places >= begin - rounding) & (places <= end + rounding)
        self.places = places[is_within]
        self.numbers = []
        factor = ""
        if self.shows_numbers:
            formatter = self.axis.get_major_formatter()
            # names belong to the places in the whole list
            numbers = formatter.format_ticks(values.tolist())
            self.numbers = list(compress(numbers, is_within))
            factor = formatter.get_offset()
        self.axis.get_offset_text().set_text(factor)

    def name_ticks(
        self, values: Iterable[float], names: Sequence[str], *, rotation: float = 0.0
    ) -> None:
        """Have ticks at these values only, with these names, turned by an angle in degrees."""
        self.axis.set_major_locator(FixedLocator(list(values)))
        self.axis.set_major_formatter(FixedFormatter(names))
        self._is_named = True
        if rotation:
            self._number.set(rotation=rotation, ha="right")

    def estimated_depth(self) -> float:
        """Estimated space that the ruler takes beside the panel, points."""
        label = self.axis.get_label_text()
        depth = _LINE * (label.count("\n") + 1) if label else 0.0
        if self.shows_numbers:
            depth += self.estimated_numbers
        return depth

    def draw(self, renderer: RendererBase) -> None:
        """Draw the side, the ticks, the numbers and the label."""
        if not self.panel.axison:
            return
        edge = self._outer(self.panel.bbox)
        begin, end = self._ends()
        side = (self._point(begin, edge), self._point(end, edge))
        ticks = [
            (self._point(place, edge), self._point(place, edge - self._tick))
            for place in self.places
        ]
        self._draw_side(renderer, side, ticks)
        places = [self._point(place, edge - self._distance) for place in self.places]
        self._draw_numbers(renderer, places)
        self._place_label(renderer)
        for text in (self.axis.label, self._factor(renderer)):
            if text.get_text():
                text.draw(renderer)

    def numbers_edge(self, renderer: RendererBase) -> float:
        """The edge of the numbers that is farthest from the panel, pixels."""
        edge = self._outer(self.panel.bbox)
        if not self.numbers:
            return edge - self._tick
        outermost = min(self._outer(box) for box in self._longest_boxes(renderer))
        return edge - self._distance + outermost

    def _places_of(self, values: FloatArray) -> FloatArray:
        """Where values of the axis are along the panel's side, pixels."""
        raise NotImplementedError

    def _ends(self) -> tuple[float, float]:
        """Where the panel's side begins and ends, pixels."""
        raise NotImplementedError

    def _outer(self, box: Bbox) -> float:
        """The side of a box at which the ruler of a panel lies, pixels."""
        raise NotImplementedError

    def _point(self, along: float, across: float) -> tuple[float, float]:
        """A point by its places along the panel's side and across it, pixels."""
        raise NotImplementedError

    def _place_label(self, renderer: RendererBase) -> None:
        """Place the label behind the numbers, if that is not done yet."""
        raise NotImplementedError

    def _factor(self, renderer: RendererBase) -> Text:
        """What all numbers are to be multiplied by, or their offset, in its place; empty without one."""
        raise NotImplementedError

    def _in_pixels(self, points: float) -> float:
        return points * float(self.panel.figure.dpi) / 72.0

    @property
    def _tick(self) -> float:
        """Length of a tick, pixels."""
        return self._in_pixels(_setting(f"{self.ticks}.major.size"))

    @property
    def _distance(self) -> float:
        """How far the numbers are from the panel, pixels."""
        return self._tick + self._in_pixels(_setting(f"{self.ticks}.major.pad"))

    @property
    def _label_distance(self) -> float:
        """How far the label is from the numbers, pixels."""
        return self._in_pixels(self.axis.labelpad)

    def _box_of(self, number: str, renderer: RendererBase) -> Bbox:
        """Box of a number around its place, pixels."""
        self._number.set_position((0.0, 0.0))
        self._number.set_text(number)
        return self._number.get_window_extent(renderer)

    def _longest_boxes(self, renderer: RendererBase) -> list[Bbox]:
        """Boxes of all names, or of the numbers with most digits, around their places, pixels."""
        longest = set(self.numbers)
        if not self._is_named:
            letters = max(map(len, longest))
            longest = {number for number in longest if len(number) == letters}
        return [self._box_of(number, renderer) for number in longest]

    def _draw_numbers(
        self, renderer: RendererBase, places: Iterable[tuple[float, float]]
    ) -> None:
        """Draw the numbers at these places, pixels."""
        for place, number in zip(places, self.numbers, strict=False):
            self._number.set_position(place)
            self._number.set_text(number)
            self._number.draw(renderer)

    def _draw_side(
        self, renderer: RendererBase, side: Line, ticks: Sequence[Line]
    ) -> None:
        """Draw the panel's side and the ticks."""
        draw_lines(renderer, [side], "axes.edgecolor", "axes.linewidth")
        draw_lines(renderer, ticks, f"{self.ticks}.color", f"{self.ticks}.major.width")


class BottomRuler(Ruler):
    """The ruler below a panel."""

    ticks = "xtick"
    estimated_numbers = 12.0

    def __init__(self, panel: Axes, axis: Axis) -> None:
        super().__init__(panel, axis)
        self._number.set(ha="center", va="top")

    def get_window_extent(self, renderer: RendererBase | None = None) -> Bbox:
        """Box of the ruler, pixels."""
        box = self.panel.bbox
        if not self.panel.axison or renderer is None:
            return Bbox(box.get_points())
        self.update_ticks()
        begin, end = self._ends()
        if self.numbers:
            first = self._box_of(self.numbers[0], renderer)
            last = self._box_of(self.numbers[-1], renderer)
            begin = min(begin, self.places[0] + first.x0)
            end = max(end, self.places[-1] + last.x1)
        bottom = self.numbers_edge(renderer)
        if self.axis.get_label_text():
            height = self.axis.label.get_window_extent(renderer).height
            bottom -= self._label_distance + height
        factor = self._factor(renderer)
        if factor.get_text():
            bottom = min(bottom, factor.get_window_extent(renderer).y0)
        return Bbox.from_extents(begin, bottom, end, box.y0)

    def _place_label(self, renderer: RendererBase) -> None:
        self.axis.label.set_y(self.numbers_edge(renderer) - self._label_distance)

    def _factor(self, renderer: RendererBase) -> Text:
        """Below the lower edge of the numbers."""
        factor = self.axis.get_offset_text()
        factor.set_y(self.numbers_edge(renderer) - self._in_pixels(_FACTOR_DISTANCE))
        return factor

    def _outer(self, box: Bbox) -> float:
        return float(box.y0)

    def _point(self, along: float, across: float) -> tuple[float, float]:
        return along, across

    def _places_of(self, values: FloatArray) -> FloatArray:
        points = np.column_stack([values, np.zeros_like(values)])
        places: FloatArray = self.panel.get_xaxis_transform().transform(points)[:, 0]
        return places

    def _ends(self) -> tuple[float, float]:
        return self.panel.bbox.x0, self.panel.bbox.x1


class LeftRuler(Ruler):
    """The ruler at the left of a panel."""

    ticks = "ytick"
    estimated_numbers = 26.0

    def __init__(self, panel: Axes, axis: Axis) -> None:
        super().__init__(panel, axis)
        self._number.set(ha="right", va="center_baseline")
        self.aligned: Sequence[LeftRuler] = [self]
        """Rulers whose labels this one places on one line when it is drawn, which is before the others are."""

    def get_window_extent(self, renderer: RendererBase | None = None) -> Bbox:
        """Box of the ruler, pixels."""
        box = self.panel.bbox
        if not self.panel.axison or renderer is None:
            return Bbox(box.get_points())
        self.update_ticks()
        begin, end = self._ends()
        if self.numbers:
            number = self._box_of(self.numbers[0], renderer)
            begin = min(begin, self.places[0] + number.y0)
            end = max(end, self.places[-1] + number.y1)
        left = self.numbers_edge(renderer)
        if self.axis.get_label_text():
            width = self.axis.label.get_window_extent(renderer).width
            left -= self._label_distance + width
        factor = self._factor(renderer)
        if factor.get_text():
            end = max(end, factor.get_window_extent(renderer).y1)
        return Bbox.from_extents(left, begin, box.x0, end)

    def draw(self, renderer: RendererBase) -> None:
        """Place the labels of all rulers that are aligned by this one, and draw this one."""
        self._place_labels(renderer)
        super().draw(renderer)

    def _place_labels(self, renderer: RendererBase) -> None:
        """Place the labels of all rulers that are aligned by this one."""
        if not self.aligned:
            return
        for ruler in self.aligned:
            if ruler is not self:
                ruler.update_ticks()
        edge = min(ruler.numbers_edge(renderer) for ruler in self.aligned)
        for ruler in self.aligned:
            ruler.axis.label.set_x(edge - self._label_distance)

    def _place_label(self, renderer: RendererBase) -> None:
        """Nothing: the first of the rulers that are aligned has placed it."""

    def _factor(self, renderer: RendererBase) -> Text:
        """Above the panel's side."""
        del renderer
        factor = self.axis.get_offset_text()
        factor.set_y(self.panel.bbox.y1 + self._in_pixels(_FACTOR_DISTANCE))
        return factor

    def _outer(self, box: Bbox) -> float:
        return float(box.x0)

    def _point(self, along: float, across: float) -> tuple[float, float]:
        return across, along

    def _places_of(self, values: FloatArray) -> FloatArray:
        points = np.column_stack([np.zeros_like(values), values])
        places: FloatArray = self.panel.get_yaxis_transform().transform(points)[:, 1]
        return places

    def _ends(self) -> tuple[float, float]:
        return self.panel.bbox.y0, self.panel.bbox.y1


def align(rulers: Sequence[LeftRuler]) -> None:
    """Put the labels of rulers below one another on one line."""
    for ruler in rulers:
        ruler.aligned = []
    rulers[0].aligned = rulers


def draw_lines(
    renderer: RendererBase, lines: Sequence[Line], colour: str, width: str
) -> None:
    """Draw lines as one path; `colour` and `width` are the names of settings of matplotlib."""
    vertices = np.array(lines, dtype=np.float64).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO], len(lines))
    context = renderer.new_gc()
    context.set_foreground(_setting(colour))
    context.set_linewidth(_setting(width))
    renderer.draw_path(context, Path(vertices, codes), IdentityTransform())
    context.restore()


def _setting(name: str) -> Any:
    """A setting of matplotlib."""
    settings: Any = rcParams
    return settings[name]
