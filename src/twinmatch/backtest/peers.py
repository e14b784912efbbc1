"""Who is asked beside the twin, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

from twinmatch.backtest.arx import Arx
from twinmatch.backtest.errors import BacktestError
from twinmatch.backtest.given_input import InputArx, OutputPersistence
from twinmatch.backtest.peer import Peer
from twinmatch.backtest.persistence import Persistence
from twinmatch.backtest.vector_autoregression import VectorAutoregression
from twinmatch.dynamics import Plant

__all__ = ["PEERS", "Absent", "peers"]

PEERS: Final[Mapping[str, Callable[[type[Plant]], Peer]]] = MappingProxyType(
    {"persistence": Persistence, "arx": Arx, "statsmodels": VectorAutoregression}
)
"""What makes each of them for a plant, by the name that people ask for it."""


_DRIVEN: Final[Mapping[str, Callable[[type[Plant]], Peer]]] = MappingProxyType(
    {"persistence": OutputPersistence, "arx": InputArx}
)
"""The same for a plant whose loop is not known."""


class Absent(NamedTuple):
    """A peer that cannot be asked here."""

    name: str
    reason: str
    """Why, and what helps."""


def peers(
    plant: type[Plant], names: Sequence[str] = tuple(PEERS), *, driven: bool = False
) -> tuple[list[Peer], list[Absent]]:
    """The peers with these names, and those of them that are not installed, or, where the loop is not known
    and everybody is given the inputs that came (`driven`), that foretell nothing but both signals of a loop.

    Raises:
        BacktestError: there is no such peer.
    """
    found: list[Peer] = []
    absent: list[Absent] = []
    for name in names:
        if name not in PEERS:
            raise BacktestError(f"no peer {name!r}; there are {', '.join(PEERS)}")
        if driven and name not in _DRIVEN:
            both = "it foretells output and input of a loop; here the inputs are given"
            absent.append(Absent(PEERS[name](plant).name, both))
            continue
        peer = (_DRIVEN if driven else PEERS)[name](plant)
        missing = peer.missing() if isinstance(peer, VectorAutoregression) else ""
        if missing:
            absent.append(Absent(peer.name, missing))
        else:
            found.append(peer)
    return found, absent
