"""Plants, each in a file of its own that says nothing but what the plant is."""

from __future__ import annotations

from typing import Final

from twinmatch.dynamics import Plant, PlantError
from twinmatch.plants.peltier import Peltier
from twinmatch.plants.tclab import TCLab

__all__ = ["PLANTS", "Peltier", "TCLab", "find_plant"]

PLANTS: Final[dict[str, type[Plant]]] = {plant.name: plant for plant in (Peltier, TCLab)}
"""The plants that come with this package, by name."""


def find_plant(name: str) -> type[Plant]:
    """The plant of this name.

    Raises:
        PlantError: there is none.
    """
    if name not in PLANTS:
        raise PlantError(f"plant {name!r}: not known; there are {', '.join(PLANTS)}")
    return PLANTS[name]
