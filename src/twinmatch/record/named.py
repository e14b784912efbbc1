"""Parameters of a plant in a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.dynamics import Parameters
from twinmatch.plants import named as names_of

__all__ = ["parameters_document", "parameters_of", "parameters_tree"]


def parameters_tree(parameters: Parameters | None) -> dict[str, Any]:
    """As a message has them; without names where there are none."""
    held = names_of.named(parameters)._asdict()
    return {key: value if isinstance(value, str) else list(value) for key, value in held.items()}


def parameters_of(tree: Mapping[str, Any]) -> Parameters | None:
    """Parameters of such a tree; None where there are none.

    Raises:
        PlantError: those of a plant that is not known, or values it cannot have.
    """
    return names_of.parameters_of(tree["plant"], tree["structure"], tree["names"], tree["values"])


def parameters_document(parameters: Parameters) -> dict[str, float]:
    """By name in their own units."""
    return dict(parameters)
