"""Backtests for people: the report card as text tables, as sentences and as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast
from twinmatch.offline.backtest.result import CONSTANT, LEADER, NEWEST, NOMINAL, TWINS, Backtest
from twinmatch.offline.backtest.scoring import HINDSIGHT, Card
from twinmatch.showing.figures.drawing import empty, new_figure, styled
from twinmatch.showing.quantities import number, signal_names, with_unit
from twinmatch.showing.style import CLOSED, DRIVEN, MODEL, PLANT, SET_POINT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table

_OF_INPUT = (5, 7, 9)
"""Columns that are left out if inputs were given."""


def columns(plant: type[Plant], *, driven: bool = False) -> tuple[str, ...]:
    """The column names for `cells`."""
    w = signal_names(plant)
    if w.output_unit == w.input_unit:
        called = (f" {w.output}", f" {w.input}")
        in_unit = tuple(with_unit(name, w.output_unit) for name in called)
    else:
        called = (f" {w.output_unit or w.output}", f" {w.input_unit or w.input}")
        in_unit = tuple(f" /{unit}" for unit in called)
    names = (
        *("who", "error", "9 in 10", "× best"),
        *(f"{figure}{name}" for figure, names in (("end", in_unit), ("held", called)) for name in names),
        *(f"width{name}" for name in in_unit),
        "score",
    )
    return _shown(names, driven=driven)


def _shown(row: Sequence[str], *, driven: bool) -> tuple[str, ...]:
    return tuple(text for k, text in enumerate(row) if not (driven and k in _OF_INPUT))


def cells(card: Card, plant: type[Plant], *, driven: bool = False) -> tuple[str, ...]:
    """One forecaster's figures; ends and widths in the plant's units, the others in units of its noise."""
    y, u = plant.output.noise, plant.drive.noise
    fine_y, fine_u = plant.output.decimals + 1, plant.drive.decimals + 1
    row = (
        card.who,
        number(card.median),
        number(card.nine_in_ten),
        number(card.ratio),
        number(card.end_output * y, fine_y),
        number(card.end_input * u, fine_u),
        f"{number(100 * card.coverage_output, 0)} %",
        f"{number(100 * card.coverage_input, 0)} %",
        number(card.width_output * y, fine_y),
        number(card.width_input * u, fine_u),
        number(card.score, 1),
    )
    return _shown(row, driven=driven)


def at_horizon(cards: Sequence[Card], horizon: float) -> list[Card]:
    """The cards of one horizon, in order."""
    return [card for card in cards if card.horizon == horizon]


def tables(backtest: Backtest) -> list[Table]:
    """One table for each horizon with scored forecasts."""
    from rich.table import Table  # noqa: PLC0415 — needed only for printing

    found = []
    for horizon in backtest.horizons:
        held = at_horizon(backtest.cards, horizon)
        if not held:
            continue
        title = f"{backtest.name}: {horizon:g} s ahead, {held[0].count} forecasts"
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        for k, name in enumerate(columns(backtest.plant, driven=backtest.driven)):
            table.add_column(name, justify="right" if k else "left", no_wrap=True)
        for card in held:
            style = "bold" if card.who == LEADER else "" if card.who in TWINS else "dim"
            table.add_row(*cells(card, backtest.plant, driven=backtest.driven), style=style)
        found.append(table)
    return found


def sentences(backtest: Backtest) -> list[str]:
    """Sentences on the leader's results, one for each horizon."""
    w, noise = signal_names(backtest.plant), backtest.plant.output.noise
    found = []
    for horizon in backtest.horizons:
        held = {card.who: card for card in at_horizon(backtest.cards, horizon)}
        if LEADER not in held:
            continue
        own = held[LEADER]
        text = (
            f"{horizon:g} s ahead, the leader's {w.output} was off by less than "
            f"{number(own.end_output * noise, backtest.plant.output.decimals + 1)} {w.output_unit}".rstrip()
            + f" half of the time, and its band held {100 * own.coverage_output:.0f} % of the readings"
            f" ({100 * backtest.confidence:.0f} % expected)"
        )
        peers = [card for who, card in held.items() if who not in TWINS]
        if peers:
            best = min(peers, key=lambda card: card.median)
            text += f"; {best.who}, the best of the peers, {_compared(best.median, own.median)}"
        found.append(f"{text}.")
    return found


def _compared(theirs: float, ours: float) -> str:
    """Compare a peer's error with ours."""
    if not ours or not theirs:
        return "cannot be compared with it"
    ratio = theirs / ours
    if ratio >= 1.05:
        return f"had {number(ratio, 1)} times the error"
    if ratio <= 0.95:
        return f"had a smaller error, {number(ratio, 2)} times as large"
    return "had the same error"


_LOOKS: Final = {
    LEADER: (CLOSED, "o"),
    NOMINAL: (DRIVEN, "s"),
    NEWEST: ("#009E73", "^"),
    CONSTANT: (DRIVEN, "d"),
    HINDSIGHT: (MODEL, "*"),
}
_PEERS: Final = ((SET_POINT, "v"), ("#56B4E9", "D"), ("#E69F00", "P"))
"""Colours and markers of the peers, in order."""


@styled
def draw_backtest(backtest: Backtest) -> Figure:
    """Errors and coverage of all forecasters by horizon; forecasts of the leader with their bands."""
    figure = new_figure(11, 9.5)
    grid = figure.add_gridspec(4, 2, height_ratios=(2.4, 1.8, 1.2, 1.2))
    found = backtest.cards
    errors, held = (figure.add_subplot(grid[0, k]) for k in range(2))
    if found:
        looks = _looks(found)
        _draw_errors(errors, found, backtest.horizons, looks)
        _draw_coverage(held, backtest, found, looks)
        figure.legend(*errors.get_legend_handles_labels(), loc="outside upper center", ncols=len(looks))
    else:
        empty(errors, "no forecast could be judged")
        held.set_axis_off()
    output = figure.add_subplot(grid[1, :])
    left = figure.add_subplot(grid[2, :], sharex=output)
    entry = figure.add_subplot(grid[3, :], sharex=output)
    _draw_came(output, entry, backtest)
    for k, forecast in enumerate(backtest.shown):
        _draw_forecast((output, left, entry), forecast, backtest, first=k == 0)
    _dress((output, left, entry), backtest)
    figure.align_ylabels((output, left, entry))
    return figure


def _looks(found: Sequence[Card]) -> dict[str, tuple[str, str]]:
    names = list(dict.fromkeys(card.who for card in found))
    others = [name for name in names if name not in _LOOKS]
    return {
        name: _LOOKS[name] if name in _LOOKS else _PEERS[others.index(name) % len(_PEERS)] for name in names
    }


def _places(count: int) -> Sequence[float]:
    """Horizontal offsets of the forecasters around a horizon."""
    return [(k - (count - 1) / 2) * 0.8 / count for k in range(count)]


def _draw_errors(
    axes: Axes, found: Sequence[Card], horizons: Sequence[float], looks: dict[str, tuple[str, str]]
) -> None:
    """Median, and a line up to the value below which nine in ten are."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter  # noqa: PLC0415 — slow

    for (who, (colour, marker)), shift in zip(looks.items(), _places(len(looks)), strict=True):
        own = [(horizons.index(c.horizon) + shift, c) for c in found if c.who == who]
        places, medians = [place for place, _ in own], [c.median for _, c in own]
        axes.vlines(places, medians, [c.nine_in_ten for _, c in own], color=colour, lw=1.2)
        axes.plot(places, medians, marker, color=colour, ms=6, label=who)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_ylabel("error / noise")
    axes.set_title("Error over the path: median, and line up to nine in ten")
    _name_horizons(axes, horizons)


def _draw_coverage(
    axes: Axes, backtest: Backtest, found: Sequence[Card], looks: dict[str, tuple[str, str]]
) -> None:
    """Share of the samples in the band: output filled, input hollow."""
    for (who, (colour, marker)), shift in zip(looks.items(), _places(len(looks)), strict=True):
        own = [(backtest.horizons.index(c.horizon) + shift, c) for c in found if c.who == who]
        places = [place for place, _ in own]
        axes.plot(places, [100 * c.coverage_output for _, c in own], marker, color=colour, ms=6)
        axes.plot(places, [100 * c.coverage_input for _, c in own], marker, color=colour, ms=6, mfc="white")
    axes.axhline(100 * backtest.confidence, color=MODEL, lw=1, ls="--")
    words = signal_names(backtest.plant)
    of_both = f"Coverage of the band: {words.output} filled, {words.input} hollow"
    axes.set_title(f"Coverage of the band: {words.output}" if backtest.driven else of_both)
    axes.set_ylim(min(50.0, axes.get_ylim()[0]), 102.0)
    axes.set_ylabel("samples within the band / %")
    _name_horizons(axes, backtest.horizons)


def _name_horizons(axes: Axes, horizons: Sequence[float]) -> None:
    axes.set_xticks(range(len(horizons)), [f"{h:g} s ahead" for h in horizons])
    axes.grid(visible=False, axis="x")


def _draw_came(output: Axes, entry: Axes, backtest: Backtest) -> None:
    """Draw the samples of the session."""
    for k, window in enumerate(backtest.came):
        hidden = "_" if k else ""
        if not backtest.driven:
            output.plot(
                window.time,
                window.reference,
                color=SET_POINT,
                lw=1,
                ls="--",
                drawstyle="steps-post",
                label=f"{hidden}set-point",
            )
        output.plot(window.time, window.output, color=PLANT, lw=1, label=f"{hidden}measured")
        entry.plot(window.time, window.input, color=PLANT, lw=0.8)


def _draw_forecast(
    axes: tuple[Axes, Axes, Axes], forecast: Forecast, backtest: Backtest, *, first: bool
) -> None:
    """Draw a forecast of the leader, mean and band, and the output's error within the band."""
    output, left, entry = axes
    hidden = "" if first else "_"
    time = forecast.sample * backtest.period + forecast.time
    shown = ((output, forecast.output), (entry, forecast.input))
    for each, band in shown if forecast.closed else shown[:1]:
        each.fill_between(time, band.low, band.high, color=CLOSED, alpha=0.25, lw=0, label=f"{hidden}band")
        each.plot(time, band.mean, color=CLOSED, lw=0.9, label=f"{hidden}leader's forecast")
    band = forecast.output
    left.fill_between(time, band.low - band.mean, band.high - band.mean, color=CLOSED, alpha=0.25, lw=0)
    for window in backtest.came:
        if window.first <= forecast.sample <= window.last - time.size:
            came = window.part(forecast.sample + 1, forecast.sample + time.size).output
            left.plot(time, came - band.mean, color=PLANT, lw=0.8)


def _dress(axes: tuple[Axes, Axes, Axes], backtest: Backtest) -> None:
    output, left, entry = axes
    words = signal_names(backtest.plant)
    if backtest.shown:
        begin, last = (f.sample * backtest.period for f in (backtest.shown[0], backtest.shown[-1]))
        reach = float(backtest.shown[-1].time[-1])
        output.set_xlim(begin - 0.2 * reach, last + 1.1 * reach)
    whose = backtest.pictured or backtest.name
    output.set_title(f"{whose}: forecasts of the leader")
    output.set_ylabel(words.output_label)
    left.set_ylabel(with_unit("measured − forecast", words.output_unit))
    left.axhline(0, color=SET_POINT, lw=0.6)
    entry.set_ylabel(words.input_label)
    entry.set_xlabel("time since the session began / s")
    for each in (output, left):
        each.tick_params(labelbottom=False)
    if output.get_legend_handles_labels()[0]:
        output.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
