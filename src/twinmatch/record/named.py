"""Parameters of a plant in a record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from twinmatch.plant import RigParameters
from twinmatch.plant.named import named
from twinmatch.plant.named import parameters_of as rig_of

__all__ = ["parameters_document", "parameters_of", "parameters_tree"]


def parameters_tree(parameters: RigParameters | None) -> dict[str, Any]:
    """As a message has them; without names where there are none."""
    held = named(parameters)._asdict()
    return {key: value if isinstance(value, str) else list(value) for key, value in held.items()}


def parameters_of(tree: Mapping[str, Any]) -> RigParameters | None:
    """Parameters of such a tree; None where there are none.

    Raises:
        PlantError: those of another plant, or values it cannot have.
    """
    return rig_of(tree["plant"], tree["names"], tree["values"])


def parameters_document(parameters: RigParameters) -> dict[str, float | None]:
    """By name in their own units; what has no bound is None: a sink held at ambient has no heat capacity."""
    held = named(parameters)
    pairs = zip(held.names, held.values, strict=True)
    return {name: value if math.isfinite(value) else None for name, value in pairs}
