"""The parameters of a rig over its sessions."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.memory import MemoryReport, ParameterChange
from twinmatch.showing.figures.drawing import empty, new_figure, stack, styled
from twinmatch.showing.quantities import parameter_format
from twinmatch.showing.style import MODEL, PLANT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NINETY = 1.645
_MOST_NAMES = 30
_TITLE = 90
"""Characters in a line of a title."""


@styled
def draw_memory(report: MemoryReport, plant: type[Plant]) -> Figure:
    """Every parameter over the sessions with its 90 % interval, and the changes that are named."""
    lessons = report.lessons
    if not lessons:
        figure = new_figure(8, 2)
        empty(figure.add_subplot(), "no session is remembered")
        return figure
    free = lessons[0].free
    figure = new_figure(max(6.0, min(0.5 * len(lessons) + 3.0, 16.0)), 1.5 * len(free) + 0.8)
    places = np.arange(len(lessons))
    names = [one.name for one in lessons]
    for k, (axes, name) in enumerate(zip(stack(figure, [1.0] * len(free)), free, strict=True)):
        shown = parameter_format(plant, name)
        values = [shown.shown(one.parameters[name]) for one in lessons]
        errors = [_NINETY * shown.factor * float(one.deviations[k]) for one in lessons]
        axes.errorbar(places, values, yerr=errors, fmt="o", ms=4, capsize=3, color=PLANT)
        axes.set_ylabel(shown.label)
        for change in report.changes:
            if change.name == name:
                _mark(axes, change, [shown.shown(level) for level in (change.old, change.new)], names)
    every = max(1, -(-len(lessons) // _MOST_NAMES))
    axes.set_xticks(places[::every], names[::every], rotation=45, ha="right")
    return figure


def _mark(axes: Axes, change: ParameterChange, levels: list[float], names: list[str]) -> None:
    """Draw a change between two levels, and say it."""
    places = np.arange(len(names))
    step = change.kind == "step"
    trend = np.linspace(levels[0], levels[1], len(names))
    line = np.where(places >= names.index(change.since), levels[1], levels[0]) if step else trend
    axes.plot(places, line, color=MODEL, lw=1.5, drawstyle="steps-mid" if step else "default")
    axes.set_title(fill(change.sentence, _TITLE), fontsize=8)
