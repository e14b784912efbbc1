"""The messages that are installed are those of the sources."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PACKAGE = PROJECT / "src" / "twinmatch_msgs"
SOURCES = sorted((PACKAGE / "msg").glob("*.msg"))
SERVICES = sorted((PACKAGE / "srv").glob("*.srv"))

pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")


@pytest.mark.parametrize("source", SOURCES + SERVICES, ids=lambda path: path.stem)
def test_installed_message_is_up_to_date(source: Path) -> None:
    installed = Path(sys.prefix) / "share" / "twinmatch_msgs" / source.parent.name / source.name
    if not installed.exists():
        pytest.skip("twinmatch_msgs comes from elsewhere than this environment")
    assert installed.read_text() == source.read_text(), "run make setup"


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_message_round_trip(source: Path) -> None:
    _there_and_back(getattr(importlib.import_module("twinmatch_msgs.msg"), source.stem))


@pytest.mark.parametrize("source", SERVICES, ids=lambda path: path.stem)
def test_service_round_trip(source: Path) -> None:
    kind = getattr(importlib.import_module("twinmatch_msgs.srv"), source.stem)
    _there_and_back(kind.Request)
    _there_and_back(kind.Response)


def _there_and_back(kind: Any) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    message = kind()
    for field, name in kind.get_fields_and_field_types().items():
        if name == "double":
            setattr(message, field, 0.1 + 0.2)
        elif name == "sequence<double>":
            setattr(message, field, [0.1 + 0.2, float("inf")])
    assert deserialize_message(serialize_message(message), kind) == message


def test_fast_dds_finds_the_introspection() -> None:
    """Without it rcl prints a page about an overwritten error in every program that uses two messages."""
    program = """
from twinmatch.nodes import network
network.prepare()
import rclpy
from twinmatch_msgs.msg import LoopSample, Match
rclpy.init()
for name in ("one", "two"):
    node = rclpy.create_node(name)
    node.create_publisher(LoopSample, "sample", 10)
    node.create_subscription(Match, "match", print, 10)
    node.destroy_node()
rclpy.shutdown()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_no_single_precision() -> None:
    """A float32 would round, and live and replayed verdicts would differ."""
    for source in SOURCES + SERVICES:
        assert not re.search(r"^float32", source.read_text(), re.MULTILINE), source.name
