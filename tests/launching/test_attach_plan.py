"""What `attach` writes for the nodes: one time for all, and the signals of several loops by their names."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from tests.support.oven import MAP, oven_file
from tests.support.processes import no_plant_files
from twinmatch.launching.plan import AttachPlan, attach_plan
from twinmatch.parameters.declared import ParameterError, sections_of
from twinmatch.sampling.sources import SignalMap, parse_map


def planned(folder: Path, sim_time: str) -> AttachPlan:
    config = folder / "sampler.yaml"
    config.write_text(
        f"sampler:\n  ros__parameters:\n    wait_timeout: 0.0\n{sim_time}", "utf-8"
    )
    command_line_map = parse_map([f"{name}={text}" for name, text in MAP.items()])
    written = folder / "written"
    written.mkdir()
    with no_plant_files():
        return attach_plan(
            written,
            command_line_map.joined(SignalMap(plant=str(oven_file(folder)))),
            config=config,
        )


@pytest.mark.parametrize(
    ("value", "is_simulated"), [("true", True), ("false", False), (None, False)]
)
def test_simulated_time_is_that_of_sampler_twin_and_recorder(
    value: str | None, is_simulated: bool, tmp_path: Path
) -> None:
    plan = planned(tmp_path, "" if value is None else f"    use_sim_time: {value}\n")
    for words in (
        plan.rig_arguments({}),
        plan.twin_arguments(),
        plan.recorder_arguments(tmp_path / "run"),
    ):
        assert ("use_sim_time:=true" in words) == is_simulated


def test_what_is_not_true_or_false_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ParameterError,
        match="parameter use_sim_time is 'yes'; it must be true or false",
    ):
        planned(tmp_path, '    use_sim_time: "yes"\n')


BOTH = [
    "output.1=/t1",
    "second_temperature=/t2",
    "input.1=/q1",
    "second=/q2",
    "reference.1=/w1",
]


def test_two_loops_are_mapped_by_name_and_number_in_file_and_command_line(
    tmp_path: Path,
) -> None:
    config = tmp_path / "rig.yaml"
    parameters = {
        "plant": "tclab-both",
        "paced_by": "input.2",
        "max_age": {"output.1": 9.0},
        "map": {"output.1": "/x"},
    }
    config.write_text(
        yaml.safe_dump({"sampler": {"ros__parameters": parameters}}), "utf-8"
    )
    closed = attach_plan(tmp_path, parse_map([*BOTH, "reference.2=/w2"]), config=config)
    values = sections_of(closed.sampler, "sampler")
    names = ("temperature", "second_temperature", "power", "second")
    assert [values[f"map.{name}"] for name in names] == ["/t1", "/t2", "/q1", "/q2"]
    assert [values[f"map.{y}_reference"] for y in names[:2]] == ["/w1", "/w2"]
    assert (values["max_age.temperature"], values["paced_by"]) == (9.0, "second")
    assert closed.twin_config is not None
    assert sections_of(closed.twin_config, "/**")["plant"] == "tclab-both"
    with pytest.raises(
        ParameterError, match=r"map.second_temperature_reference is missing; .* or none"
    ):
        attach_plan(tmp_path, parse_map(BOTH), config=config)
    with pytest.raises(
        ParameterError, match=r"map.second is missing; give its topic and field"
    ):
        attach_plan(tmp_path, parse_map(BOTH[:3]), config=config)
