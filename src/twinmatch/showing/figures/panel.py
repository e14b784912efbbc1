"""Axes that are measured once for every layout of their figure."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

_TICK_LABEL: Final = (12.0, 26.0)
"""Estimated height of the tick labels of a horizontal axis, and width of those of a vertical one, with ticks
and distances, points."""
_LINE: Final = 14.0
"""Estimated height of a line of a label or a title, with its distance, points."""


@cache
def panel_class() -> type[Axes]:
    """The class of the axes; importing matplotlib is left to the first figure."""
    from matplotlib import rcParams  # noqa: PLC0415
    from matplotlib.axes import Axes  # noqa: PLC0415
    from matplotlib.transforms import Bbox  # noqa: PLC0415

    class Panel(Axes):
        """Axes that estimate their decorations in the first of the two rounds of a layout.

        matplotlib lays a figure out twice and measures all texts each time, since ticks may change with the size
        of the axes. The first round only has to bring the axes near their final size.
        """

        _is_estimated = False

        def estimate_once(self) -> None:
            """Estimate in the next round of a layout instead of measuring."""
            self._is_estimated = True

        def get_tightbbox(self, *args: Any, **options: Any) -> Any:
            """The box of the axes with their decorations, in pixels."""
            if self._is_estimated:
                self._is_estimated = False
                return self._estimated_box()
            return super().get_tightbbox(*args, **options)

        def _estimated_box(self) -> Bbox:
            inner = self.bbox
            if not self.axison:
                return Bbox(inner.get_points())
            per_point = self.figure.dpi / 72.0
            title = self.get_title(rcParams["axes.titlelocation"])
            above = _LINE * (title.count("\n") + 1) if title else 0.0
            below = _depth(self.xaxis, _TICK_LABEL[0], "labelbottom")
            left = _depth(self.yaxis, _TICK_LABEL[1], "labelleft")
            return Bbox.from_extents(
                inner.x0 - left * per_point,
                inner.y0 - below * per_point,
                inner.x1,
                inner.y1 + above * per_point,
            )

    return Panel


def estimate_panels_once(figure: Figure) -> None:
    """In the next round of a layout, have panels estimate what belongs to them.

    Not those that keep their shape, which are placed by what surrounds them.
    """
    for axes in figure.axes:
        estimate = getattr(axes, "estimate_once", None)
        if estimate is not None and axes.get_aspect() == "auto":
            estimate()


def _depth(axis: Axis, tick_labels: float, shown: str) -> float:
    """Estimated space that an axis takes beside its panel, points."""
    label = axis.get_label_text()
    depth = _LINE * (label.count("\n") + 1) if label else 0.0
    if axis.get_tick_params().get(shown, True):
        depth += tick_labels
    return depth
