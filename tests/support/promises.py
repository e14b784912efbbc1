"""What pages say of how long something takes, read from their own words."""

from __future__ import annotations

import re

from tests.support.places import PROJECT

IN_WORDS = {
    "half a": 0.5, "two": 2, "second": 2, "three": 3, "four": 4, "ten": 10, "twelve": 12, "fourteen": 14,
    "eighteen": 18, "nineteen": 19,
}  # fmt: skip


def page(name: str) -> str:
    """The text of a page."""
    return (PROJECT / "docs" / name).read_text(encoding="utf-8")


def files_of(text: str) -> dict[str, str]:
    """The files that a page gives, by their names."""
    return dict(
        re.findall(
            r"^```(?:python|yaml) (\w+\.\w+)\n(.*?)^```$",
            text,
            re.MULTILINE | re.DOTALL,
        )
    )


def said(text: str, pattern: str) -> float:
    """The number that a page says, in digits or as a word."""
    [word] = re.findall(pattern, text)
    return float(IN_WORDS.get(word.lower(), word))
