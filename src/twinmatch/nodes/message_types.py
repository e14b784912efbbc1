"""Message types given by name at run time: their classes and fields."""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from typing import Any, Final

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.sampling import Field

__all__ = ["MessageTypeError", "fields_of", "message_class"]

_KIND: Final = re.compile(r"(?:sequence<)?(?P<base>[\w/ ]+?)(?:<\d+>)?(?:\[(?P<length>\d+)\])?(?:, \d+)?>?$")


class MessageTypeError(TwinmatchError):
    """A message type is not installed here."""


def message_class(kind: str) -> Any:
    """The class of a type, `package/msg/Type`.

    Raises:
        MessageTypeError: it is not installed.
    """
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        msg = f"the type {kind} is not installed here; source the workspace with {package}, and restart"
        raise MessageTypeError(msg) from None


def fields_of(kind: str) -> Mapping[str, Field]:
    """The fields of an installed type.

    Raises:
        MessageTypeError: it is not installed.
    """
    return {n: _field(text) for n, text in message_class(kind).get_fields_and_field_types().items()}


def _field(text: str) -> Field:
    """From ROS's notation of a field type: `double`, `sequence<std_msgs/Header, 3>`, `float[9]`."""
    match = _KIND.match(text)
    base = match["base"] if match else text
    if "/" in base:
        package, name = base.split("/")
        base = f"{package}/msg/{name}"
    length = match["length"] if match else None
    return Field(base, text.startswith("sequence") or length is not None, int(length) if length else None)
