"""The bridges' sections of config/rig.yaml are their tables, and the tables make the settings they name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.nodes.camera_bridge import CameraBridge
from twinmatch.nodes.pwm_bridge import PWM_PARAMETERS, PwmBridge, limits_from
from twinmatch.parameters.declared import check, render
from twinmatch.safety import GuardLimits, SafetyError

CONFIG = Path(__file__).resolve().parents[2] / "config" / "rig.yaml"


@pytest.mark.parametrize("kind", [CameraBridge, PwmBridge])
def test_the_file_is_what_the_table_renders(kind: Any) -> None:
    text = CONFIG.read_text(encoding="utf-8")
    assert render(kind.NAME, kind.PARAMETERS) in text
    values = yaml.safe_load(text)[kind.NAME]["ros__parameters"]
    assert check(kind.NAME, kind.PARAMETERS, values) == check(kind.NAME, kind.PARAMETERS, {})


def test_the_defaults_are_those_of_the_guard() -> None:
    assert limits_from(check("node", PWM_PARAMETERS, {})) == GuardLimits()


def test_each_limit_has_its_parameter() -> None:
    given = {"command_timeout": 0.5, "temperature_timeout": 2.0, "highest": 90.0, "lowest": 5.0}
    runaway = {"hysteresis": 1.0, "patience": 2.0, "gain": 3.0, "gain_time": 4.0, "wrong_way": 5.0}
    prefixed = {f"runaway.{name}": value for name, value in runaway.items()}
    limits = limits_from(check("node", PWM_PARAMETERS, {**given, **prefixed, "runaway.full_drive": 99.0}))
    assert {name: getattr(limits, name) for name in given} == given
    assert {name: getattr(limits.runaway, name) for name in runaway} == runaway
    assert limits.runaway.full_drive == 99.0


def test_limits_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(SafetyError, match="must be below"):
        limits_from(check("node", PWM_PARAMETERS, {"highest": 10.0, "lowest": 20.0}))
