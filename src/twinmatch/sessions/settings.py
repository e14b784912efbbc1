"""Names of the metadata records that say of which plant a session is, and how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.sessions.documents import parse_json
from twinmatch.sessions.errors import DocumentError, SessionError

__all__ = ["CANDIDATES", "PLANT", "has_reference", "parameters_of", "parameters_record", "plant_of"]

PLANT = "twinmatch/plant"
"""Record with the name of the `plant`; an import adds `source`, `map` and whether there is a `reference`."""
NO_REFERENCE = "none"
SAMPLED = "map.reference"
"""Parameter of the sampler that says which topic the set-points come from; empty: there are none."""
PARAMETERS = "twinmatch/parameters"
CANDIDATES = "twinmatch/candidates"
"""Record with the `text` of the file of candidates that the discriminator began with; empty: not readable."""


def parameters_record(node: str) -> str:
    """Name of the record with the parameters of a node, given by its full name; the values are JSON."""
    return PARAMETERS + node


def parameters_of(records: Mapping[str, Mapping[str, str]], node: str) -> dict[str, Any] | None:
    """The parameters of a node, given by its full name; None if they were not recorded.

    Raises:
        SessionError: a value is no JSON.
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
    """The plant that a session says it is of, by its name; empty if it does not say. Where a twin took the
    plant from a file, this is that file's path."""
    said = records.get(PLANT, {}).get("plant", "")
    for name, values in records.items():
        if not said and name.startswith(PARAMETERS) and "plant" in values:
            try:
                said = str(parse_json(values["plant"], name))
            except DocumentError:
                continue
    return said


def has_reference(records: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether the session's set-points say anything; False where an import found none, or the sampler of
    somebody else's rig was told of none."""
    heard = (values.get(SAMPLED) for name, values in records.items() if name.startswith(PARAMETERS))
    return records.get(PLANT, {}).get("reference", "") != NO_REFERENCE and '""' not in heard
