"""The sampler's parameters: config/attach.yaml is their table, and every plant has one."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from tests.support.places import PROJECT
from tests.support.plant_files import plant_file
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.recorder import RecorderNode
from twinmatch.nodes.sampler import SamplerNode, limits_of, sampler_table, sources_of, types_of, understood
from twinmatch.parameters.declared import check, render
from twinmatch.plants import PLANTS, find_plant

CONFIG = PROJECT / "config" / "attach.yaml"
EXAMPLE = {
    "map.reference": "/rig/set_point:data",
    "map.output": "/rig/temperature:temperature",
    "map.input": "/rig/command:data",
}


def test_the_file_is_what_the_tables_render() -> None:
    text = CONFIG.read_text(encoding="utf-8")
    sampler = render(SamplerNode.NAME, SamplerNode.PARAMETERS, EXAMPLE)
    assert text.endswith(sampler + render(RecorderNode.NAME, RecorderNode.PARAMETERS))
    values = yaml.safe_load(text)["sampler"]["ros__parameters"]
    held = check("sampler", SamplerNode.PARAMETERS, values)
    assert held == {**check("sampler", SamplerNode.PARAMETERS, {}), **EXAMPLE}
    assert list(sources_of("sampler", held)) == ["reference", "output", "input"]


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_every_plant_has_a_table_with_its_own_signals(name: str) -> None:
    plant = PLANTS[name]
    names = {parameter.name for parameter in sampler_table(plant)}
    signals = {"reference", "output", "input", *plant.disturbances}
    assert {n for n in names if n.startswith("map.")} == {f"map.{signal}" for signal in signals}
    assert {n for n in names if n.startswith("max_age.")} == {f"max_age.{signal}" for signal in signals}


def test_a_plant_in_a_file_has_its_disturbances_and_ages_follow_the_period(tmp_path: Path) -> None:
    path = str(plant_file(tmp_path, "attached_block"))
    given = {"plant": path, "period": 0.1, "map.output": "/t", "map.input": "/u", "map.room": "/room; unit=K"}
    values = check("sampler", understood("sampler", given), given)
    sources = sources_of("sampler", values)
    assert list(sources) == ["output", "input", "room"]
    limits = limits_of(values, sources)
    assert limits["output"].max_age == pytest.approx(0.3)
    assert (limits["input"].low, limits["input"].high) == pytest.approx((0.0, 100.0), abs=1e-6)
    assert sources["room"].to("°C", ["std_msgs/msg/Float64"], ["data"]).value([300.0]) == pytest.approx(26.85)
    assert find_plant(path).disturbances.keys() == {"room"}


def test_several_topics_give_their_mean() -> None:
    given = {"map.output": "/t2:data, /t3:data; scale=0.1; offset=-4", "map.input": "/u"}
    source = sources_of("sampler", check("sampler", understood("sampler", given), given))["output"]
    assert [channel.text for channel in source.channels] == ["/t2:data", "/t3:data"]
    assert source.value([200.0, 300.0]) == pytest.approx(21.0)


def test_units_that_messages_have_by_their_definition_are_known() -> None:
    given = {"map.output": "/t", "map.input": "/u"}
    source = sources_of("sampler", check("sampler", understood("sampler", given), given))["output"]
    kinds = ["sensor_msgs/msg/Temperature"]
    assert source.to("K", kinds, ["temperature"]).value([20.0]) == pytest.approx(293.15)
    assert source.to("°C", kinds, ["temperature"]).value([20.0]) == 20.0
    with pytest.raises(TwinmatchError, match=r"in Pa \(according to sensor_msgs/msg/FluidPressure\)"):
        source.to("°C", ["sensor_msgs/msg/FluidPressure"], ["fluid_pressure"])


def test_types_are_read_as_they_are_written() -> None:
    text = "/cmd std_msgs/msg/Float64, /t sensor_msgs/msg/Temperature"
    assert types_of("sampler", text) == {
        "/cmd": "std_msgs/msg/Float64",
        "/t": "sensor_msgs/msg/Temperature",
    }
    with pytest.raises(TwinmatchError, match="write TOPIC TYPE"):
        types_of("sampler", "/cmd")
