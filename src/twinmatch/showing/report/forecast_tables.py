"""Tables of forecast quality."""

from __future__ import annotations

from twinmatch.offline.backtest import Backtest
from twinmatch.offline.backtest.result import LEADER, TWINS
from twinmatch.offline.backtest.table import at_horizon, cells, columns
from twinmatch.showing.report.table import Cell, Table, head

__all__ = ["forecast_tables"]


def forecast_tables(tested: Backtest) -> list[Table]:
    """One table per horizon: errors and bands of every forecaster; the smallest error of those that can be
    used live is bold."""
    found = []
    for horizon in tested.horizons:
        held = at_horizon(tested.cards, horizon)
        if not held:
            continue
        names = columns(tested.plant, driven=tested.driven)
        error = names.index("error")
        real = [card.median for card in held if card.who not in TWINS or card.who == LEADER]
        rows = []
        for card in held:
            who, *rest = cells(card, tested.plant, driven=tested.driven)
            best = card.who not in TWINS[1:] and card.median == min(real, default=card.median)
            rows.append(
                (head(who), *(Cell(text, best=best and k == error) for k, text in enumerate(rest, 1)))
            )
        marked = frozenset(k for k, card in enumerate(held) if card.who == LEADER)
        caption = f"{horizon:g} s ahead, {held[0].count} forecasts"
        found.append(Table(caption, names, tuple(rows), marked))
    return found
