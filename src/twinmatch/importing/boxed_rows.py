"""Tables that are drawn, as clients of databases print them: `|` between cells, rules of `-` and `+`."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Final

from twinmatch.importing.heads import Line

__all__ = ["begins_boxed", "table_of_boxes"]

_RULE: Final = re.compile(r"\s*[+|]?[-=:\s]*-{2,}[-=:\s]*[+|][-=:+|\s]*")
"""A line that separates rows."""
_LINES: Final = 3
"""Lines at the beginning of a file among which the first rule stands."""


def begins_boxed(lines: Iterable[Line]) -> bool:
    """Whether a rule and a line with `|` are among the first lines."""
    texts = [line.text for line in islice(lines, _LINES)]
    has_rule = any(_RULE.fullmatch(text) for text in texts)
    return has_rule and any("|" in text for text in texts if not _RULE.fullmatch(text))


def table_of_boxes(lines: Iterable[Line]) -> Iterator[Line]:
    """The rows without what is drawn around them; lines without `|` are as they were."""
    for line in lines:
        if _RULE.fullmatch(line.text):
            continue
        if "|" not in line.text:
            yield line
            continue
        inner = line.text.strip().removeprefix("|").removesuffix("|")
        text = io.StringIO()
        cells = [cell.strip() for cell in inner.split("|")]
        csv.writer(text, lineterminator="").writerow(cells)
        yield Line(line.place, text.getvalue())
