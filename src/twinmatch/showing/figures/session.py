"""The whole session: plant and twins with their residuals, trust and matches, and a verdict on one page."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.comparing import CandidateScore, TrustLevel, Verdict
from twinmatch.dynamics import Plant, channels
from twinmatch.offline.estimates import EstimatedCourse
from twinmatch.offline.summary import ShownTwin, Tally, nominal_score, shown_twin
from twinmatch.showing.figures.drawing import (
    align_labels,
    cells_for,
    columns,
    draw_inputs,
    draw_outputs,
    empty,
    legend_above,
    name_signals,
    new_figure,
    panel,
    save,
    stack,
    styled,
    time_axis,
)
from twinmatch.showing.figures.family import draw_gains, fill_matrix
from twinmatch.showing.quantities import (
    outputs_unit,
    shown_outputs,
    shown_signals,
    signal_names,
)
from twinmatch.showing.series import Comparison, compare, rolling_rms
from twinmatch.showing.style import (
    CLOSED,
    DRIVEN,
    LEVELS,
    MODEL,
    PLANT,
    SET_POINT,
    TEXT,
)
from twinmatch.showing.verdicts import admitted, last_verdict
from twinmatch.signals import FloatArray, Sample, Window, point_text, stretches
from twinmatch.twin import MatchReport, TwinSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from twinmatch.showing.figures.elements.panel import Panel


BAND = 60
"""Samples over which the residual's band is computed."""
_SHOWN = 0.99
"""Share of the residuals that the axis must show; the rest are peaks of a sample or two at a step."""


@styled
def draw_session(
    samples: Sequence[Sample],
    verdicts: Sequence[Verdict],
    settings: TwinSettings,
    settled: Sequence[Window],
) -> Figure:
    """Output and input of the plant and of the leader's twins, and the residuals with their 95 % band.

    `settled` are the stretches of the samples as the twin took them; its twins are compared with these.
    Where the loop is not known, there is only the driven twin, which has the plant's input.
    """
    parts = _compared(settled, verdicts, settings)
    closed = settings.law is not None
    rows = 2
    if parts:
        rows = 4 if closed else 3
    loops = channels(settings.plant)
    figure, stacks = columns(10, 1.75 * rows, (3, 2, 1.6, 1.6)[:rows], len(loops))
    windows = stretches(samples, settings.period)
    for k, (axes, loop) in enumerate(zip(stacks, loops, strict=True)):
        _draw_loop(
            axes,
            loop,
            [w.alone(k) for w in windows],
            [p.alone(k) for p in parts],
            closed=closed,
        )
        time_axis(axes[-1], settings.period, samples[0].index, samples[-1].index)
    return figure


def _compared(
    settled: Sequence[Window], verdicts: Sequence[Verdict], settings: TwinSettings
) -> Sequence[Comparison]:
    """The leader's twins beside the plant, in each settled stretch; none where there is no leader."""
    shown = shown_twin(verdicts[-1] if verdicts else None)
    if shown is None:
        return ()
    return compare(settled, shown.parameters, settings)


def _draw_loop(
    axes: Sequence[Axes],
    plant: type[Plant],
    windows: Sequence[Window],
    parts: Sequence[Comparison],
    *,
    closed: bool,
) -> None:
    """One output and one input, with what the twins say of them."""
    for number, window in enumerate(windows):
        draw_outputs(axes[0], window, closed=closed, named=number == 0)
        draw_inputs(axes[1], window, 0.8, named=number == 0)
    for number, part in enumerate(parts):
        _draw_twins(axes[0], axes[1], part, first=number == 0)
        _draw_residuals(axes[2:], part, first=number == 0)
    name_signals(axes, signal_names(plant), "plant − twin")
    if parts:
        _limit(
            axes[2],
            [p.closed_residual_y for p in parts] + [p.driven_residual_y for p in parts],
        )
    if parts and closed:
        _limit(axes[3], [p.closed_residual_u for p in parts])
    for signal_axes in axes:
        if signal_axes.get_legend_handles_labels()[0]:
            legend_above(signal_axes, 5, 0.98, borderaxespad=0.2)


def _limit(axes: Axes, residuals: Sequence[FloatArray]) -> None:
    """Cut off the few highest peaks, with a note on the chart."""
    size = np.abs(np.concatenate(residuals))
    shown = 1.4 * float(np.quantile(size, _SHOWN))
    highest = float(np.max(size))
    if not 0 < shown < highest:
        return
    axes.set_ylim(-shown, shown)
    note = f"(peaks up to {highest:.3g} are cut off)"
    axes.annotate(note, (0.004, 0.97), xycoords="axes fraction", va="top", fontsize=8)


def _draw_twins(upper: Axes, control: Axes, part: Comparison, *, first: bool) -> None:
    closed, driven = ("closed-loop twin", "driven twin") if first else ("_", "_")
    if part.closed is not None:
        upper.plot(part.time, part.closed.output, color=CLOSED, lw=1, label=closed)
        control.plot(part.time, part.closed.input, color=CLOSED, lw=0.8, label=closed)
    upper.plot(part.time, part.driven_output, color=DRIVEN, lw=1, ls=":", label=driven)


def _draw_residuals(axes: Sequence[Axes], part: Comparison, *, first: bool) -> None:
    """Residuals of the output and, in closed loop, of the input, with their band."""
    driven = "driven twin" if first else "_"
    if part.closed is None:
        _draw_banded(
            axes[0],
            part.received,
            part.driven_residual_y,
            DRIVEN,
            driven if first else "",
        )
        return
    for signal_axes, residual in zip(
        axes, (part.closed_residual_y, part.closed_residual_u), strict=True
    ):
        _draw_banded(
            signal_axes,
            part.received,
            residual,
            CLOSED,
            "closed-loop twin" if first else "",
        )
    axes[0].plot(
        part.received,
        part.driven_residual_y,
        color=DRIVEN,
        lw=0.9,
        ls=":",
        label=driven,
    )


def _draw_banded(
    axes: Axes, time: FloatArray, residual: FloatArray, colour: str, name: str
) -> None:
    """A residual and its rolling band, with a legend entry if it has a name."""
    band = f"±2 RMS over {BAND} samples" if name else "_"
    width = 2 * rolling_rms(residual, BAND)
    axes.fill_between(time, -width, width, color=colour, alpha=0.18, lw=0, label=band)
    axes.plot(time, residual, color=colour, lw=0.7, label=name or "_")
    axes.axhline(0, color=SET_POINT, lw=0.6)


_HEIGHTS = {
    TrustLevel.UNKNOWN: 0,
    TrustLevel.TRUSTED: 1,
    TrustLevel.DOUBTFUL: 2,
    TrustLevel.FAULT: 3,
}
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
    misses_of = _misses(verdicts, settings.plant, closed=settings.law is not None)
    figure = new_figure(10, 2.1 + 1.35 * len(misses_of))
    axes = stack(figure, (1.2, *[2] * len(misses_of), 0.9))
    first = samples[0].index
    period = settings.period
    _draw_levels(axes[0], verdicts, period, first)
    for signal_axes, (name, misses) in zip(axes[1:-1], misses_of.items(), strict=True):
        _draw_misses(signal_axes, misses, period, settings.limits.doubtful)
        signal_axes.set_ylabel(f"{name}\nmiss / half band")
    _draw_matches(
        axes[-1], matches, admitted(verdicts), period, outputs_unit(settings.plant)
    )
    time_axis(axes[-1], period, first, samples[-1].index)
    align_labels(axes)
    return figure


def _draw_levels(
    axes: Panel, verdicts: Sequence[Verdict], period: float, first: int = 0
) -> None:
    """The trust level as a band, shown by height as well as colour."""
    for stretch in Tally(verdicts, first).stretches:
        begin = stretch.first * period
        end = (stretch.last + 1) * period
        height = _HEIGHTS[stretch.level]
        axes.fill_between(
            [begin, end], -0.5, height + 0.5, color=LEVELS[stretch.level], lw=0
        )
    axes.set_ylim(-0.5, 3.5)
    axes.left.name_ticks(_HEIGHTS.values(), [level.value for level in _HEIGHTS])
    axes.grid(visible=False)
    axes.set_ylabel("trust")


def _misses(
    verdicts: Sequence[Verdict], plant: type[Plant], *, closed: bool
) -> dict[str, dict[int, float]]:
    """The misses of each signal by sample; of inputs only if they were forecast."""
    signals = shown_signals(plant) if closed else shown_outputs(plant)
    misses: dict[str, dict[int, float]] = {signal.name: {} for signal in signals}
    for verdict in verdicts:
        for signal, miss in zip(signals, verdict.misses, strict=False):
            misses[signal.name][verdict.sample] = miss
    return misses


def _draw_misses(
    axes: Axes, misses: Mapping[int, float], period: float, limit: float
) -> None:
    miss_at = {
        sample * period: miss for sample, miss in misses.items() if not math.isnan(miss)
    }
    if not miss_at:
        empty(axes, "no residual: there is no candidate")
        return
    axes.plot(
        list(miss_at), list(miss_at.values()), color=PLANT, marker=".", ms=4, lw=1
    )
    # a command at its limit is missed by nothing
    top = 1.15 * max(miss_at.values()) or 1.0
    if limit <= _DRAWN * top:
        axes.axhline(limit, color=LEVELS[TrustLevel.DOUBTFUL], lw=1.2, ls="--")
        place: dict[str, Any] = {
            "xycoords": axes.get_yaxis_transform(),
            "textcoords": "offset points",
        }
        axes.annotate(
            f"doubtful from {limit:g}", (0.0, limit), (4, 2), fontsize=8, **place
        )
        top = max(top, 1.2 * limit)
    else:
        note = f"(doubtful from {limit:g}, beyond this axis)"
        axes.annotate(
            note,
            (1.0, 0.97),
            xycoords="axes fraction",
            ha="right",
            va="top",
            fontsize=8,
        )
    axes.set_ylim(0, top)


def _draw_matches(
    axes: Panel,
    matches: Sequence[MatchReport],
    admitted_at: Collection[int],
    period: float,
    unit: str,
) -> None:
    admitted_matches = [m for m in matches if m.sample in admitted_at]
    refused_matches = [m for m in matches if m.sample not in admitted_at]
    _mark_matches(axes, admitted_matches, period, 1.0, "o", TrustLevel.TRUSTED)
    _mark_matches(axes, refused_matches, period, 0.0, "x", TrustLevel.FAULT)
    axes.set_ylim(-0.6, 2.0)
    axes.left.name_ticks([0, 1], ["refused", "admitted"])
    axes.set_ylabel(f"matches\n({unit})" if unit else "matches")


def _mark_matches(  # noqa: PLR0917
    axes: Axes,
    matches: Sequence[MatchReport],
    period: float,
    height: float,
    marker: str,
    level: TrustLevel,
) -> None:
    """Draw a mark for each of these matches at a height, with its operating point above."""
    times = [m.sample * period for m in matches]
    axes.plot(
        times, [height] * len(times), marker, color=LEVELS[level], ms=6, mew=1.6, ls=""
    )
    place: dict[str, Any] = {
        "textcoords": "offset points",
        "ha": "center",
        "fontsize": 7,
        "color": TEXT,
    }
    for time, m in zip(times, matches, strict=True):
        axes.annotate(point_text(m.operating_point), (time, height), (0, 5), **place)


@styled
def draw_estimates(
    courses: Sequence[EstimatedCourse], period: float, samples: int
) -> Figure:
    """What each sensor read that was not believed, and what it should have, below one another."""
    figure = new_figure(10, 2.4 * len(courses))
    grid = figure.add_gridspec(len(courses), 1)
    all_axes = [panel(figure, grid[row, 0]) for row in range(len(courses))]
    for axes, course in zip(all_axes, courses, strict=True):
        draw_estimate(axes, course, period, samples)
    all_axes[-1].set_xlabel("time since the session began / s")
    return figure


def draw_estimate(
    axes: Axes, course: EstimatedCourse, period: float, samples: int
) -> None:
    """What a sensor read, and what it should have."""
    time = np.arange(course.first, course.last + 1) * period
    values = np.array(course.values)
    bands = np.array(course.bands)
    axes.plot(time, course.readings, color=SET_POINT, label="read")
    axes.plot(time, values, color=MODEL, label="should have been read, 90 %")
    axes.fill_between(
        time, values - bands, values + bands, color=MODEL, alpha=0.2, lw=0
    )
    axes.set_xlim(0.0, samples * period)
    axes.set_ylabel(f"{course.text} / {course.unit}")
    legend_above(axes, 2)


def _draw_leader(
    upper: Axes, control: Axes, parts: Sequence[Comparison], label: str
) -> None:
    """The leader's output and, in closed loop, its input."""
    for number, part in enumerate(parts):
        output = part.driven_output if part.closed is None else part.closed.output
        upper.plot(
            part.time, output, color=CLOSED, lw=1, label=label if number == 0 else "_"
        )
        if part.closed is not None:
            control.plot(part.time, part.closed.input, color=CLOSED, lw=0.8)


@styled
def draw_verdict(
    samples: Sequence[Sample],
    verdicts: Sequence[Verdict],
    settings: TwinSettings,
    settled: Sequence[Window],
    path: Path,
) -> None:
    """Plant and leading twin, trust over time, the criteria and the ν-gap matrix, on one page.

    `settled` are the stretches of the samples as the twin took them.

    Raises:
        TwinmatchError: matplotlib cannot write such a file there.
    """
    figure = new_figure(12, 9)
    grid = figure.add_gridspec(4, 2, height_ratios=(3, 2, 0.9, 3))
    loops = channels(settings.plant)
    uppers = [panel(figure, cell) for cell in cells_for(len(loops), grid[0, :])]
    controls = [panel(figure, cell) for cell in cells_for(len(loops), grid[1, :])]
    trust = panel(figure, grid[2, :])
    for signal_axes in (*uppers, *controls):
        signal_axes.sharex(trust)
    last = last_verdict(verdicts)
    shown = shown_twin(verdicts[-1] if verdicts else None)
    parts = _compared(settled, verdicts, settings)
    windows = stretches(samples, settings.period)
    closed = settings.law is not None
    for k, (loop, upper, control) in enumerate(
        zip(loops, uppers, controls, strict=True)
    ):
        _draw_measured(
            upper, control, [window.alone(k) for window in windows], closed=closed
        )
        if shown is not None:
            _draw_leader(
                upper,
                control,
                [part.alone(k) for part in parts],
                f"twin of {shown.name}",
            )
        for axes, signal in zip((upper, control), signal_names(loop), strict=True):
            axes.set_ylabel(signal.label)
            axes.below.shows_numbers = False
        legend_above(upper, 3)
    if shown is not None:
        set_title: Any = figure.suptitle if loops[1:] else uppers[0].set_title
        set_title(_title(shown, nominal_score(last)))
    _draw_levels(trust, verdicts, settings.period, samples[0].index)
    time_axis(trust, settings.period, samples[0].index, samples[-1].index)
    if last is not None:
        if last.modelled:
            draw_gains(panel(figure, grid[3, 0]), last)
        fill_matrix(figure.add_subplot(grid[3, 1]), last)
    save(figure, path)


def _draw_measured(
    upper: Axes, control: Axes, windows: Sequence[Window], *, closed: bool
) -> None:
    """One output and one input as they were measured."""
    for number, window in enumerate(windows):
        draw_outputs(upper, window, closed=closed, named=number == 0, lw=1.2)
        draw_inputs(control, window, 0.9)


def _title(shown: ShownTwin, nominal: CandidateScore | None) -> str:
    """The twin that is drawn, and the nominal candidate."""
    order = (
        f", order {nominal.chosen_order}" if nominal and nominal.chosen_order else ""
    )
    centre = f"nominal: {nominal.name}{order}" if nominal else "nominal: none"
    return f"Leader: {shown.name}; {centre}"
