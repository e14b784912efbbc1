"""The layout that is shipped and the topics that are offered: every name exists and its kind fits."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.plants import Peltier
from twinmatch.plants.records import description_of
from twinmatch.showing.foxglove.layout import APPLIED, IMAGE, OUTSIDE, TOPICS, layout

PROJECT = Path(__file__).resolve().parents[3]
LAYOUT = json.loads((PROJECT / "config" / "foxglove_layout.json").read_text("utf-8"))
PANELS: dict[str, Any] = LAYOUT["configById"]
KINDS = {f"/{name}": kind for name, kind in TOPICS.items()} | OUTSIDE
NUMBER = re.compile(r"double|float|u?int(8|16|32|64)|boolean")


def field_type(path: str) -> str:
    """ROS type of what a message path leads to; fails if it leads nowhere."""
    topic = path.split(".", maxsplit=1)[0]
    kind = KINDS[topic].replace("/msg/", "/")
    for name in path.removeprefix(topic).strip(".").split("."):
        name, _, element = name.partition("[")  # noqa: PLW2901 (the index is not part of the name)
        if name:
            package, short = re.sub(r"^sequence<|>$|\[\d*\]$", "", kind).split("/")
            message = getattr(importlib.import_module(f"{package}.msg"), short)
            kind = message.get_fields_and_field_types()[name]
        if element:
            kind = kind.removeprefix("sequence<").removesuffix(">")
    return kind


def panels(kind: str) -> list[dict[str, Any]]:
    found = [config for name, config in PANELS.items() if name.startswith(f"{kind}!")]
    assert found
    return found


def placed(node: Any) -> Iterator[str]:
    """Panels in a mosaic, those in its tabs included."""
    if isinstance(node, str):
        yield node
        for tab in PANELS[node].get("tabs", []):
            yield from placed(tab["layout"])
    else:
        assert node["direction"] in {"row", "column"}
        yield from placed(node["first"])
        yield from placed(node["second"])


def test_the_shipped_layout_is_the_one_of_its_plant() -> None:
    """A change of the layout or of the plant's words has to be written into the file that is shipped."""
    assert layout(description_of(Peltier), (APPLIED, IMAGE)) == LAYOUT


def test_every_panel_has_its_place() -> None:
    assert sorted(placed(LAYOUT["layout"])) == sorted(PANELS)


def test_what_is_plotted_is_a_number_with_a_stamp_and_a_colour_of_its_own() -> None:
    for panel in panels("Plot"):
        for path in panel["paths"]:
            assert NUMBER.fullmatch(field_type(path["value"])), path
            assert field_type(path["value"].split(".")[0] + ".header") == "std_msgs/Header"
            assert path["enabled"]
            assert path["timestampMethod"] == "headerStamp"
        if panel["xAxisVal"] == "currentCustom":  # the newest message over one of its own lists
            assert NUMBER.fullmatch(field_type(panel["xAxisPath"]["value"])), panel
        assert len({path["color"] for path in panel["paths"]}) == len(panel["paths"])


def test_the_plots_show_plant_twin_set_point_control_and_residuals() -> None:
    shown = {path["value"] for panel in panels("Plot") for path in panel["paths"]}
    assert {
        "/plant/sample.output[0]",
        "/plant/sample.reference[0]",
        "/plant/sample.input[0]",
        "/twin/state.closed_output[0]",
        "/twin/state.driven_residual_y[0]",
        "/twin/state.closed_residual_u[0]",
        "/twin/forecast.output_low[:]",
        "/twin/forecast.input[:]",
    } <= shown


def test_the_other_panels_look_at_what_there_is() -> None:
    assert [panel["imageMode"]["imageTopic"] for panel in panels("Image")] == ["/thermal/image"]
    assert KINDS["/thermal/image"] == "sensor_msgs/msg/Image"
    for panel in panels("StateTransitions"):
        assert all(field_type(path["value"]) == "string" for path in panel["paths"])
    for panel in panels("RawMessages"):
        assert panel["topicPath"] in KINDS
    for panel in panels("Table"):
        assert field_type(panel["topicPath"]).startswith("sequence<twinmatch_msgs/")
    for panel in [*panels("DiagnosticSummary"), *panels("DiagnosticStatusPanel")]:
        assert KINDS[panel["topicToRender"]] == "diagnostic_msgs/msg/DiagnosticArray"


def test_the_light_knows_every_level() -> None:
    from twinmatch.comparing import TrustLevel

    [light] = panels("Indicator")
    assert field_type(light["path"]) == "string"
    assert {rule["rawValue"] for rule in light["rules"]} == {level.value for level in TrustLevel}


def test_the_topics_are_those_of_the_subscribers_page() -> None:
    page = (PROJECT / "docs" / "subscribing.md").read_text("utf-8")
    told = dict(re.findall(r"^\| `(\S+)` \| `(\w+/\w+)` \|", page, re.MULTILINE))
    offered = {name: kind.replace("/msg/", "/") for name, kind in (TOPICS | OUTSIDE).items()}
    assert told.items() - {("/clock", "rosgraph_msgs/Clock")} == offered.items() - {
        ("/rosout", "rcl_interfaces/Log")
    }
