"""Requests to services with values that nobody means: not finite, tiny, huge, empty, of a wrong length."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any, Final

NUMBERS: Final = (
    float("nan"),
    float("inf"),
    -float("inf"),
    1e-320,
    -1e-320,
    1e308,
    -1e308,
    1e12,
    -1.0,
    0.0,
)
COUNTS: Final = (0, 1, 2**31, 2**32 - 1)
INDICES: Final = (0, 1, 2**53, 2**64 - 1)
TEXTS: Final = (
    "", "x", "structure", "parameters", "fault", "\\ud800", "\x1b[2J", "é" * 100, "[" * 5000, "{}", "null",
    '{"kind": "pid"}', '{"kind": "\\ud800"}', '{"kind": ["pid"]}',
    '{"kind": "pid", "proportional": 1e-320, "integral": 1e-320, "derivative": 1e-320, '
    '"back_calculation": 1e-320}',
    '{"kind": "pid", "proportional": 1e308, "integral": 1e308, "derivative": -1e308}',
    '{"kind": "pid", "proportional": -50, "integral": -5}',
    '{"kind": "pid", "proportional": NaN, "integral": Infinity}',
    '{"kind": "pid", "loops": []}', '{"kind": "two-level", "off": 0, "on": 9, "low": 1, "high": 2}',
    '{"kind": "state-space", "A": [[1e308]], "B": [[1e308]], "C": [[1]], "D": [[0]], "E": [[1]]}',
)  # fmt: skip
_LENGTHS: Final = (0, 1, 2, 3, 7)


def odd_values(kind: Any, seed: int, count: int) -> Iterator[Any]:
    """Draw requests of a service; the same seed gives the same ones."""
    draw = random.Random(seed)
    fields = kind.Request.get_fields_and_field_types()
    for _ in range(count):
        yield kind.Request(
            **{
                name: _value(draw, text)
                for name, text in fields.items()
                if "/" not in text
            }
        )


def _value(draw: random.Random, kind: str) -> Any:
    if kind.startswith("sequence<"):
        base = kind.removeprefix("sequence<").rstrip(">").split(",")[0]
        return [_value(draw, base) for _ in range(draw.choice(_LENGTHS))]
    if kind == "boolean":
        return draw.random() < 0.5
    if kind == "string":
        return draw.choice(TEXTS)
    if kind == "double":
        return draw.choice(NUMBERS)
    return draw.choice(COUNTS if kind == "uint32" else INDICES)
