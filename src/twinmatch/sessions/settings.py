"""Metadata records of a session: its plant, the parameters of its nodes, its initial candidates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.sessions.documents import parse_json
from twinmatch.sessions.errors import DocumentError, SessionError

__all__ = ["CANDIDATES", "PLANT", "has_reference", "parameters_of", "parameters_record", "plant_of"]

PLANT = "twinmatch/plant"
"""Record with the name of the `plant`; an import adds `source`, `map`, and `reference` if there is none."""
NO_REFERENCE = "none"
SAMPLED = "map.reference"
"""Parameter of the sampler with the topic of the set-points; empty: there are none."""
PARAMETERS = "twinmatch/parameters"
CANDIDATES = "twinmatch/candidates"
"""Record with the `text` of the discriminator's file of initial candidates; empty: it was not readable."""


def parameters_record(node: str) -> str:
    """Name of the record with the parameters of a node (full name); the values are JSON."""
    return PARAMETERS + node


def parameters_of(records: Mapping[str, Mapping[str, str]], node: str) -> dict[str, Any] | None:
    """The parameters of a node (full name); None if they were not recorded.

    Raises:
        SessionError: a value is not valid JSON.
    """
    found = records.get(parameters_record(node))
    if found is None:
        return None
    try:
        return {name: parse_json(value, name) for name, value in found.items()}
    except DocumentError as error:
        msg = f"session: the recorded parameters of {node} cannot be read: {error}"
        raise SessionError(msg) from error


def plant_of(records: Mapping[str, Mapping[str, str]]) -> str:
    """The recorded plant of a session: its name, or the path of its file; empty if not recorded."""
    plant = records.get(PLANT, {}).get("plant", "")
    for name, values in records.items():
        if not plant and name.startswith(PARAMETERS) and "plant" in values:
            try:
                plant = str(parse_json(values["plant"], name))
            except DocumentError:
                continue
    return plant


def has_reference(records: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether the session's set-points are meaningful; False if an import found none, or the sampler had no
    topic for them."""
    topics = (values.get(SAMPLED) for name, values in records.items() if name.startswith(PARAMETERS))
    return records.get(PLANT, {}).get("reference", "") != NO_REFERENCE and '""' not in topics
