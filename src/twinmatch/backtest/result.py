"""What a backtest came to, as other modules show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from twinmatch.backtest.peers import Absent
from twinmatch.backtest.summary import HINDSIGHT, Card, Marked, cards
from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast
from twinmatch.signals import Window

__all__ = ["CONSTANT", "LEADER", "NEWEST", "NOMINAL", "TWINS", "Backtest", "over_all"]

LEADER: Final = "leader"
NOMINAL: Final = "nominal"
NEWEST: Final = "newest"
CONSTANT: Final = "nominal, constant band"
"""The nominal twin's forecast with a band of one width, from its residuals so far."""
TWINS: Final = (LEADER, NOMINAL, NEWEST, CONSTANT, HINDSIGHT)
"""Who forecasts with a twin; everybody else is a peer."""


@dataclass(frozen=True, eq=False)
class Backtest:
    """Forecasts of one session against what came, or of several together."""

    name: str
    plant: type[Plant]
    period: float
    """s."""
    horizons: tuple[float, ...]
    """s, from near to far."""
    confidence: float
    """Share of the samples that every band is to hold."""
    marked: tuple[Marked, ...]
    """Every forecast at every horizon, of the origins at which all could answer."""
    came: tuple[Window, ...] = ()
    """The unbroken stretches of samples."""
    pictured: str = ""
    """Name of the session that these are of; empty: this one's."""
    shown: tuple[Forecast, ...] = ()
    """Forecasts of the leader, one after another, for a picture."""
    absent: tuple[Absent, ...] = ()
    """Peers that could not be asked here."""
    notes: tuple[str, ...] = ()
    """What was left out and why, in words."""

    @property
    def cards(self) -> list[Card]:
        """The report cards."""
        return cards(self.marked)

    @property
    def driven(self) -> bool:
        """Whether the loop is not known and inputs were given, of which nothing is said then."""
        return any(one.marks.input is None for one in self.marked)

    @property
    def origins(self) -> int:
        """At how many samples forecasts were made and judged at some horizon."""
        return len({(one.session, one.sample) for one in self.marked})


def over_all(found: Sequence[Backtest]) -> Backtest:
    """Several sessions of one plant as one; every forecast counts the same."""
    first, names = found[0], [each.name for each in found]
    marked: list[Marked] = []
    for number, each in enumerate(found, 1):
        mine = f"{each.name} ({number})" if names.count(each.name) > 1 else each.name
        marked += [replace(one, session=mine) for one in each.marked]
    return Backtest(
        name=f"all {len(found)} sessions",
        plant=first.plant,
        period=first.period,
        horizons=first.horizons,
        confidence=first.confidence,
        marked=tuple(marked),
        came=first.came,
        pictured=first.name,
        shown=first.shown,
        absent=tuple(dict.fromkeys(a for each in found for a in each.absent)),
        notes=tuple(f"{each.name}: {note}" for each in found for note in each.notes),
    )
