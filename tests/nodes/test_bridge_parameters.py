"""The bridges' sections of config/rig.yaml are their tables, and the tables make the settings they name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.nodes.camera_bridge import CameraBridge
from twinmatch.nodes.gated import gate_limits, gate_table
from twinmatch.nodes.pwm_bridge import PwmBridge
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.parameters.declared import check, render
from twinmatch.safety import GuardLimits, OutputGuard, RunawayLimits, SafetyError

CONFIG = Path(__file__).resolve().parents[2] / "config" / "rig.yaml"


@pytest.mark.parametrize("kind", [CameraBridge, PwmBridge])
def test_the_file_is_what_the_table_renders(kind: Any) -> None:
    text = CONFIG.read_text(encoding="utf-8")
    assert render(kind.NAME, kind.PARAMETERS) in text
    values = yaml.safe_load(text)[kind.NAME]["ros__parameters"]
    assert check(kind.NAME, kind.PARAMETERS, values) == check(kind.NAME, kind.PARAMETERS, {})


@pytest.mark.parametrize("kind", [PwmBridge, TCLabBridge])
def test_the_defaults_are_those_of_the_guard(kind: Any) -> None:
    assert gate_limits(kind.LIMITS, check("node", kind.PARAMETERS, {})) == kind.LIMITS
    assert GuardLimits() == PwmBridge.LIMITS


def test_each_limit_has_its_parameter() -> None:
    given = {"command_timeout": 0.5, "temperature_timeout": 2.0, "highest": 90.0, "lowest": 5.0}
    runaway = {"hysteresis": 1.0, "patience": 2.0, "gain": 3.0, "gain_time": 4.0, "wrong_way": 5.0}
    prefixed = {f"runaway.{name}": value for name, value in (runaway | {"full_drive": 99.0}).items()}
    limits = gate_limits(PwmBridge.LIMITS, check("node", PwmBridge.PARAMETERS, {**given, **prefixed}))
    assert {name: getattr(limits, name) for name in given} == given
    assert limits.runaway == RunawayLimits(**runaway, full_drive=99.0)


def test_limits_that_contradict_each_other_are_refused() -> None:
    values = check("node", PwmBridge.PARAMETERS, {"highest": 10.0, "lowest": 20.0})
    with pytest.raises(SafetyError, match="must be below"):
        gate_limits(PwmBridge.LIMITS, values)


def test_units_are_those_of_the_plant() -> None:
    """A motor has no degrees: neither in its parameters nor in its faults."""
    limits = GuardLimits(highest=90.0, lowest=-90.0, thing="shaft", unit="rad/s", drive_unit="V")
    table = {parameter.name: parameter for parameter in gate_table(limits)}
    assert table["highest"].unit == table["runaway.gain"].unit == "rad/s"
    assert table["runaway.patience"].unit == "rad/s·s"
    assert table["runaway.full_drive"].unit == "V"
    guard = OutputGuard(limits)
    guard.temperature(95.0, 0.0)
    assert guard.fault is not None
    assert guard.fault.message.startswith("the shaft is at 95.0 rad/s, above 90 rad/s")
    with pytest.raises(SafetyError, match=r"100\.0 rad/s must be below"):
        replace(limits, lowest=100.0)
