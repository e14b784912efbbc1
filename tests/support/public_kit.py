"""A kit by the public package's model, whose equations are not ours."""

from __future__ import annotations

import random
from typing import Any

import pytest


def public_kit(seed: int) -> Any:
    """The package's model of a kit with both heaters, at rest, on a clock of its own that begins at 0 s."""
    tclab = pytest.importorskip("tclab", reason="the kit's package is not installed")
    random.seed(seed)  # the model draws its noise there
    kit = tclab.TCLabModel(synced=False)
    kit.tlast = 0.0
    return kit
