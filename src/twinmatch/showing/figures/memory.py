"""The parameters of a rig over its sessions."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Final

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.memory import MemoryReport, ParameterChange
from twinmatch.settings import Rule
from twinmatch.showing.figures.drawing import empty, new_figure, panel, stack, styled
from twinmatch.showing.quantities import ParameterFormat, parameter_format
from twinmatch.showing.style import MODEL, PLANT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NINETY = 1.645
"""Half width of a normal distribution's band of nine in ten, standard deviations."""


class _NameLimits(Rule):
    """How names are written."""

    most: int = 30
    """Most names below the axis; of more sessions every second, third, … is named."""
    title: int = 90
    """Characters in a line of a title."""


_NAMES: Final = _NameLimits()


@styled
def draw_memory(report: MemoryReport, plant: type[Plant]) -> Figure:
    """Every parameter over the sessions with its 90 % interval, and the changes that are named."""
    lessons = report.lessons
    if not lessons:
        figure = new_figure(8, 2)
        empty(panel(figure), "no session is remembered")
        return figure
    free = lessons[0].free
    figure = new_figure(
        max(6.0, min(0.5 * len(lessons) + 3.0, 16.0)), 1.5 * len(free) + 0.8
    )
    all_axes = stack(figure, [1.0] * len(free))
    for k, axes in enumerate(all_axes):
        _draw_course(axes, report, k, parameter_format(plant, free[k]))
    axes = all_axes[-1]
    places = np.arange(len(lessons))
    names = [lesson.name for lesson in lessons]
    interval = max(1, -(-len(lessons) // _NAMES.most))
    axes.below.name_ticks(places[::interval], names[::interval], rotation=45.0)
    return figure


def _draw_course(
    axes: Axes, report: MemoryReport, k: int, shown: ParameterFormat
) -> None:
    """The k-th free parameter over the sessions, and its changes."""
    lessons = report.lessons
    values = [shown.shown(lesson.parameters[shown.name]) for lesson in lessons]
    errors = [
        _NINETY * shown.factor * float(lesson.deviations[k]) for lesson in lessons
    ]
    axes.errorbar(
        np.arange(len(lessons)),
        values,
        yerr=errors,
        fmt="o",
        ms=4,
        capsize=3,
        color=PLANT,
    )
    axes.set_ylabel(shown.label)
    names = [lesson.name for lesson in lessons]
    for change in report.changes:
        if change.name == shown.name:
            _mark(
                axes, change, [shown.shown(change.old), shown.shown(change.new)], names
            )


def _mark(
    axes: Axes, change: ParameterChange, levels: list[float], names: list[str]
) -> None:
    """Draw a change between two levels, and say it."""
    places = np.arange(len(names))
    step = change.kind == "step"
    trend = np.linspace(levels[0], levels[1], len(names))
    line = (
        np.where(places >= names.index(change.since), levels[1], levels[0])
        if step
        else trend
    )
    axes.plot(
        places, line, color=MODEL, lw=1.5, drawstyle="steps-mid" if step else "default"
    )
    axes.set_title(fill(change.sentence, _NAMES.title), fontsize=8)
