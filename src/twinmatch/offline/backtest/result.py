"""The result of a backtest, and as a dictionary for JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Final

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast
from twinmatch.offline.backtest.peers import Absent
from twinmatch.offline.backtest.scoring import HINDSIGHT, Card, Marked, cards
from twinmatch.signals import Window

LEADER: Final = "leader"
NOMINAL: Final = "nominal"
NEWEST: Final = "newest"
CONSTANT: Final = "nominal, constant band"
"""The nominal twin's forecast with a band of one width, from its residuals so far."""
TWINS: Final = (LEADER, NOMINAL, NEWEST, CONSTANT, HINDSIGHT)
"""Forecasters with a twin; all others are peers."""


@dataclass(frozen=True, eq=False)
class Backtest:
    """Scored forecasts of one session, or of several together."""

    name: str
    plant: type[Plant]
    period: float
    """Sample time, s."""
    horizons: tuple[float, ...]
    """Horizons, s, from near to far."""
    confidence: float
    """Share of the samples that every band is to hold."""
    marked: tuple[Marked, ...]
    """Every forecast at every horizon, at the origins at which all forecasters could make one."""
    came: tuple[Window, ...] = ()
    """The samples, in stretches without gaps."""
    pictured: str = ""
    """Name of the session with these samples; empty: this one's."""
    shown: tuple[Forecast, ...] = ()
    """Consecutive forecasts of the leader, for a figure."""
    absent: tuple[Absent, ...] = ()
    """Peers that are not available here."""
    notes: tuple[str, ...] = ()
    """Sentences on what was left out and why."""

    @cached_property
    def cards(self) -> list[Card]:
        """The report cards."""
        return cards(self.marked)

    @property
    def at_horizons(self) -> dict[float, list[Card]]:
        """The cards of each horizon with scored forecasts, from near to far."""
        found = {h: [card for card in self.cards if card.horizon == h] for h in self.horizons}
        return {horizon: held for horizon, held in found.items() if held}

    @property
    def driven(self) -> bool:
        """Whether the loop is not known and inputs were given; inputs are then not scored."""
        return any(one.marks.input is None for one in self.marked)

    @property
    def origins(self) -> int:
        """Number of samples at which forecasts were made and scored at some horizon."""
        return len({(one.session, one.sample) for one in self.marked})


def over_all(found: Sequence[Backtest]) -> Backtest:
    """Combine several sessions of one plant; every forecast has the same weight."""
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


def document(backtest: Backtest, *, forecasts: bool = True) -> dict[str, Any]:
    """Report cards and, optionally, the marks of every forecast; NaN becomes None.

    Errors, ends, widths and scores are in units of the noise in the same document.
    """
    plant = backtest.plant
    found: dict[str, Any] = {
        "name": backtest.name,
        "plant": plant.name,
        "confidence": backtest.confidence,
        "horizons": list(backtest.horizons),
        "noise": {"output": plant.output.noise, "input": plant.drive.noise},
        "origins": backtest.origins,
        "cards": [_finite(asdict(card)) for card in backtest.cards],
        "absent": [absent._asdict() for absent in backtest.absent],
        "notes": list(backtest.notes),
    }
    if forecasts:
        found["forecasts"] = [
            {
                "session": one.session,
                "sample": one.sample,
                "horizon": one.horizon,
                "who": one.who,
                "candidate": one.candidate,
                "error": one.marks.error,
                **_finite(asdict(one.marks)),
            }
            for one in backtest.marked
        ]
    return found


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
