"""Schemas of installed types."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.support.schemas import bare
from twinmatch.sessions import SessionError
from twinmatch.sessions.definitions import FLOAT64, LOOP_SAMPLE, TEMPERATURE, schema_of

SHARE = Path(sys.prefix) / "share"


@pytest.mark.parametrize("known", [LOOP_SAMPLE, TEMPERATURE, FLOAT64], ids=lambda t: t.name)
def test_installed_schemas_are_the_known_ones(known):
    if not (SHARE / "twinmatch_msgs").is_dir():
        pytest.skip("twinmatch_msgs is not built; run make setup")
    assert bare(schema_of(known.name)) == bare(known.schema)


def install(folder: Path, **texts: str) -> dict[str, str]:
    for name, text in texts.items():
        path = folder / "share" / "rig_msgs" / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return {"AMENT_PREFIX_PATH": f"/nowhere:{folder}"}


def test_parts_come_once_and_in_their_order(tmp_path):
    environment = install(
        tmp_path,
        Frame="# a Nothing here\nuint8 KIND=3\nPixel[<=4] pixels\nrig_msgs/Lens lens\nstring<=9 name\n",
        Pixel="float64[2] at\nbool DEAD = true # Ghost x\n",
        Lens="Pixel centre\n",
    )
    blocks = schema_of("rig_msgs/msg/Frame", environment).split("=" * 80 + "\n")
    assert [block.split("\n")[0] for block in blocks[1:]] == ["MSG: rig_msgs/Pixel", "MSG: rig_msgs/Lens"]


def test_full_names_of_parts_are_understood(tmp_path):
    environment = install(tmp_path, Frame="rig_msgs/msg/Lens lens\n", Lens="bool clean\n")
    assert "MSG: rig_msgs/Lens" in schema_of("rig_msgs/msg/Frame", environment)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("rig_msgs/msg/Ghost", "the definition of rig_msgs/msg/Ghost is not installed; looked in /nowhere"),
        ("rig_msgs/msg/Frame", "the definition of rig_msgs/msg/Pixel is not installed"),
        ("../../etc/passwd", "is not a message type"),
        ("rig_msgs/srv/Ask", "is not a message type"),
    ],
)
def test_what_is_not_installed_is_named(tmp_path, kind, message):
    with pytest.raises(SessionError, match=message):
        schema_of(kind, install(tmp_path, Frame="Pixel pixel\n"))
