"""Numbers as devices write them: words such as `heating`, numbers with a unit, decimal commas."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

from twinmatch.sampling.channels import UnreadableError

WORDS: Final[Mapping[str, float]] = (
    dict.fromkeys(
        ("on", "true", "yes", "open", "heating", "heat", "preheating", "ein", "an"), 1.0
    )
    | dict.fromkeys(
        ("off", "false", "no", "closed", "idle", "aus", "fan", "fan_only"), 0.0
    )
    | dict.fromkeys(("cooling", "cool"), -1.0)
)
"""Words that mean the same everywhere, in small letters; what cools is opposed to what heats, and while only the
fan of a climate device is on it does neither (Home Assistant's definition)."""
_UNDECIDED: Final = (
    "dry",
    "drying",
    "defrosting",
    "auto",
    "heat_cool",
    "eco",
)
"""Words of climate devices whose effect depends on the plant: one that dries or defrosts may cool as it does so."""
_NUMBER: Final = re.compile(
    r"(?P<number>[-+−]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>(?!.*[/\s]\s*\d)[^\d\s.,:;_=+-][^,:;_=]*)?"
)
"""A number, and a unit behind it: digits in one are exponents, so that `2025/03/04` and `20/50` are not numbers."""
_THOUSANDS: Final = re.compile(r"[-+−]?[1-9]\d{0,2},\d{3}")
"""What may be a separator of thousands as well as a decimal comma."""
_LONGEST: Final = 60
"""Longest text that may be a number with a unit, characters."""
_QUOTED: Final = 40
"""Most characters of a text that a message quotes."""


class WrittenNumber(NamedTuple):
    """A number and the unit behind it."""

    value: float
    unit: str = ""
    """Empty without one."""


def written_number(
    text: str, words: Mapping[str, float] | None = None
) -> WrittenNumber:
    """The number that a text is: `21.5`, `17.99 °C`, `0%`, `21,5`, `heating`, or a word of these `words`.

    Raises:
        UnreadableError: it is not a number, or may be two.
    """
    plain = text.strip()
    word = plain.lower()
    meanings = {**WORDS, **(words or {})}
    if word in meanings:
        return WrittenNumber(meanings[word])
    try:
        return WrittenNumber(float(plain.replace("_", "?")))  # Python takes 1_000
    except ValueError:
        pass
    match = _NUMBER.fullmatch(plain) if len(plain) <= _LONGEST else None
    if match is None:
        raise UnreadableError(_refusal(plain))
    digits = match["number"]
    if _THOUSANDS.fullmatch(digits):
        with_point = digits.replace(",", ".")
        without = digits.replace(",", "")
        raise UnreadableError(
            f"{plain!r} may be {with_point} or {without}; have it written with a point"
        )
    unit = (match["unit"] or "").strip()
    return WrittenNumber(float(digits.replace(",", ".").replace("−", "-")), unit)


def _refusal(text: str) -> str:
    quoted = repr(text[:_QUOTED])
    if text.lower() in _UNDECIDED:
        return f"{quoted} depends on the plant; write its number behind the place, such as '; {text}=1'"
    return f"{quoted} is not a number; if it stands for one, write that behind the place, as '; WORD=NUMBER'"
