"""Forecasts with their bands, compared with the measurements, and the scores of many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast
from twinmatch.offline.backtest.scoring import (
    CONSTANT,
    HINDSIGHT,
    LEADER,
    NEWEST,
    NOMINAL,
    Backtest,
    Card,
)
from twinmatch.showing.figures.drawing import (
    align_labels,
    draw_inputs,
    draw_outputs,
    draw_set_point,
    empty,
    new_figure,
    panel,
    stack,
    styled,
)
from twinmatch.showing.quantities import signal_names, with_unit
from twinmatch.showing.series import Fan
from twinmatch.showing.style import CLOSED, DRIVEN, MODEL, PLANT, SET_POINT
from twinmatch.signals import FloatArray, Window

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from twinmatch.showing.figures.elements.panel import Panel


_COLUMNS = 3
"""Most panels side by side."""
_LETTERS = 36
"""Characters per line of a name above a panel."""
_BAND = f"{100 * CONFIDENCE:.0f} % band"


@styled
def draw_forecasts(fans: Sequence[Fan], plant: type[Plant]) -> Figure:
    """One panel per forecast: output, forecast error, and input, around its sample."""
    columns = min(max(len(fans), 1), _COLUMNS)
    rows = max(-(-len(fans) // columns), 1)
    figure = new_figure(10 if columns > 1 else 7.5, 4.2 * rows + 0.4)
    if not fans:
        empty(panel(figure), "no forecast was made")
        return figure
    grids = figure.add_gridspec(rows, columns, wspace=0.04, hspace=0.06)
    signals = signal_names(plant)
    for k, fan in enumerate(fans):
        output, error, control = stack(
            figure, (3, 1.6, 2), grids[k // columns, k % columns]
        )
        _draw(output, control, fan)
        _draw_error(error, fan)
        if k % columns == 0:
            output.set_ylabel(signals.output.label)
            error.set_ylabel(with_unit("measured −\nforecast", signals.output.unit))
            control.set_ylabel(signals.input.label)
        if k + columns >= len(fans):
            control.set_xlabel("time after that sample / s")
    line_of_label: dict[str, Artist] = {}  # each label once
    for axes in figure.axes:
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True):
            line_of_label.setdefault(str(label), line)
    figure.legend(
        list(line_of_label.values()),
        list(line_of_label),
        loc="outside upper right",
        ncols=len(line_of_label),
    )
    return figure


def _draw(output: Axes, control: Axes, fan: Fan) -> None:
    """Output and input of one forecast, with what was measured before and after its sample."""
    forecast = fan.forecast
    past = fan.past
    measured = fan.measured
    past_samples = (
        np.arange(past.first, past.last + 1, dtype=np.float64) - forecast.sample
    )
    past_time = past_samples * past.period
    if forecast.closed:
        set_points = np.concatenate([past.reference, forecast.reference])
        draw_set_point(
            output,
            np.concatenate([past_time, forecast.time]),
            set_points,
            0.9,
            named=True,
        )
    output_after = np.empty(0) if measured is None else measured.output
    input_after = np.empty(0) if measured is None else measured.input
    _draw_signal(
        output, past_time, past.output, forecast.time, forecast.output, output_after
    )
    _draw_signal(
        control, past_time, past.input, forecast.time, forecast.input, input_after
    )
    name = "\n".join(wrap(forecast.candidate, _LETTERS))
    output.set_title(f"sample {forecast.sample}:\n{name}", size=9)


def _draw_signal(  # noqa: PLR0917
    axes: Axes,
    past_time: FloatArray,
    before: FloatArray,
    time: FloatArray,
    band: Band,
    after: FloatArray,
) -> None:
    """One signal before and after the sample of a forecast, and its band; `after` may be empty."""
    _fill(axes, time, band, label=_BAND)
    axes.plot(past_time, before, color=PLANT, lw=1.1, label="measured before")
    if after.size:
        dotted = (0, (1, 1))
        axes.plot(
            time[: after.size],
            after,
            color=PLANT,
            lw=1.1,
            ls=dotted,
            label="measured afterwards",
        )
    axes.plot(time, band.mean, color=CLOSED, lw=1.1, label="forecast")
    axes.axvline(0, color=SET_POINT, lw=0.8)
    axes.margins(x=0.01)


def _fill(
    axes: Axes,
    time: FloatArray,
    band: Band,
    around: float | FloatArray = 0.0,
    **line: Any,
) -> None:
    """The band, or what it reaches to either side of some values."""
    axes.fill_between(
        time,
        band.low - around,
        band.high - around,
        color=CLOSED,
        alpha=0.25,
        lw=0,
        **line,
    )


def _draw_error(axes: Axes, fan: Fan) -> None:
    """Measured output minus forecast, within the band."""
    band = fan.forecast.output
    time = fan.forecast.time
    _fill(axes, time, band, around=band.mean)
    axes.plot(fan.times, fan.error, color=PLANT, lw=0.9)
    axes.axhline(0, color=CLOSED, lw=1.0)
    axes.axvline(0, color=SET_POINT, lw=0.8)


_LOOKS: Final = {
    LEADER: (CLOSED, "o"),
    NOMINAL: (DRIVEN, "s"),
    NEWEST: ("#009E73", "^"),
    CONSTANT: (DRIVEN, "d"),
    HINDSIGHT: (MODEL, "*"),
}
"""Colours and markers of the twins."""
_PEERS: Final = ((SET_POINT, "v"), ("#56B4E9", "D"), ("#E69F00", "P"))
"""Colours and markers of the peers, in order."""


@styled
def draw_backtest(backtest: Backtest) -> Figure:
    """Errors and coverage of all forecasters by horizon; forecasts of the leader with their bands."""
    figure = new_figure(11, 9.5)
    grid = figure.add_gridspec(4, 2, height_ratios=(2.4, 1.8, 1.2, 1.2))
    cards = backtest.cards
    errors, coverage = (panel(figure, grid[0, k]) for k in range(2))
    if cards:
        looks = _looks(cards)
        _draw_errors(errors, cards, backtest.horizons, looks)
        _draw_coverage(coverage, backtest, cards, looks)
        figure.legend(
            *errors.get_legend_handles_labels(),
            loc="outside upper center",
            ncols=len(looks),
        )
    else:
        empty(errors, "no forecast could be judged")
        coverage.set_axis_off()
    output = panel(figure, grid[1, :])
    axes = (
        output,
        *(panel(figure, grid[row, :], output) for row in (2, 3)),
    )
    for k, window in enumerate(backtest.came):
        draw_outputs(
            output,
            window,
            closed=not backtest.driven,
            named=not k,
            plant="measured",
            lw=1,
        )
        draw_inputs(axes[-1], window, 0.8)
    if backtest.shown:
        _draw_shown(axes, backtest)
    _dress(axes, backtest)
    align_labels(axes)
    return figure


def _looks(cards: Sequence[Card]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each forecaster."""
    peers = cycle(_PEERS)
    names = dict.fromkeys(card.who for card in cards)
    return {name: _LOOKS.get(name) or next(peers) for name in names}


def _marks(
    cards: Sequence[Card], horizons: Sequence[float], looks: dict[str, tuple[str, str]]
) -> Iterator[tuple[str, list[float], list[Card]]]:
    """Every forecaster with its cards and their places, side by side around the horizons."""
    for k, forecaster in enumerate(looks):
        shift = (k - (len(looks) - 1) / 2) * 0.8 / len(looks)
        cards_of_forecaster = [card for card in cards if card.who == forecaster]
        yield (
            forecaster,
            [horizons.index(card.horizon) + shift for card in cards_of_forecaster],
            cards_of_forecaster,
        )


def _draw_errors(
    axes: Panel,
    cards: Sequence[Card],
    horizons: Sequence[float],
    looks: dict[str, tuple[str, str]],
) -> None:
    """Median, and a line up to the value below which nine in ten are."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter  # noqa: PLC0415

    for forecaster, places, cards_of_forecaster in _marks(cards, horizons, looks):
        colour, marker = looks[forecaster]
        medians = [c.median for c in cards_of_forecaster]
        axes.vlines(
            places,
            medians,
            [c.nine_in_ten for c in cards_of_forecaster],
            color=colour,
            lw=1.2,
        )
        axes.plot(places, medians, marker, color=colour, ms=6, label=forecaster)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_ylabel("error / noise")
    axes.set_title("Error over the path: median, and line up to nine in ten")
    _name_horizons(axes, horizons)


def _draw_coverage(
    axes: Panel,
    backtest: Backtest,
    cards: Sequence[Card],
    looks: dict[str, tuple[str, str]],
) -> None:
    """Share of the samples in the band: output filled, input hollow."""
    for forecaster, places, cards_of_forecaster in _marks(
        cards, backtest.horizons, looks
    ):
        colour, marker = looks[forecaster]
        axes.plot(
            places,
            [100 * c.coverage_output for c in cards_of_forecaster],
            marker,
            color=colour,
            ms=6,
        )
        axes.plot(
            places,
            [100 * c.coverage_input for c in cards_of_forecaster],
            marker,
            color=colour,
            ms=6,
            mfc="white",
        )
    axes.axhline(100 * backtest.confidence, color=MODEL, lw=1, ls="--")
    words = signal_names(backtest.plant)
    of_both = f"Coverage of the band: {words.output} filled, {words.input} hollow"
    axes.set_title(
        f"Coverage of the band: {words.output}" if backtest.driven else of_both
    )
    axes.set_ylim(min(50.0, axes.get_ylim()[0]), 102.0)
    axes.set_ylabel("samples within the band / %")
    _name_horizons(axes, backtest.horizons)


def _name_horizons(axes: Panel, horizons: Sequence[float]) -> None:
    axes.below.name_ticks(range(len(horizons)), [f"{h:g} s ahead" for h in horizons])
    axes.grid(visible=False, axis="x")


def _draw_shown(axes: Sequence[Axes], backtest: Backtest) -> None:
    """Draw the leader's forecasts, means and bands, and the output's errors within the bands."""
    output, error_axes, control = axes
    forecasts = backtest.shown
    times = [
        forecast.sample * backtest.period + forecast.time for forecast in forecasts
    ]
    time = _one_line(times)
    output_band = _one_band([forecast.output for forecast in forecasts])
    shown = [(output, output_band)]
    if forecasts[0].closed:
        shown.append((control, _one_band([forecast.input for forecast in forecasts])))
    for signal_axes, band in shown:
        _fill(signal_axes, time, band, label="band")
        signal_axes.plot(
            time, band.mean, color=CLOSED, lw=0.9, label="leader's forecast"
        )
    _fill(error_axes, time, output_band, around=output_band.mean)
    errors = _one_line([_error_of(forecast, backtest.came) for forecast in forecasts])
    error_axes.plot(time, errors, color=PLANT, lw=0.8)


def _error_of(forecast: Forecast, came: Sequence[Window]) -> FloatArray:
    """Measured output minus forecast; NaN if a part of what was forecast is missing."""
    size = forecast.time.size
    for window in came:
        if window.first <= forecast.sample <= window.last - size:
            measured = window.part(forecast.sample + 1, forecast.sample + size)
            return np.asarray(measured.output - forecast.output.mean, dtype=np.float64)
    return np.full(size, np.nan)


def _one_band(bands: Sequence[Band]) -> Band:
    """Bands after one another as one band with gaps, so that they are drawn at once."""
    return Band(
        _one_line([band.mean for band in bands]),
        _one_line([band.low for band in bands]),
        _one_line([band.high for band in bands]),
    )


def _one_line(lines: Sequence[FloatArray]) -> FloatArray:
    """Values of lines after one another, with a NaN after each, where nothing is drawn."""
    return np.concatenate([np.append(line, np.nan) for line in lines])


def _dress(axes: Sequence[Panel], backtest: Backtest) -> None:
    """Limits, title, labels and legend of the session's charts."""
    output, error_axes, control = axes
    words = signal_names(backtest.plant)
    if backtest.shown:
        begin, last = (
            f.sample * backtest.period for f in (backtest.shown[0], backtest.shown[-1])
        )
        reach = float(backtest.shown[-1].time[-1])
        output.set_xlim(begin - 0.2 * reach, last + 1.1 * reach)
    name = backtest.pictured or backtest.name
    output.set_title(f"{name}: forecasts of the leader")
    output.set_ylabel(words.output.label)
    error_axes.set_ylabel(with_unit("measured − forecast", words.output.unit))
    error_axes.axhline(0, color=SET_POINT, lw=0.6)
    control.set_ylabel(words.input.label)
    control.set_xlabel("time since the session began / s")
    for upper in (output, error_axes):
        upper.below.shows_numbers = False
    if output.get_legend_handles_labels()[0]:
        output.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
