"""The peers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

from twinmatch.dynamics import Plant
from twinmatch.offline.backtest.arx import Arx
from twinmatch.offline.backtest.errors import BacktestError
from twinmatch.offline.backtest.given_input import InputArx, OutputPersistence
from twinmatch.offline.backtest.peer import Peer
from twinmatch.offline.backtest.persistence import Persistence
from twinmatch.offline.backtest.vector_autoregression import VectorAutoregression

__all__ = ["PEERS", "Absent", "peers"]

PEERS: Final[Mapping[str, Callable[[type[Plant]], Peer]]] = MappingProxyType(
    {"persistence": Persistence, "arx": Arx, "statsmodels": VectorAutoregression}
)
"""Constructors of the peers for a plant, by name."""


_DRIVEN: Final[Mapping[str, Callable[[type[Plant]], Peer]]] = MappingProxyType(
    {"persistence": OutputPersistence, "arx": InputArx}
)
"""The same for a plant whose loop is not known."""


class Absent(NamedTuple):
    """A peer that is not available here."""

    name: str
    reason: str
    """Why, and what to do."""


def peers(
    plant: type[Plant], names: Sequence[str] = tuple(PEERS), *, driven: bool = False
) -> tuple[list[Peer], list[Absent]]:
    """The peers with these names, and the unavailable ones: not installed, or, if the loop is not known and
    the actual inputs are given (`driven`), able to forecast only both signals of a loop.

    Raises:
        BacktestError: there is no such peer.
    """
    found: list[Peer] = []
    absent: list[Absent] = []
    for name in names:
        if name not in PEERS:
            raise BacktestError(f"backtest: no peer {name!r}; choose from {', '.join(PEERS)}")
        if driven and name not in _DRIVEN:
            both = "it forecasts output and input of a loop; here the inputs are given"
            absent.append(Absent(PEERS[name](plant).name, both))
            continue
        peer = (_DRIVEN if driven else PEERS)[name](plant)
        missing = peer.missing() if isinstance(peer, VectorAutoregression) else ""
        if missing:
            absent.append(Absent(peer.name, missing))
        else:
            found.append(peer)
    return found, absent
