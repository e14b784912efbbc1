"""The whole session: plant, closed-loop twin and driven twin, and their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from twinmatch.comparing import Verdict
from twinmatch.showing.comparison import Comparison, compare, rolling_rms
from twinmatch.showing.figures.drawing import new_figure, stack, styled, time_axis
from twinmatch.showing.standing import shown_twin
from twinmatch.showing.style import CLOSED, DRIVEN, PLANT, SET_POINT
from twinmatch.showing.words import with_unit, words_of
from twinmatch.signals import FloatArray, Sample, Window, unbroken
from twinmatch.twin import TwinSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_session"]

BAND = 60
"""Samples over which the residual's band is computed."""
_SHOWN = 0.99
"""Share of the residuals that the axis must show; the rest are peaks of a sample or two at a step."""


@styled
def draw_session(samples: Sequence[Sample], verdicts: Sequence[Verdict], settings: TwinSettings) -> Figure:
    """Output and input of the plant and of the leader's twins, and the residuals with their 95 % band.

    Where the loop is not known, there is only the driven twin, which has the plant's input.
    """
    shown = shown_twin(verdicts[-1] if verdicts else None)
    parts = compare(samples, shown.parameters, settings.gains, settings.period) if shown else ()
    closed = settings.gains is not None
    rows = (4 if closed else 3) if parts else 2
    figure = new_figure(10, 1.75 * rows)
    axes = stack(figure, (3, 2, 1.6, 1.6)[:rows])
    for number, stretch in enumerate(unbroken(samples)):
        window = Window.from_samples(stretch, settings.period)
        _draw_plant(axes[0], axes[1], window, first=number == 0, closed=closed)
    for number, part in enumerate(parts):
        _draw_twins(axes[0], axes[1], part, first=number == 0)
        _draw_residuals(axes[2:], part, first=number == 0)
    words = words_of(settings.plant)
    axes[0].set_ylabel(words.output_label)
    axes[1].set_ylabel(words.input_label)
    if parts:
        axes[2].set_ylabel(with_unit("plant − twin", words.output_unit))
        _limit(axes[2], [p.closed_residual_y for p in parts] + [p.driven_residual_y for p in parts])
    if parts and closed:
        axes[3].set_ylabel(with_unit("plant − twin", words.input_unit))
        _limit(axes[3], [p.closed_residual_u for p in parts])
    for each in axes:
        if each.get_legend_handles_labels()[0]:
            each.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=5, borderaxespad=0.2)
    time_axis(axes[-1], settings.period, samples[0].index, samples[-1].index)
    return figure


def _limit(axes: Axes, residuals: Sequence[FloatArray]) -> None:
    """Cut off the few highest peaks, with a note on the chart."""
    size = np.abs(np.concatenate(residuals))
    shown, highest = 1.4 * float(np.quantile(size, _SHOWN)), float(np.max(size))
    if not 0 < shown < highest:
        return
    axes.set_ylim(-shown, shown)
    axes.annotate(
        f"(peaks up to {highest:.3g} are cut off)",
        (0.004, 0.97),
        xycoords="axes fraction",
        va="top",
        fontsize=8,
    )


def _draw_plant(upper: Axes, control: Axes, window: Window, *, first: bool, closed: bool) -> None:
    hidden = "_"  # matplotlib omits such labels from the legend
    if closed:
        upper.plot(
            window.time,
            window.reference,
            color=SET_POINT,
            lw=1,
            ls="--",
            drawstyle="steps-post",
            label="set-point" if first else hidden,
        )
    upper.plot(window.time, window.output, color=PLANT, label="plant" if first else hidden)
    control.plot(window.time, window.input, color=PLANT, lw=0.8, label="plant" if first else hidden)


def _draw_twins(upper: Axes, control: Axes, part: Comparison, *, first: bool) -> None:
    closed, driven = ("closed-loop twin", "driven twin") if first else ("_", "_")
    if part.closed is not None:
        upper.plot(part.time, part.closed.output, color=CLOSED, lw=1, label=closed)
    upper.plot(part.time, part.driven, color=DRIVEN, lw=1, ls=":", label=driven)
    if part.closed is not None:
        control.plot(part.time, part.closed.input, color=CLOSED, lw=0.8, label=closed)


def _draw_residuals(axes: Sequence[Axes], part: Comparison, *, first: bool) -> None:
    """Residuals of the output and, in closed loop, of the input, with their band."""
    driven = "driven twin" if first else "_"
    if part.closed is None:
        _draw_banded(axes[0], part.time, part.driven_residual_y, DRIVEN, driven if first else "")
        return
    for each, residual in zip(axes, (part.closed_residual_y, part.closed_residual_u), strict=True):
        _draw_banded(each, part.time, residual, CLOSED, "closed-loop twin" if first else "")
    axes[0].plot(part.time, part.driven_residual_y, color=DRIVEN, lw=0.9, ls=":", label=driven)


def _draw_banded(axes: Axes, time: FloatArray, residual: FloatArray, colour: str, name: str) -> None:
    """A residual and its rolling band, with a legend entry if it has a name."""
    band, width = f"±2 RMS over {BAND} samples" if name else "_", 2 * rolling_rms(residual, BAND)
    axes.fill_between(time, -width, width, color=colour, alpha=0.18, lw=0, label=band)
    axes.plot(time, residual, color=colour, lw=0.7, label=name or "_")
    axes.axhline(0, color=SET_POINT, lw=0.6)
