"""Responses of the family: each twin and model on its measured window, and all twins on one window."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.showing.family import Member
from twinmatch.showing.figures.drawing import new_figure, stack, styled
from twinmatch.showing.style import CLOSED, FAMILY_MAP, MODEL, PLANT, SET_POINT
from twinmatch.showing.words import with_unit, words_of
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import response_on

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_responses", "draw_uncertainty", "family_colours"]

_SKIPPED = 2


@styled
def draw_responses(members: Sequence[Member]) -> Figure:
    """For every candidate its measured window, and the responses of its twin and Box–Jenkins model."""
    columns = 2
    rows = -(-len(members) // columns)
    figure = new_figure(10, 2.7 * rows + 0.3)
    grids = figure.add_gridspec(rows, columns, wspace=0.04, hspace=0.06)
    for k, member in enumerate(members):
        inner = grids[k // columns, k % columns].subgridspec(2, 1, height_ratios=(3, 2))
        upper = figure.add_subplot(inner[0])
        control = figure.add_subplot(inner[1], sharex=upper)
        _draw_member(upper, control, member)
        if k % columns == 0:
            words = words_of(member.settings.plant)
            upper.set_ylabel(words.output_label)
            control.set_ylabel(words.input_label)
        if k // columns == rows - 1 or k + columns >= len(members):
            control.set_xlabel("time / s")
        if k == 0:
            figure.legend(
                *upper.get_legend_handles_labels(), loc="outside upper right", ncols=4, borderaxespad=0
            )
    return figure


def _draw_member(upper: Axes, control: Axes, member: Member) -> None:
    window, order = member.window, member.score.chosen_order
    twin, model = member.quiet_twin, member.simulated(order)
    time = window.time[_SKIPPED:]
    closed = member.settings.gains is not None
    if closed:
        _draw_set_point(upper, window)
    upper.plot(window.time, window.output, color=PLANT, lw=1.4, label="plant")
    upper.plot(time, twin.output, color=CLOSED, lw=1, label="twin")
    upper.plot(time, model.output, color=MODEL, lw=0.9, ls=(0, (1, 1.2)), label="Box–Jenkins B/F")
    control.plot(window.time, window.input, color=PLANT, lw=0.9)
    if closed:
        control.plot(time, twin.input, color=CLOSED, lw=0.9)
        control.plot(time, model.input, color=MODEL, lw=0.8, ls=(0, (1, 1.2)))
    mark = ", nominal" if member.nominal else ""
    upper.set_title(f"{member.score.name}, order {order}{mark}", weight="bold" if member.nominal else None)
    upper.tick_params(labelbottom=False)
    upper.margins(x=0.01)


@styled
def draw_uncertainty(members: Sequence[Member]) -> Figure:
    """The twins of all candidates on the nominal one's window; their spread is the uncertainty."""
    nominal = next((m for m in members if m.nominal), members[0])
    window = nominal.window
    answers = [response_on(m.score.parameters, window, m.settings.gains) for m in members]
    figure = new_figure(10, 6.2)
    axes = stack(figure, (3, 2, 1.5, 1.5))
    time = window.time[_SKIPPED:]
    if nominal.settings.gains is not None:
        _draw_set_point(axes[0], window)
    axes[0].plot(window.time, window.output, color=PLANT, lw=2, label="plant")
    axes[1].plot(window.time, window.input, color=PLANT, lw=1.6)
    for member, answer, colour in zip(members, answers, family_colours(len(members)), strict=True):
        style: dict[str, Any] = (
            {"color": CLOSED, "lw": 1.4} if member.nominal else {"color": colour, "lw": 0.9}
        )
        name = f"twin of {member.score.name}{' (nominal)' if member.nominal else ''}"
        axes[0].plot(time, answer.output, label=name, zorder=3 if member.nominal else 2, **style)
        axes[1].plot(time, answer.input, zorder=3 if member.nominal else 2, **style)
    for place, name in ((2, "output"), (3, "input")):
        table = np.stack([getattr(answer, name) for answer in answers])
        _draw_spread(axes[place], time, table, members)
    words = words_of(nominal.settings.plant)
    for each, unit in zip(axes[2:], (words.output_unit, words.input_unit), strict=True):
        each.set_ylabel(with_unit("minus nominal", unit))
    axes[0].set_ylabel(words.output_label)
    axes[1].set_ylabel(words.input_label)
    axes[-1].set_xlabel("time since the session began / s")
    axes[0].margins(x=0.005)
    figure.align_ylabels(axes)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=min(5, len(members) + 2)
    )
    return figure


def _draw_set_point(axes: Axes, window: Window) -> None:
    axes.plot(
        window.time,
        window.reference,
        color=SET_POINT,
        lw=0.9,
        ls="--",
        drawstyle="steps-post",
        label="set-point",
    )


def _draw_spread(axes: Axes, time: FloatArray, table: FloatArray, members: Sequence[Member]) -> None:
    """Difference of every twin of the family from the nominal one, and the band they span."""
    nominal = next((k for k, m in enumerate(members) if m.nominal), 0)
    difference = table - table[nominal]
    low, high = np.min(difference, axis=0), np.max(difference, axis=0)
    axes.fill_between(time, low, high, color=CLOSED, alpha=0.2, lw=0)
    for k, colour in enumerate(family_colours(len(members))):
        if k != nominal:
            axes.plot(time, difference[k], color=colour, lw=0.9)
    axes.axhline(0, color=CLOSED, lw=1.2)


def family_colours(count: int) -> list[tuple[float, ...]]:
    """A colour for every candidate, coldest operating point first."""
    from matplotlib import colormaps  # noqa: PLC0415

    return [tuple(c) for c in colormaps[FAMILY_MAP](np.linspace(0.0, 0.9, max(count, 1)))[:count]]
