"""The signature by which a controller knows that the twin of its run has answered.

Everybody on the domain can call `plant/apply_law` and say that a law is safe. What starts a run hands a
secret to the twin and to the controller in their environment, which no topic shows and only this user can
read. The twin signs what it asks for with it (HMAC, RFC 2104, with SHA-256); a controller takes nothing else.
"""

from __future__ import annotations

import hmac
import os
import secrets
from collections.abc import Mapping
from typing import Any, Final

VARIABLE: Final = "TWINMATCH_RUN_SECRET"
"""Environment variable with the secret of a run: the same for the twin and the controller."""
LEAST: Final = 16
"""Fewest characters of a secret that counts."""
WITHOUT: Final = (
    f"was started without a secret of its run ({VARIABLE}), so that no law can be put on trial: start the "
    "rig and its twin with live, or both with the same secret in that variable"
)
"""What a node says that has no secret, after its name."""


def new_secret() -> str:
    """A secret for a run."""
    return secrets.token_hex(32)


class RunSignature:
    """Signs requests with the secret of a run, and recognises their signatures."""

    def __init__(self, secret: str) -> None:
        """Keep the secret."""
        self._secret = secret.encode()

    @classmethod
    def of_run(cls, environment: Mapping[str, str] = os.environ) -> RunSignature | None:
        """The signature of the run of this process; None if no secret was handed to it."""
        secret = environment.get(VARIABLE, "")
        return cls(secret) if len(secret) >= LEAST else None

    def of(self, request: Any) -> str:
        """The signature of all fields of a request but `signature`."""
        signed = {}
        for name in request.get_fields_and_field_types():
            value = getattr(request, name)
            if name != "signature":
                signed[name] = (
                    value
                    if isinstance(value, bool | int | float | str)
                    else list(value)
                )
        # Not the serialised message: it has bytes between its fields that mean nothing. A number is written
        # with all its digits.
        return hmac.new(
            self._secret, repr(signed).encode(errors="replace"), "sha256"
        ).hexdigest()

    def signs(self, request: Any) -> bool:
        """Whether a request has its signature."""
        return hmac.compare_digest(
            self.of(request).encode(), request.signature.encode()
        )
