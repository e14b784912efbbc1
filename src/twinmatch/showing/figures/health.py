"""Health over time: trust level, difference between twin and plant, and results of the matches."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.showing.events import admitted, level_stretches
from twinmatch.showing.figures.drawing import empty, new_figure, stack, styled, time_axis
from twinmatch.showing.style import LEVELS, PLANT, TEXT
from twinmatch.showing.words import words_of
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport, TwinSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_health", "draw_levels"]

_HEIGHTS = {TrustLevel.UNKNOWN: 0, TrustLevel.TRUSTED: 1, TrustLevel.DOUBTFUL: 2, TrustLevel.FAULT: 3}
_DRAWN = 1.6
"""A limit is drawn if it is at most this factor above the top of the axis."""


@styled
def draw_health(
    samples: Sequence[Sample],
    matches: Sequence[MatchReport],
    verdicts: Sequence[Verdict],
    settings: TwinSettings,
) -> Figure:
    """Trust level, misses of every verdict with their limit, matches admitted and refused."""
    figure = new_figure(10, 4.8)
    axes = stack(figure, (1.2, 2, 2, 0.9))
    first, period = samples[0].index, settings.period
    draw_levels(axes[0], verdicts, period, first)
    limits = settings.limits
    words = words_of(settings.plant)
    _draw_residual(axes[1], verdicts, "miss_y", period, limits.doubtful)
    axes[1].set_ylabel(f"{words.output}\nmiss / half band")
    _draw_residual(axes[2], verdicts, "miss_u", period, limits.doubtful)
    axes[2].set_ylabel(f"{words.input}\nmiss / half band")
    _draw_matches(axes[3], matches, admitted(verdicts), period, words.output_unit)
    time_axis(axes[-1], period, first, samples[-1].index)
    figure.align_ylabels(axes)
    return figure


def draw_levels(axes: Axes, verdicts: Sequence[Verdict], period: float, first: int = 0) -> None:
    """The trust level as a band, shown by height as well as colour."""
    for stretch in level_stretches(verdicts, first):
        begin, end = stretch.first * period, (stretch.last + 1) * period
        height = _HEIGHTS[stretch.level]
        axes.fill_between([begin, end], -0.5, height + 0.5, color=LEVELS[stretch.level], lw=0)
    axes.set_ylim(-0.5, 3.5)
    axes.set_yticks(list(_HEIGHTS.values()), [level.value for level in _HEIGHTS])
    axes.grid(visible=False)
    axes.set_ylabel("trust")


def _draw_residual(
    axes: Axes, verdicts: Sequence[Verdict], attribute: str, period: float, limit: float
) -> None:
    known = [v for v in verdicts if getattr(v, attribute) == getattr(v, attribute)]
    values = [float(getattr(v, attribute)) for v in known]
    if not values:
        empty(axes, "no residual: there is no candidate")
        return
    axes.plot([v.sample * period for v in known], values, color=PLANT, marker=".", ms=4, lw=1)
    top = 1.15 * max(values)
    if limit <= _DRAWN * top:
        axes.axhline(limit, color=LEVELS[TrustLevel.DOUBTFUL], lw=1.2, ls="--")
        axes.annotate(
            f"doubtful from {limit:g}",
            (0.0, limit),
            (4, 2),
            xycoords=axes.get_yaxis_transform(),
            textcoords="offset points",
            fontsize=8,
        )
        top = max(top, 1.2 * limit)
    else:
        axes.annotate(
            f"(doubtful from {limit:g}, beyond this axis)",
            (1.0, 0.97),
            xycoords="axes fraction",
            ha="right",
            va="top",
            fontsize=8,
        )
    axes.set_ylim(0, top)


def _draw_matches(
    axes: Axes, matches: Sequence[MatchReport], joined: Collection[int], period: float, unit: str
) -> None:
    for inside, marker, colour in (
        (True, "o", LEVELS[TrustLevel.TRUSTED]),
        (False, "x", LEVELS[TrustLevel.FAULT]),
    ):
        times = [m.sample * period for m in matches if (m.sample in joined) is inside]
        axes.plot(times, [1.0 if inside else 0.0] * len(times), marker, color=colour, ms=6, mew=1.6, ls="")
    for m in matches:
        axes.annotate(
            f"{m.operating_point:g}",
            (m.sample * period, 1.0 if m.sample in joined else 0.0),
            (0, 5),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color=TEXT,
        )
    axes.set_ylim(-0.6, 2.0)
    axes.set_yticks([0, 1], ["refused", "admitted"])
    axes.set_ylabel(f"matches\n({unit})" if unit else "matches")
