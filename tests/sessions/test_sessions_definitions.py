"""Our definitions are those of the installed messages, and the hashes those ROS 2 computes."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.support.schemas import bare
from twinmatch.sessions import definitions
from twinmatch.sessions.definitions import FLOAT64, HEADER, LOOP_SAMPLE, TEMPERATURE, TIME, fields_of

TYPES = (LOOP_SAMPLE, HEADER, TIME, TEMPERATURE, FLOAT64)
SOURCE = Path(definitions.__file__).parents[2] / "twinmatch_msgs" / "msg"


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
