"""Figures as SVG documents, with each text in them once."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from matplotlib.backend_bases import FigureCanvasBase, GraphicsContextBase
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_svg import RendererSVG

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties

_PER_INCH: Final = 72.0
"""Units of an SVG document in an inch."""


class _TextsOnce(RendererSVG):
    """Writes a text where it first occurs, and refers to it wherever it is repeated, as most numbers at ticks are.

    To turn a text into the outlines of its letters takes longer than to draw a line of a thousand samples.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        begin: Any = super().__init__
        begin(*args, **options)
        self._written: set[str] = set()

    def draw_text(  # noqa: PLR0917
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        """Draw a text at a place, or refer to the same text with the same look."""
        write: Any = super().draw_text
        writer: Any = self.writer
        if gc.get_clip_rectangle() is not None or gc.get_clip_path()[0] is not None:
            write(gc, x, y, s, prop, angle, ismath, mtext)
            return
        name = _name_of(gc, s, prop, angle)
        if name not in self._written:
            self._written.add(name)
            writer.start("defs")
            writer.start("g", id=name)
            write(gc, 0.0, 0.0, s, prop, angle, ismath, mtext)
            writer.end("g")
            writer.end("defs")
        place = {"xlink:href": f"#{name}", "x": f"{x:.3f}", "y": f"{y:.3f}"}
        writer.element("use", attrib=place)


def _name_of(
    gc: GraphicsContextBase, text: str, font: FontProperties, angle: float
) -> str:
    """A name for a text with its look: the same in all documents, several of which may be on one page."""
    look = (
        text,
        font.get_family(),
        font.get_style(),
        font.get_weight(),
        font.get_size_in_points(),
        angle,
        gc.get_rgb(),
    )
    return f"text-{hashlib.sha1(repr(look).encode(), usedforsecurity=False).hexdigest()[:12]}"


class _Canvas(FigureCanvasBase):
    """Has a figure measured by the renderer that draws it, which then knows the sizes of its texts."""

    def __init__(self, figure: Figure, renderer: MixedModeRenderer) -> None:
        super().__init__(figure)
        self._renderer = renderer

    def get_renderer(self) -> MixedModeRenderer:
        """The renderer."""
        return self._renderer


def document(figure: Figure, arrange: Callable[[Figure], None]) -> str:
    """A figure as an SVG document; `arrange` lays it out."""
    stream = io.StringIO()
    resolution = figure.dpi
    width, height = figure.get_size_inches()
    figure.dpi = _PER_INCH
    vectors = _TextsOnce(
        width * _PER_INCH,
        height * _PER_INCH,
        stream,
        image_dpi=resolution,
        # the same figure, the same document
        metadata={"Date": None},
    )
    mixed: Any = MixedModeRenderer
    renderer = mixed(figure, width, height, resolution, vectors)
    _Canvas(figure, renderer)
    arrange(figure)
    figure.draw(renderer)
    renderer.finalize()
    figure.dpi = resolution
    return stream.getvalue()
