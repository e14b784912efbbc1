"""What is printed: a text of somebody else can neither move a terminal's cursor nor set its title.

Names, reasons and faults come from other programs, files and nodes. The programs of this package print them
all through `printable_output`, and tables through `twinmatch.showing.console`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, TextIO, cast

_ODD: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff\U000e0000-\U000e007f]"
)
"""Characters that control a terminal, reverse the order of what is shown, or cannot be seen or encoded."""


def printable(text: str) -> str:
    r"""A text with such characters escaped, as `\x1b`; line breaks and tabs are kept."""
    return _ODD.sub(lambda odd: odd[0].encode("unicode_escape").decode(), text)


def one_line(text: str) -> str:
    """A printable text in one line."""
    return printable(text).replace("\n", "\\n")


class _Printable:
    """A stream that makes what is written to it printable."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        self.stream.write(printable(text))
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def original(stream: Any) -> Any:
    """The stream itself, for a writer that sends a terminal its own control sequences."""
    return stream.stream if isinstance(stream, _Printable) else stream


@contextmanager
def printable_output() -> Iterator[None]:
    """Make everything printable that is written to standard output and standard error meanwhile."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        cast(TextIO, _Printable(original(stream))) for stream in before
    )
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
