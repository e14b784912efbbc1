"""A few of the kinds that `benchmarks.endings` ends often, each once, at a moment that its seed chooses."""

from __future__ import annotations

import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from benchmarks.endings import KINDS, World, end_once, world

WITHIN = 3.0
"""Latest moment after the start, s."""


@pytest.fixture(scope="module")
def endings_world(ros: None) -> Iterator[World]:  # noqa: ARG001
    with world() as opened_world:
        yield opened_world


@pytest.mark.parametrize("kind", ["controller", "sampler of Modbus", "alone, Modbus"])
def test_a_process_ends_well_at_any_moment(
    kind: str, endings_world: World, tmp_path: Path
) -> None:
    rng = random.Random(kind)
    number = rng.choice([signal.SIGINT, signal.SIGTERM])
    assert not end_once(
        KINDS[kind](endings_world, tmp_path), tmp_path, rng.uniform(0.0, WITHIN), number
    ).wrong
