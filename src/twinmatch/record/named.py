"""Convert a plant's parameters to and from records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.dynamics import Parameters
from twinmatch.plants import named as names_of

__all__ = ["parameters_document", "parameters_of", "parameters_tree"]


def parameters_tree(parameters: Parameters | None) -> dict[str, Any]:
    """The parameters as in a message; for None without names."""
    held = names_of.named(parameters)._asdict()
    return {key: value if isinstance(value, str) else list(value) for key, value in held.items()}


def parameters_of(tree: Mapping[str, Any]) -> Parameters | None:
    """The parameters of such a tree; None if it has none.

    Raises:
        PlantError: the plant is unknown, or a value is out of range.
    """
    return names_of.parameters_of(tree["plant"], tree["structure"], tree["names"], tree["values"])


def parameters_document(parameters: Parameters) -> dict[str, float]:
    """The values by name, in their own units."""
    return dict(parameters)
