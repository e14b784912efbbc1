"""Well-typed messages that mean nothing, and bytes without a message, for all that a node reads."""

from __future__ import annotations

import random
from array import array
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.expected import MESSAGES, MessageRules, check
from twinmatch.nodes.foreign_topics import field_of
from twinmatch.nodes.topics import message_class
from twinmatch.plants import Peltier

NUMBERS = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    25.0,
    1e-300,
    1e9,
    1e300,
    -1e300,
    float("nan"),
    float("inf"),
    -float("inf"),
)
TEXTS = (
    "", "peltier", "tclab", "fridge", "seebeck", "accepted", "trusted", "fault", "60 °C", "²", "22221",
    "discriminator: health", "settled", "verdicts", "9" * 5000, "x" * 40_000, "a\nb", "\ud7ff",
    "' (FMU 0ab36ba3)", "32FC1", "mono16", "rate", "paused", "position", "use_sim_time",
    "../../etc/passwd", "output held: zero",
)  # fmt: skip
HEAD = b"\0\1\0\0"
"""What every message begins with: the name of its encoding."""
LENGTHS = (2**32 - 1, 2**31 - 1, 2**28, 2**24, 2**16)
FIXED = {Clock: 12, Float64: 12}
"""Types of one size: their publishers send no more bytes."""
SIZES = (0, 0, 1, 1, 1, 2, 3, 4, 9, 100)


class Nonsense:
    """Draws messages; the same seed gives the same ones."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def message(self, kind: Any) -> Any:
        """A message of a type, with every field drawn, or only a few that differ from the default."""
        message = kind()
        all_of_it = self._random.random() < 0.5
        for name, text in kind.get_fields_and_field_types().items():
            if all_of_it or self._random.random() < 0.3:
                self._set(message, name, text)
        return message

    def malformed(self, kind: Any) -> bytes:
        """Bytes that were once a message of a type, or never."""
        damage = self._random.choice(DAMAGES)
        return damage(self, kind, bytearray(serialize_message(self.message(kind))))[
            : FIXED.get(kind)
        ]

    def cut(self, _: Any, data: bytearray) -> bytes:
        return bytes(data[: self._random.randrange(len(data))])

    def flipped(self, _: Any, data: bytearray) -> bytes:
        for _ in range(self._random.randint(1, 8)):
            data[self._random.randrange(len(data))] ^= 1 << self._random.randrange(8)
        return bytes(data)

    def huge(self, _: Any, data: bytearray) -> bytes:
        place = self._random.randrange(4, max(5, len(data) - 3), 4)
        return (
            bytes(data[:place])
            + self._random.choice(LENGTHS).to_bytes(4, "little")
            + bytes(data[place + 4 :])
        )

    def foreign(self, kind: Any, _: bytearray) -> bytes:
        other_kinds = [
            candidate
            for candidate in MESSAGES
            if "srv" not in candidate.__module__ and candidate is not kind
        ]
        return bytes(serialize_message(self.message(self._random.choice(other_kinds))))

    def noise(self, _: Any, data: bytearray) -> bytes:
        return self._random.choice((b"", HEAD)) + self._random.randbytes(
            min(len(data), 300)
        )

    def short(self, _kind: Any, _data: bytearray) -> bytes:
        return self._random.choice((b"", HEAD, HEAD[:2]))

    def refused(self, kind: Any) -> Any:
        """A message that no node of a Peltier rig takes."""
        while is_sound(message := self.message(kind)):
            pass
        return message

    def spoilt(self, message: Any) -> Any:
        """A sound message with one to three of its fields drawn again, wherever they are nested."""
        for _ in range(self._random.randint(1, 3)):
            owner = self._random.choice(list(_parts(message)))
            name, text = self._random.choice(
                list(owner.get_fields_and_field_types().items())
            )
            self._set(owner, name, text)
        return message

    def _set(self, message: Any, name: str, text: str) -> None:
        field = field_of(text)
        if not field.array:
            setattr(message, name, self._value(field.kind))
            return
        size = field.length or self._random.choice(SIZES)
        if "/" in field.kind:
            size = min(size, 3)
        values = [self._value(field.kind) for _ in range(size)]
        old = getattr(message, name)
        setattr(
            message,
            name,
            array(old.typecode, values) if isinstance(old, array) else values,
        )

    def _value(self, kind: str) -> Any:
        draw = self._random
        if "/" in kind:
            return self.message(message_class(kind))
        if kind in ("double", "float"):
            return (
                draw.choice(NUMBERS)
                if kind == "double"
                else draw.choice((0.0, 1.5, float("nan")))
            )
        if kind in ("string", "wstring"):
            return draw.choice(TEXTS)
        if kind == "boolean":
            return draw.random() < 0.5
        if kind == "octet":
            return bytes([draw.choice((0, 1, 2, 3, 4, 255))])
        bits = int("".join(filter(str.isdigit, kind)) or 8)
        signed = kind.startswith("int")
        low, high = (
            (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
        )
        small = (0, 1, 2, 3, 7, 60, 255, 1000, -1, -5)
        return draw.choice(
            (low, high, high - 1, *(v for v in small if low <= v <= high))
        )


DAMAGES: tuple[Callable[[Nonsense, Any, bytearray], bytes], ...] = (
    Nonsense.cut, Nonsense.flipped, Nonsense.huge, Nonsense.foreign, Nonsense.noise, Nonsense.short,
)  # fmt: skip


def is_sound(message: Any) -> bool:
    """Whether the nodes of a Peltier rig take a message."""
    try:
        check(message, Peltier)
        MESSAGES.get(type(message), MessageRules()).read(message)
    except TwinmatchError:
        return False
    return True


def _parts(message: Any) -> Iterator[Any]:
    """A message and those nested in it."""
    yield message
    for name, text in message.get_fields_and_field_types().items():
        if "/" in text:
            inside = getattr(message, name)
            for part in inside if isinstance(inside, list | tuple) else (inside,):
                yield from _parts(part)
