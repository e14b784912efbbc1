"""A session judged without its controller: recorded, verified, forecast, tested and written up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from tests.support.places import SHIPPED
from tests.support.recorded import write_judged
from tests.support.steps import quarter_of_an_hour
from twinmatch.cli import main
from twinmatch.offline.verification import verify_session
from twinmatch.parameters.twin import read_settings, settings_from, twin_values, values_of
from twinmatch.plants import Peltier
from twinmatch.twin import Twin, TwinSettings

pytestmark = pytest.mark.ros


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A parameter file that takes the rig's loop as unknown."""
    path = tmp_path / "unknown.yaml"
    path.write_text("/**:\n  ros__parameters:\n    loop: unknown\n", encoding="utf-8")
    return path


def test_parameters_say_that_the_loop_is_not_known(config: Path, tmp_path: Path) -> None:
    settings = read_settings(config)
    assert settings == TwinSettings.of(Peltier, gains=None)
    assert settings_from(twin_values("again", values_of(settings))) == settings
    assert "pid.proportional" not in values_of(settings)
    wrong = tmp_path / "wrong.yaml"
    for line in ("pid.integral: 0.6", "schedule.min_step: 2.0"):
        wrong.write_text(f"/**:\n  ros__parameters:\n    loop: unknown\n    {line}\n", encoding="utf-8")
        assert main(["replay", str(SHIPPED), "--config", str(wrong)]) == 2


def test_a_recorded_session_is_verified_bit_for_bit(tmp_path: Path) -> None:
    """Through messages and back: what is absent there is NaN."""
    samples, settings = quarter_of_an_hour(), TwinSettings.of(Peltier, gains=None)
    twin = Twin(settings)
    outcomes = [twin.push(sample) for sample in samples]
    found = verify_session(write_judged(tmp_path / "run", samples, outcomes, values_of(settings)))
    assert found.identical
    assert found.matches >= 2


def test_a_forecast_is_asked_for_under_inputs(config: Path, capsys: Any, tmp_path: Path) -> None:
    asked = ["forecast", str(SHIPPED), "--config", str(config), "--at", "1200"]
    assert main([*asked, "--hold", "80", "--horizon", "60", "--json", str(tmp_path / "f.json")]) == 0
    told = capsys.readouterr().out
    assert "80 PWM held" in told
    assert "the loop is not known: the forecast is for the given inputs" in told
    [document] = json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))
    assert document["reference"] is None
    assert document["u"]["mean"] == [80.0] * 60
    assert main([*asked, "--reference", "recorded"]) == 0
    told = capsys.readouterr().out
    assert "the recorded inputs" in told
    assert "% of the temperature" in told
    assert "nan" not in told
    assert main([*asked, "--hold", "900"]) == 2
    assert "the input now is 900 PWM; give one from -255 to 255 PWM" in capsys.readouterr().err
