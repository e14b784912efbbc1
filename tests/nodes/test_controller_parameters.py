"""The controller's and recorder's sections of config/rig.yaml are their tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.nodes.controller import ControllerNode, controller_table, profile_from
from twinmatch.nodes.recorder import RecorderNode
from twinmatch.parameters.declared import check, render
from twinmatch.parameters.twin import twin_table
from twinmatch.safety import GuardLimits

CONTROLLER = controller_table()
CONFIG = Path(__file__).resolve().parents[2] / "config" / "rig.yaml"


@pytest.mark.parametrize("kind", [ControllerNode, RecorderNode])
def test_the_file_is_what_the_table_renders(kind: Any) -> None:
    text = CONFIG.read_text(encoding="utf-8")
    table, _ = kind.table_for({})
    assert render(kind.NAME, table) in text
    values = yaml.safe_load(text)[kind.NAME]["ros__parameters"]
    assert check(kind.NAME, table, values) == check(kind.NAME, table, {})


def test_the_twin_knows_the_running_pid() -> None:
    twin = {p.name: p.default for p in twin_table()}
    shared = {p.name: p.default for p in CONTROLLER if p.name.startswith("pid.") or p.name == "period"}
    assert len(shared) == 8
    assert shared.items() <= twin.items()


def test_the_defaults_make_a_profile_and_suit_the_guard() -> None:
    values = check("controller", CONTROLLER, {})
    profile = profile_from(values)
    assert profile is not None
    assert profile.reference(0.0) == 30.0
    # The controller has to switch off, and to say so, before the bridge has to latch.
    assert values["max_age"] < GuardLimits().temperature_timeout
    assert 2 * values["command_period"] < GuardLimits().command_timeout
