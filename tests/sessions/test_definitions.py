"""Our definitions are those of the installed messages, the hashes those of ROS 2; schemas of any types."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.support.schemas import bare
from twinmatch.sessions import SessionError, messages
from twinmatch.sessions.messages import (
    FLOAT64,
    HEADER,
    LOOP_SAMPLE,
    TEMPERATURE,
    TIME,
    fields_of,
    schema_of,
)

TYPES = (LOOP_SAMPLE, HEADER, TIME, TEMPERATURE, FLOAT64)
SOURCE = Path(messages.__file__).parents[2] / "twinmatch_msgs" / "msg"


def share_folders() -> list[Path]:
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    return [Path(prefix) / "share" for prefix in prefixes if prefix]


def installed(name: str, suffix: str) -> Path:
    package, _, short = name.split("/")
    for share in share_folders():
        path = share / package / "msg" / f"{short}{suffix}"
        if path.is_file():
            return path
    return pytest.skip(f"no {short}{suffix} of {package} is installed to compare with")


def test_loop_sample_is_the_text_of_our_message_package():
    if not SOURCE.is_dir():
        pytest.skip("the sources of twinmatch_msgs are not beside this package")
    assert (SOURCE / "LoopSample.msg").read_text("utf-8") == LOOP_SAMPLE.text


@pytest.mark.parametrize("message", TYPES, ids=lambda m: m.name)
def test_texts_are_the_installed_ones(message):
    assert bare(installed(message.name, ".msg").read_text("utf-8")) == bare(message.text)


@pytest.mark.parametrize("message", TYPES, ids=lambda m: m.name)
def test_hashes_are_the_installed_ones(message):
    published = json.loads(installed(message.name, ".json").read_text("utf-8"))["type_hashes"]
    assert {h["type_name"]: h["hash_string"] for h in published}[message.name] == message.type_hash


@pytest.mark.parametrize("message", TYPES, ids=lambda m: m.name)
def test_hashes_are_those_of_an_independent_implementation(message):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(message.schema, message.name))
    assert store.hash_rihs01(message.name) == message.type_hash


def test_schema_names_each_part_once():
    headings = [line for line in LOOP_SAMPLE.schema.splitlines() if line.startswith("MSG: ")]
    assert headings == ["MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]


def test_fields_ignore_comments_and_blanks():
    text = "# a\nfloat64   x  # metres\n\n" + "=" * 80 + "\nMSG: a/B\nint8 y\n"
    assert fields_of(text) == ["float64 x"]


@pytest.mark.parametrize("known", [LOOP_SAMPLE, TEMPERATURE, FLOAT64], ids=lambda t: t.name)
def test_installed_schemas_are_the_known_ones(known):
    if not (Path(sys.prefix) / "share" / "twinmatch_msgs").is_dir():
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
