"""Convert between trees and messages, either of ROS 2 or decoded from a recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from twinmatch.record.tree import Tree

__all__ = ["fill", "tree_of_message"]

NANOSECONDS = 1_000_000_000


def fill(message: Any, tree: Tree, part: Callable[[str], Any]) -> Any:
    """Write a tree into a message of ROS 2 and return it.

    A word is written together with its number, the message's constant of that name.

    Args:
        message: a new message.
        tree: its fields.
        part: creates an empty message of a type given by its short name, for lists of parts.
    """
    kinds = message.get_fields_and_field_types()
    for name, value in tree.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value, part)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = kinds[name].removeprefix("sequence<").removesuffix(">").rpartition("/")[2]
            setattr(message, name, [fill(part(kind), item, part) for item in value])
        else:
            setattr(message, name, float(value) if kinds[name] == "double" else value)
            number = name.removesuffix("_name")
            if number != name and number in kinds:
                setattr(message, number, getattr(type(message), value.upper()))
    return message


def tree_of_message(message: Any) -> Tree:
    """A message as a tree, with only `stamp` (ns) of the header and only the word of a level or status."""
    names = [name.removeprefix("_") for name in message.__slots__ if name != "_check_fields"]
    tree: Tree = {}
    for name in names:
        value = getattr(message, name)
        if name == "header":
            tree["stamp"] = value.stamp.sec * NANOSECONDS + value.stamp.nanosec
        elif f"{name}_name" not in names:
            tree[name] = _plain(value)
    return tree


def _plain(value: Any) -> Any:
    if hasattr(value, "__slots__"):
        return tree_of_message(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
