"""A simulated rig: its time is that of all nodes beside it, or the configuration is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from tests.support.oven import MAP, oven_file
from tests.support.processes import no_plant_files
from twinmatch.launching.plan import AttachPlan, attach_plan
from twinmatch.parameters.declared import ParameterError
from twinmatch.sampling.sources import SignalMap, parse_map


def planned(folder: Path, sim_time: str) -> AttachPlan:
    config = folder / "sampler.yaml"
    config.write_text(f"sampler:\n  ros__parameters:\n    wait_timeout: 0.0\n{sim_time}", "utf-8")
    said = parse_map([f"{name}={text}" for name, text in MAP.items()])
    written = folder / "written"
    written.mkdir()
    with no_plant_files():
        return attach_plan(written, said.joined(SignalMap(plant=str(oven_file(folder)))), config=config)


@pytest.mark.parametrize(("value", "given"), [("true", True), ("false", False), (None, False)])
def test_simulated_time_is_that_of_sampler_twin_and_recorder(
    value: str | None, given: bool, tmp_path: Path
) -> None:
    plan = planned(tmp_path, "" if value is None else f"    use_sim_time: {value}\n")
    for words in (plan.rig_arguments({}), plan.twin_arguments(), plan.recorder_arguments(tmp_path / "run")):
        assert ("use_sim_time:=true" in words) == given


def test_what_is_not_true_or_false_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="parameter use_sim_time is 'yes'; it must be true or false"):
        planned(tmp_path, '    use_sim_time: "yes"\n')
