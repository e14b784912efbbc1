"""Waiting for something to come, as long as it takes on a busy machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import pytest

T = TypeVar("T")

PATIENCE = 360.0
"""Seconds after which a test gives up on something that takes one on an idle machine, and tens of them
where kernels are compiled first.

No test passes because this is short, and none measures speed by it.
"""


def pause() -> None:
    """What a wait does between two looks."""
    time.sleep(0.01)


def wait_for(
    condition: Callable[[], T],
    what: str | Callable[[], str],
    *,
    patience: float = PATIENCE,
    meanwhile: Callable[[], object] = pause,
) -> T:
    """Wait until a condition is true and return what it gave; the test fails if it does not come to be.

    `meanwhile` is called between two looks: it spins an executor, reads a socket or publishes something.
    `what` is printed on failure; as a function it is asked for what the failure looks like.
    """
    deadline = time.monotonic() + patience
    while not (outcome := condition()):
        if time.monotonic() > deadline:
            awaited = what if isinstance(what, str) else what()
            pytest.fail(f"did not come within {patience:g} s: {awaited}")
        meanwhile()
    return outcome
