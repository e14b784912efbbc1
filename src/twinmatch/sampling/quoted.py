"""Texts of maps in which quotation marks keep signs together: `"a;b"` is one name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

_MARK: Final = '"'
_BEFORE_MARK: Final = ("", "[", "=", ",", ";")
"""Signs behind which a quotation mark begins a quotation; behind others it is an inch or the like."""


def split_unquoted(text: str, sign: str) -> list[str]:
    """The parts of a text between those of this sign that are not quoted."""
    parts = [""]
    for letter, is_quoted in _letters(text):
        if letter == sign and not is_quoted:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def unquoted_places(text: str, sign: str) -> list[int]:
    """Where this sign is in a text, outside of quotations and of brackets, counted from 0."""
    depth = 0
    places = []
    for place, (letter, is_quoted) in enumerate(_letters(text)):
        if is_quoted:
            continue
        depth += (letter == "[") - (letter == "]")
        if letter == sign and depth == 0:
            places.append(place)
    return places


def _letters(text: str) -> Iterator[tuple[str, bool]]:
    """The letters of a text, each with whether it is quoted; a mark that is never closed quotes nothing."""
    position = 0
    before = ""
    while position < len(text):
        end = _end_of_quotation(text, position) if before in _BEFORE_MARK else None
        if end is None:
            yield text[position], False
            before = text[position].strip() or before
            position += 1
        else:
            for letter in text[position:end]:
                yield letter, True
            before = _MARK
            position = end


def _end_of_quotation(text: str, begin: int) -> int | None:
    """The place behind the quotation that begins here; None if none begins here, or it is not closed."""
    if text[begin] != _MARK:
        return None
    position = begin + 1
    while position < len(text):
        if text[position] == _MARK:
            return position + 1
        position += 2 if text[position] == "\\" else 1
    return None
