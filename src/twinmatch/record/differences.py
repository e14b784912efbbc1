"""Bit for bit comparison of two recorded trees."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["differences"]

_NUMBER = re.compile(r"\[\d+\]")


def differences(
    recorded: Any, computed: Any, place: str = "", apart: set[str] | None = None
) -> Iterator[tuple[str, Any, Any]]:
    """Fields in which two trees differ, if only by a bit: path, recorded value, computed value.

    A field that only one of them has is a difference too, unless a set `apart` is given to collect it.
    """
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for name in (*recorded, *(name for name in computed if name not in recorded)):
            inside = f"{place}.{name}" if place else name
            if apart is not None and (name in recorded) != (name in computed):
                apart.add(_NUMBER.sub("", inside))
                continue
            yield from differences(recorded.get(name), computed.get(name), inside, apart)
    elif isinstance(recorded, list) and isinstance(computed, list) and len(recorded) == len(computed):
        for number, (one, other) in enumerate(zip(recorded, computed, strict=True)):
            yield from differences(one, other, f"{place}[{number}]", apart)
    elif not _same(recorded, computed):
        yield place, recorded, computed


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float | int):
        both_nan = math.isnan(one) and math.isnan(other)
        return both_nan or struct.pack("<d", one) == struct.pack("<d", other)
    return bool(one == other)
