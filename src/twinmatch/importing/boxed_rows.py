"""Tables that are drawn, as clients of databases print them: `|` between cells, rules of `-` and `+`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from twinmatch.importing.heads import Line, line_of

__all__ = ["begins_boxed", "table_of_boxes"]

_RULE: Final = re.compile(r"\s*[+|]?[-=:\s]*-{2,}[-=:\s]*[+|][-=:+|\s]*")
"""A line that separates rows."""


def begins_boxed(first_lines: Sequence[Line]) -> bool:
    """Whether a rule and a line with `|` are among the first lines."""
    rows = [line.text for line in first_lines if not _RULE.fullmatch(line.text)]
    has_rule = len(rows) < len(first_lines)
    return has_rule and any("|" in row for row in rows)


def table_of_boxes(lines: Iterable[Line]) -> Iterator[Line]:
    """The rows without what is drawn around them; lines without `|` are as they were."""
    for line in lines:
        if _RULE.fullmatch(line.text):
            continue
        if "|" not in line.text:
            yield line
            continue
        inner = line.text.strip().removeprefix("|").removesuffix("|")
        yield line_of(line.place, (cell.strip() for cell in inner.split("|")))
