"""Report cards as text tables and as sentences, for the terminal and the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from twinmatch.dynamics import Plant
from twinmatch.offline.backtest.result import LEADER, TWINS, Backtest
from twinmatch.offline.backtest.summary import Card
from twinmatch.showing.quantities import number, signal_names, with_unit

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["at_horizon", "cells", "columns", "sentences", "tables"]


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
