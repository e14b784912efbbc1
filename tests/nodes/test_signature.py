"""The signature of a run."""

from __future__ import annotations

import pytest

from twinmatch.nodes.signature import VARIABLE, RunSignature, new_secret
from twinmatch_msgs.srv import ApplyLaw

FIELDS = {
    "proportional": [1.0],
    "low": [0.1, 0.2],
    "sample": 7,
    "decision": "safe",
    "request": "a",
}


def test_it_is_of_all_fields_and_of_the_secret() -> None:
    """A request that differs in any field, or is signed by another run, has another signature."""
    run_signature = RunSignature(new_secret())
    signed = ApplyLaw.Request(
        **FIELDS, signature=run_signature.of(ApplyLaw.Request(**FIELDS))
    )
    assert run_signature.signs(signed)
    assert not RunSignature(new_secret()).signs(signed)
    for name, value in (
        ("proportional", [1.0000000000000002]),
        ("low", [0.1]),
        ("sample", 8),
        ("although", True),
        ("decision", "Safe"),
        ("request", "b"),
        ("signature", ""),
        ("signature", "é"),
    ):
        changed = ApplyLaw.Request(
            **FIELDS | {"signature": signed.signature} | {name: value}
        )
        assert not run_signature.signs(changed), name


@pytest.mark.parametrize("secret", ["", "short"])
def test_without_a_secret_of_some_length_there_is_none(secret: str) -> None:
    assert RunSignature.of_run({VARIABLE: secret}) is None
    assert RunSignature.of_run({}) is None
    assert RunSignature.of_run({VARIABLE: new_secret()}) is not None
