"""Whether a twin runs in closed loop, and with which controller."""

from __future__ import annotations

import dataclasses
from enum import Enum
from typing import Final

from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.pid import PidGains
from twinmatch.dynamics.plant import Plant

__all__ = ["FILED", "Closing", "Filed", "gains_for", "gains_of"]


class Filed(Enum):
    """Placeholder for the plant file's controller, which may be unknown."""

    LOOP = "plant file"


FILED: Final = Filed.LOOP

Closing = PidGains | Filed | None
"""A controller; `FILED`; or None if the loop is not known and the twin is driven by the recorded input."""


def gains_for(plant: type[Plant], period: float, closing: Closing = FILED) -> PidGains | None:
    """The controller of a closed-loop twin at a sample time, s; None for a driven twin."""
    if not isinstance(closing, Filed):
        return closing
    held = plant.loop
    return held if held is None or held.period == period else dataclasses.replace(held, period=period)


def gains_of(plant: type[Plant], period: float) -> PidGains:
    """The plant's controller at a sample time, s.

    Raises:
        PlantError: the plant's controller is not known.
    """
    gains = gains_for(plant, period)
    if gains is None:
        msg = f"plant {plant.name}: its controller is not known; use the driven twin"
        raise PlantError(msg)
    return gains
