"""A controller that was tried, beside the one that ran: outputs and commands with their bands."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING, Final

import numpy as np

from twinmatch.controllers import ControllerAnswer, NextExperiment
from twinmatch.dynamics import Drive, Output, Plant
from twinmatch.showing.figures.drawing import draw_set_point, new_figure, stack, styled
from twinmatch.showing.quantities import with_unit
from twinmatch.showing.style import CLOSED, PLANT
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from twinmatch.showing.figures.elements.panel import Panel

_LETTERS: Final = 100
"""Characters per line of the sentence above the figure."""


@styled
def draw_answer(answer: ControllerAnswer) -> Figure:
    """A row for each output with its set-points, then one for each command."""
    plant = answer.plant
    figure, output_axes, input_axes = _rows_for(plant)
    for j, (axes, (name, output)) in enumerate(
        zip(output_axes, plant.outputs.items(), strict=True)
    ):
        draw_set_point(axes, answer.time, answer.references[:, j], 0.9, named=not j)
        _draw(axes, answer, "outputs", j)
        axes.set_ylabel(with_unit(name.replace("_", " "), output.unit))
    for i, (axes, (name, drive)) in enumerate(
        zip(input_axes, plant.drives.items(), strict=True)
    ):
        _draw(axes, answer, "inputs", i)
        axes.set_ylabel(
            drive.unit
            if name.lower() == drive.unit.lower()
            else with_unit(name, drive.unit)
        )
    input_axes[-1].set_xlabel("time / s")
    output_axes[0].set_title("\n".join(wrap(answer.sentence, _LETTERS)), size=9)
    figure.legend(
        *output_axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4
    )
    return figure


@styled
def draw_experiment(experiment: NextExperiment) -> Figure:
    """A row for each output with the bands of all twins, then one for each command."""
    plant = experiment.leader.parameters.model.plant
    course = experiment.course
    holding = experiment.terms.holding
    time = np.arange(len(course.rows), dtype=np.float64) * holding.period
    figure, output_axes, input_axes = _rows_for(plant)
    signals: dict[str, Output | Drive] = {**plant.outputs, **plant.drives}
    for axes, (name, signal) in zip(
        [*output_axes, *input_axes], signals.items(), strict=True
    ):
        axes.set_ylabel(with_unit(name.replace("_", " "), signal.unit))
        axes.margins(x=0.01)
    for j, axes in enumerate(output_axes):
        if holding.law is not None:
            draw_set_point(axes, time, course.rows[:, j], 0.9, named=not j)
        for k, run in enumerate(course.runs):
            _draw_run(axes, time, run.outputs[:, j], run.bands[:, j], named=not k)
    for i, axes in enumerate(input_axes):
        for run in course.runs:
            axes.plot(time, run.inputs[:, i], color=CLOSED, lw=0.8)
    input_axes[-1].set_xlabel("time / s")
    figure.legend(
        *output_axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4
    )
    return figure


def _rows_for(plant: type[Plant]) -> tuple[Figure, list[Panel], list[Panel]]:
    """A figure with a row for each output, then one for each command."""
    ratios = [2.0] * len(plant.outputs) + [1.4] * len(plant.drives)
    figure = new_figure(9.0, 1.2 + 1.3 * sum(ratios))
    axes = stack(figure, ratios)
    return figure, axes[: len(plant.outputs)], axes[len(plant.outputs) :]


def _draw_run(
    axes: Axes, time: FloatArray, middle: FloatArray, half: FloatArray, *, named: bool
) -> None:
    """One twin's output with its band of this half width."""
    label = "all twins, with their 90 % bands" if named else None
    axes.plot(time, middle, color=CLOSED, lw=0.8, label=label)
    axes.fill_between(
        time, middle - half, middle + half, color=CLOSED, alpha=0.15, lw=0
    )


def _draw(axes: Axes, answer: ControllerAnswer, kind: str, place: int) -> None:
    """The bands of both laws for one signal; `kind` is `outputs` or `inputs`."""
    if answer.running is not None:
        _band(
            axes,
            answer.time,
            getattr(answer.running, kind)[:, :, place],
            PLANT,
            "law that ran",
        )
    _band(
        axes,
        answer.time,
        getattr(answer.courses, kind)[:, :, place],
        CLOSED,
        "law that is tried",
    )
    axes.margins(x=0.01)


def _band(
    axes: Axes, time: FloatArray, rows: FloatArray, colour: str, name: str
) -> None:
    """The band of one law, with its median."""
    low, median, high = rows
    axes.fill_between(time, low, high, color=colour, alpha=0.25, lw=0)
    axes.plot(time, median, color=colour, lw=1.0, label=f"{name}: median and 90 % band")
