"""Requests as the twin of a run signs them."""

from __future__ import annotations

from typing import Any, Final

from twinmatch.nodes.signature import RunSignature
from twinmatch_msgs.srv import ApplyLaw

SECRET: Final = "a secret of thirty-two characters"


def signed(secret: str = SECRET, **fields: Any) -> dict[str, Any]:
    """The fields of a request to the controller, with the signature of a run."""
    signature = RunSignature(secret).of(ApplyLaw.Request(**fields))
    return fields | {"signature": signature}
