"""Lines among the rows of a table that are not rows: sentences, sums, names that a restart repeats.

Such a line would turn its columns into text. It is left out, and a note names it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from twinmatch.importing.dates import is_date
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

__all__ = ["remark_rows"]


class _RemarkRule(Rule):
    """Which rows may be remarks."""

    most: int = 20
    """Most rows that are taken as remarks; more text is that of a column."""
    foot: int = 5
    """Rows at the foot of which a single cell of text is enough: sums and means have numbers, too."""
    fewest: int = 20
    """Rows from which on a table has a foot."""


_RULE: Final = _RemarkRule()


def remark_rows(
    titles: Sequence[str],
    columns: Sequence[FloatArray],
    texts: Sequence[Mapping[int, str]],
) -> list[int]:
    """The rows (from 0) that are remarks.

    A column of numbers has few texts, one of dates few cells other than dates. A row with such a cell is a
    remark if it has neither a number nor a date at all; at the foot of the table if it has no date, and no
    number in the first column. Above the first number in the first column of a table whose other rows all
    have one, every row is a remark: of units, of channels.

    A row that repeats a title is one, too.

    Args:
        titles: those of the columns.
        columns: the numbers of each column, shape (N,); nan without one.
        texts: of each column, the cells that are not numbers, by row.
    """
    rows = columns[0].size if columns else 0
    odd_rows: set[int] = set()
    for column, column_texts in zip(columns, texts, strict=True):
        odd_rows.update(_odd_cells(column, column_texts))
    repeats = {
        row
        for title, column_texts in zip(titles, texts, strict=True)
        for row in odd_rows
        if column_texts.get(row, "").strip() == title.strip() != ""
    }
    remarks = repeats | {
        row for row in odd_rows if not _has_values(row, columns, texts)
    }
    remarks |= _rows_below_titles(columns, texts)
    foot = _RULE.foot if rows >= _RULE.fewest else 0
    for row in range(rows - 1, rows - 1 - foot, -1):
        if (
            row not in odd_rows
            or _has_a_date(row, texts)
            or np.isfinite(columns[0][row])
        ):
            break
        remarks.add(row)
    return sorted(remarks)


def _rows_below_titles(
    columns: Sequence[FloatArray], texts: Sequence[Mapping[int, str]]
) -> set[int]:
    """The first rows, if their first cell is text and that of all others is a number."""
    if not columns or columns[0].size < _RULE.fewest:
        return set()
    is_number = np.isfinite(columns[0])
    first_row = int(np.argmax(is_number))
    first_texts = texts[0]
    if not is_number[first_row:].all() or first_row > _RULE.foot:
        return set()
    if any(
        not first_texts.get(row, "").strip() or is_date(first_texts[row])
        for row in range(first_row)
    ):
        return set()
    return set(range(first_row))


def _odd_cells(column: FloatArray, texts: Mapping[int, str]) -> Iterable[int]:
    """The rows of texts in a column of numbers, or of cells other than dates in a column of dates."""
    numbers = int(np.isfinite(column).sum())
    filled = {row: text for row, text in texts.items() if text.strip()}
    if len(filled) <= min(_RULE.most, 0.1 * numbers):
        return filled.keys()
    if numbers > len(filled) or not is_date(next(iter(filled.values()), "")):
        return ()
    odd_rows = np.flatnonzero(np.isfinite(column)).tolist()
    if len(odd_rows) > _RULE.most:
        return ()
    for row, text in filled.items():
        if not is_date(text):
            odd_rows.append(row)
            if len(odd_rows) > _RULE.most:
                return ()
    return odd_rows


def _has_values(
    row: int, columns: Sequence[FloatArray], texts: Sequence[Mapping[int, str]]
) -> bool:
    """Whether a row has a number or a date."""
    if any(np.isfinite(column[row]) for column in columns):
        return True
    return _has_a_date(row, texts)


def _has_a_date(row: int, texts: Sequence[Mapping[int, str]]) -> bool:
    return any(
        row in column_texts and is_date(column_texts[row]) for column_texts in texts
    )
