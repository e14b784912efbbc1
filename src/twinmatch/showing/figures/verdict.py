"""A verdict on one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from twinmatch.comparing import CandidateScore, Verdict
from twinmatch.showing.figures.discrimination import draw_gains, fill_matrix
from twinmatch.showing.figures.drawing import new_figure, save, styled, time_axis
from twinmatch.showing.figures.health import draw_levels
from twinmatch.showing.standing import Shown, last_verdict, nominal_score, shown_twin
from twinmatch.showing.style import CLOSED, PLANT, SET_POINT
from twinmatch.showing.words import Words, words_of
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import TwinSettings, response_on

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_verdict"]


@styled
def draw_verdict(
    samples: Sequence[Sample], verdicts: Sequence[Verdict], settings: TwinSettings, path: Path
) -> None:
    """Plant and leading twin, trust over time, the criteria and the ν-gap matrix, on one page.

    Raises:
        TwinmatchError: matplotlib cannot write such a file there.
    """
    figure = new_figure(12, 9)
    grid = figure.add_gridspec(4, 2, height_ratios=(3, 2, 0.9, 3))
    upper = figure.add_subplot(grid[0, :])
    control = figure.add_subplot(grid[1, :], sharex=upper)
    trust = figure.add_subplot(grid[2, :], sharex=upper)
    last = last_verdict(verdicts)
    shown = shown_twin(verdicts[-1] if verdicts else None)
    for number, stretch in enumerate(unbroken(samples)):
        window = Window.from_samples(stretch, settings.period)
        _draw_signals(upper, control, window, shown, settings, label=number == 0)
    _dress(upper, control, words_of(settings.plant))
    if shown is not None:
        upper.set_title(_title(shown, nominal_score(last)))
    draw_levels(trust, verdicts, settings.period, samples[0].index)
    time_axis(trust, settings.period, samples[0].index, samples[-1].index)
    if last is not None:
        draw_gains(figure.add_subplot(grid[3, 0]), last)
        fill_matrix(figure.add_subplot(grid[3, 1]), last)
    save(figure, path)


def _draw_signals(
    upper: Axes,
    control: Axes,
    window: Window,
    shown: Shown | None,
    settings: TwinSettings,
    *,
    label: bool,
) -> None:
    """One unbroken stretch of plant and twin."""
    time, hidden = window.time, "_"  # matplotlib omits such labels from the legend
    names = ("set-point", "plant") if label else (hidden, hidden)
    if settings.gains is not None:
        upper.plot(
            time, window.reference, color=SET_POINT, lw=1, ls="--", drawstyle="steps-post", label=names[0]
        )
    upper.plot(time, window.output, color=PLANT, lw=1.2, label=names[1])
    control.plot(time, window.input, color=PLANT, lw=0.9)
    if shown is None or len(window) < 4:
        return
    twin = response_on(shown.parameters, window, settings.gains)
    name = f"twin of {shown.name}" if label else hidden
    upper.plot(time[2:], twin.output, color=CLOSED, lw=1, label=name)
    if settings.gains is not None:
        control.plot(time[2:], twin.input, color=CLOSED, lw=0.8)


def _title(shown: Shown, nominal: CandidateScore | None) -> str:
    """The twin that is drawn, and the nominal candidate."""
    order = f", order {nominal.chosen_order}" if nominal and nominal.chosen_order else ""
    centre = f"nominal: {nominal.name}{order}" if nominal else "nominal: none"
    return f"Leader: {shown.name}; {centre}"


def _dress(upper: Axes, control: Axes, words: Words) -> None:
    upper.set_ylabel(words.output_label)
    upper.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    control.set_ylabel(words.input_label)
    for axes in (upper, control):
        axes.tick_params(labelbottom=False)
