"""Every name that the page on PlotJuggler and rqt tells is a number of a message that has a stamp."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.showing.foxglove.layout import TOPICS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "plotjuggler.md").read_text("utf-8")
NAMES = sorted(set(re.findall(r"(?<![\w.])(/(?:plant|twin)/[\w\[\]/]+)", PAGE)))
NUMBER = re.compile(r"double|float|u?int(8|16|32|64)|boolean|sequence<double>")


def test_there_are_names_of_every_kind() -> None:
    assert len(NAMES) > 20
    assert {"/plant/sample/output[0]", "/twin/match/fit_y"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_number_with_a_stamp(name: str) -> None:
    topic, fields = re.fullmatch(r"/(\w+/\w+)/(.+)", name).groups()  # type: ignore[union-attr]
    kind = TOPICS[topic].replace("/msg/", "/")
    for number, field in enumerate(fields.split("/")):
        package, short = kind.split("/")
        known = getattr(importlib.import_module(f"{package}.msg"), short).get_fields_and_field_types()
        assert number or known["header"] == "std_msgs/Header"
        kind = known[field.split("[")[0]]
        if "[" in field:
            kind = re.fullmatch(r"sequence<(.+)>", kind)[1]  # type: ignore[index]
    assert NUMBER.fullmatch(kind), f"{name} is {kind}"
