"""What a recorder writes of a message ends where the message ends, so that strict readers take it."""

from __future__ import annotations

import random
from functools import cache
from importlib import import_module
from typing import Any, cast

import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosidl_parser.definition import AbstractSequence, AbstractString, Array, BasicType

from tests.nodes.test_entrance import SOUND
from twinmatch.nodes.cdr import serialized
from twinmatch.nodes.entrance import Entrance
from twinmatch.nodes.expected import MESSAGES
from twinmatch.nodes.health import NodeHealth
from twinmatch.sessions.messages import schema_of

pytestmark = pytest.mark.ros

KINDS = [kind for kind in MESSAGES if kind.__module__.split(".")[1] == "msg"]


def filled(kind: Any, rng: random.Random) -> Any:
    """A message with any values: texts of several bytes a letter, lists of none to three."""
    message = kind()
    for name, slot in zip(
        kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True
    ):
        setattr(message, name, _value(slot, rng))
    return message


def _value(slot: Any, rng: random.Random) -> Any:
    if isinstance(slot, BasicType):
        special = {
            "boolean": True,
            "octet": b"\x01",
            "double": rng.random(),
            "float": 1.5,
        }
        return special.get(slot.typename, rng.randrange(100))
    if isinstance(slot, AbstractString):
        return "ä" * rng.randrange(7)
    if isinstance(slot, Array | AbstractSequence):
        length = slot.size if isinstance(slot, Array) else rng.choice([0, 0, 1, 3])
        return [_value(slot.value_type, rng) for _ in range(length)]
    return filled(getattr(import_module(".".join(slot.namespaces)), slot.name), rng)


@cache
def store_of(kind: Any) -> tuple[Any, str]:
    """What an independent reader knows of a type by its installed definition, and its full name."""
    name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_of(name), name))
    return store, name


def ends_at(data: bytes, kind: Any) -> int:
    """Where a message ends for that reader."""
    store, name = store_of(kind)
    definition = store.get_msgdef(name)
    return 4 + definition.deserialize_cdr_le(data[4:], 0, definition.cls, store)[1]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_message_is_as_long_as_an_independent_reader_finds_it(kind: Any) -> None:
    rng = random.Random(7)
    for _ in range(8):
        message = filled(kind, rng)
        data = serialized(message)
        assert len(data) == ends_at(serialize_message(message), kind)
        assert deserialize_message(data, kind) == message


@pytest.mark.parametrize("name", sorted(SOUND))
@pytest.mark.parametrize("tail", [b"", b"\0" * 24, b"anything"])
def test_what_the_entrance_hands_on_as_bytes_has_no_tail(
    name: str, tail: bytes
) -> None:
    """As rclpy serialises it, up to 60 bytes too long, and with what a publisher has appended."""
    message = SOUND[name]()
    came: list[bytes] = []
    # asked only for what it refuses
    entrance = Entrance(cast("Node", None), cast("NodeHealth", None))
    entrance.before(type(message), "/topic", came.append, raw=True)(
        serialize_message(message) + tail
    )
    assert len(came[0]) == ends_at(came[0], type(message))
    # nan equals nothing
    assert repr(deserialize_message(came[0], type(message))) == repr(message)
