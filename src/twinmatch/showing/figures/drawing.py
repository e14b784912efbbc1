"""Creating and writing figures; the only module that sets matplotlib's options."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from twinmatch.errors import TwinmatchError
from twinmatch.showing.quantities import ShownSignals, with_unit
from twinmatch.showing.style import PLANT, SET_POINT, SIDE_BY_SIDE, rc
from twinmatch.signals import FloatArray, Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

    from twinmatch.showing.figures.elements.panel import Panel

P = ParamSpec("P")
R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Make a function draw with the settings of `showing.style`, without changing matplotlib's own."""

    @wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> R:
        from matplotlib import rc_context  # noqa: PLC0415

        settings: Any = rc()
        with rc_context(settings):
            return draw(*args, **kwargs)

    return inside


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, size in inches; not registered with pyplot, so it need not be closed."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    return Figure(figsize=(width, height), layout="constrained")


def panel(
    figure: Figure, cell: SubplotSpec | None = None, sharex: Axes | None = None
) -> Panel:
    """Axes in a cell of the figure, or in the whole of it."""
    from twinmatch.showing.figures.elements.panel import Panel  # noqa: PLC0415

    where: tuple[SubplotSpec, ...] = () if cell is None else (cell,)
    add: Any = figure.add_subplot
    added: Panel = add(*where, axes_class=Panel, sharex=sharex)
    return added


def stack(
    figure: Figure, ratios: Sequence[float], cell: SubplotSpec | None = None
) -> list[Panel]:
    """Axes with one time axis below one another, heights in these ratios, in the figure or a cell of it."""
    axes: list[Panel] = []
    shape: Any = {"nrows": len(ratios), "ncols": 1, "height_ratios": list(ratios)}
    grid = figure.add_gridspec(**shape) if cell is None else cell.subgridspec(**shape)
    for row in range(len(ratios)):
        axes.append(panel(figure, grid[row, 0], axes[0] if axes else None))
    for upper in axes[:-1]:
        upper.below.shows_numbers = False
    return axes


def align_labels(panels: Sequence[Panel]) -> None:
    """Put the labels at the left of panels below one another on one line."""
    from twinmatch.showing.figures.elements import panel  # noqa: PLC0415

    panel.align_labels(panels)


def cells_for(number: int, cell: SubplotSpec) -> list[SubplotSpec]:
    """Cells of a grid for each of some signals, side by side as far as they have room; for one the whole."""
    if number == 1:
        return [cell]
    wide = min(number, SIDE_BY_SIDE)
    grid = cell.subgridspec(-(-number // wide), wide)
    return [grid[k // wide, k % wide] for k in range(number)]


def columns(
    width: float, height: float, ratios: Sequence[float], number: int
) -> tuple[Figure, list[list[Panel]]]:
    """A figure with a stack for each of some signals; one fills a figure of this size, in inches."""
    wide = min(number, SIDE_BY_SIDE)
    figure = new_figure(width * (1.0 + 0.4 * (wide - 1)), height * -(-number // wide))
    if number == 1:
        return figure, [stack(figure, ratios)]
    whole = figure.add_gridspec(1, 1)[0, 0]
    return figure, [stack(figure, ratios, cell) for cell in cells_for(number, whole)]


def _arrange(figure: Figure) -> None:
    """Lay the figure out once; matplotlib would otherwise repeat that for every file."""
    from twinmatch.showing.figures.elements.panel import estimate_panels_once  # noqa: PLC0415

    engine = figure.get_layout_engine()
    if engine is not None:
        estimate_panels_once(figure)
        engine.execute(figure)
        # with another, matplotlib would draw the figure twice
        figure.set_layout_engine(None)
        for axes in figure.axes:
            # the solver's last digits vary between runs, and so would names in an SVG
            x, y, width, height = (
                round(edge, 6) for edge in axes.get_position(original=True).bounds
            )
            axes.set_position((x, y, width, height))


@styled
def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file's suffix (.png, .svg, .pdf).

    Raises:
        TwinmatchError: matplotlib cannot write such a file there.
    """
    _arrange(figure)
    # the same figure, the same file
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    try:
        figure.savefig(path, metadata=undated.get(path.suffix.lower()))
    except (OSError, ValueError) as error:
        raise TwinmatchError(
            f"{path}: the figure cannot be written: {error}"
        ) from error


@styled
def png(figure: Figure, dpi: int = 100) -> bytes:
    """The figure as a PNG, for example for notebooks."""
    _arrange(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


@styled
def svg(figure: Figure) -> str:
    """The figure as an SVG document."""
    from twinmatch.showing.figures.elements.svg import document  # noqa: PLC0415

    return document(figure, _arrange)


def time_axis(axes: Axes, period: float, first: int, last: int) -> None:
    """Label the time axis in seconds and limit it to the samples."""
    axes.set_xlim(first * period, max(last * period, first * period + period))
    axes.set_xlabel("time since the session began / s")


def name_signals(axes: Sequence[Axes], signals: ShownSignals, difference: str) -> None:
    """Label output, input, and the differences of both, as far as there are axes."""
    labels = [signal.label for signal in signals] + [
        with_unit(difference, signal.unit) for signal in signals
    ]
    for signal_axes, label in zip(axes, labels, strict=False):
        signal_axes.set_ylabel(label)


def empty(axes: Axes, words: str) -> None:
    """Show text in place of an empty chart."""
    axes.set_axis_off()
    axes.text(
        0.5,
        0.5,
        words,
        ha="center",
        va="center",
        transform=axes.transAxes,
        color="#5C5C5C",
    )


def draw_set_point(
    axes: Axes, time: FloatArray, reference: FloatArray, width: float, *, named: bool
) -> None:
    """The set-point as dashed steps; in the legend if `named`."""
    name = "set-point" if named else "_"  # matplotlib omits such labels from the legend
    axes.plot(
        time,
        reference,
        color=SET_POINT,
        lw=width,
        ls="--",
        drawstyle="steps-post",
        label=name,
    )


def draw_outputs(
    axes: Axes,
    window: Window,
    *,
    closed: bool,
    named: bool = True,
    plant: str = "plant",
    **line: Any,
) -> None:
    """The measured output of the plant, called so in the legend, and, if `closed`, its set-point."""
    if closed:
        draw_set_point(axes, window.time, window.reference, 1, named=named)
    axes.plot(
        window.time, window.output, color=PLANT, label=plant if named else "_", **line
    )


def draw_inputs(
    axes: Axes, window: Window, width: float, *, named: bool = False
) -> None:
    """The measured input of the plant."""
    axes.plot(
        window.time,
        window.input,
        color=PLANT,
        lw=width,
        label="plant" if named else "_",
    )


def legend_above(
    axes: Axes, columns: int, height: float = 1.0, **spacing: float
) -> None:
    """The legend above the right end of a chart."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, height), ncols=columns, **spacing
    )
